"""The truth as an estimate is scored against it: in the form that the estimator's rules ask for.

No data determine the factor between the blocks, and each estimator fixes it by a rule of its own. The same
system with the factor moved keeps that rule too; where none does, values cannot be compared.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

from hident.config.suggest import one_of
from hident.estimators.base import (
    CONTINUOUS,
    DISCRETE,
    FEEDBACK,
    IMPULSE_RESPONSE,
    NUMERATOR,
    POWERS,
    EstimatorSpec,
)
from hident.estimators.normalisation import Factors, Normalisation, brought
from hident.metrics.base import Comparing, MetricSpec
from hident.numerics.freedoms import FREEDOMS, Freedom
from hident.records import Estimate, Truth
from hident.systems.base import SystemSpec

# A coefficient, of one of several blocks too: a_1, input_b_0.
_COEFFICIENT = re.compile(r"(?:.*_)?(?P<letter>[a-h])_(?P<number>-?\d+)")


def governed(metric: MetricSpec, estimator: EstimatorSpec) -> Iterator[tuple[Normalisation, list[str]]]:
    """The estimator's rules on which the metric's score depends, with the parts that it compares."""
    alternatives = {part for need in metric.compares() for part in need.split(" or ")}
    compared = sorted(alternatives & estimator.provides())
    for rule in estimator.normalisations() or ():
        if parts := [part for part in compared if rule.governs(part)]:
            yield rule, parts


def is_as_declared(metric: MetricSpec) -> bool:
    """Whether the metric compares in the form that the estimator declares: it chooses no factor itself."""
    if not isinstance(metric, Comparing) or metric.up_to is None:
        return True
    return bool(metric.up_to) and "gain" not in metric.up_to


def keeps_sign(metric: MetricSpec) -> bool:
    """Whether the metric chooses a factor and not its sign, which then is that of the estimator's rule."""
    up_to = metric.up_to if isinstance(metric, Comparing) else None
    return up_to is not None and "gain" in up_to and "sign" not in up_to


def kept(metric: MetricSpec, estimator: EstimatorSpec) -> Iterator[tuple[Normalisation, list[str]]]:
    """The rules, or only their signs, that the truth keeps where the metric compares, with the parts."""
    for rule, parts in governed(metric, estimator):
        if is_as_declared(metric):
            yield rule, parts
        elif keeps_sign(metric):
            # Of a truth with the other sign the nearest positive factor of any estimate would be 0.
            yield rule.of_signs(), parts


def completed(metric: MetricSpec, estimator: EstimatorSpec, dt: float | None) -> MetricSpec:
    """The metric as it scores the estimator's estimates from data at sampling interval ``dt``."""
    rules = [rule for rule, _ in governed(metric, estimator)]
    if "response" in metric.compares():
        # It is of all parts.
        rules += estimator.normalisations() or ()
    left: set[Freedom] = set().union(*(rule.left for rule in rules))
    return metric.completed(left, estimator.discrete_step(dt))


def compared_values(metric: MetricSpec) -> list[str]:
    """The names of the values that a metric compares with the truth's."""
    parts = (part for need in metric.compares() for part in need.split(" or "))
    return sorted(part.removeprefix("value ") for part in parts if part.startswith("value "))


def unsaid(names: Iterable[str], estimator: EstimatorSpec) -> list[str]:
    """The coefficients among values of an estimator of which it does not say what they are."""
    given = estimator.letters()
    return [
        name for name in names if (match := _COEFFICIENT.fullmatch(name)) and match["letter"] not in given
    ]


def quantity_of(name: str, estimator: EstimatorSpec) -> str | None:
    """What a value of an estimator is, if it is a coefficient and that is said."""
    match = _COEFFICIENT.fullmatch(name)
    return None if match is None else _letters_of(estimator).get(match["letter"])


def other_quantities(
    names: Iterable[str], estimator: EstimatorSpec, truth: Truth
) -> dict[str, tuple[str, str]]:
    """The values that have one name and are not one quantity: what they are in the estimate and the system.

    Those of which one side does not say what they are, are taken to be one.
    """
    given, system = _letters_of(estimator), _letters_of_system(truth)
    found = {}
    for name in names:
        match = _COEFFICIENT.fullmatch(name)
        if match is None or (letter := match["letter"]) not in given or letter not in system:
            continue
        one, other = given[letter], system[letter]
        if one != other and not (
            {one, other} == {NUMERATOR, IMPULSE_RESPONSE} and _begins_with(truth, int(match["number"]))
        ):
            found[name] = (one, other)
    return found


def _letters_of(estimator: EstimatorSpec) -> Mapping[str, str]:
    """What the values of an estimator are; the numerator of a model without feedback is its response."""
    letters = estimator.letters()
    if letters.get("a") == FEEDBACK and not any("a_1" in part for part in estimator.provides()):
        return {**letters, "b": IMPULSE_RESPONSE}
    return letters


def _letters_of_system(truth: Truth) -> Mapping[str, str]:
    if truth.continuous is not None or truth.blocks:
        return {**CONTINUOUS, "c": POWERS}
    if truth.linear is None:
        return DISCRETE if truth.discrete_blocks else {}
    # As Hammerstein.truth names them.
    return {**DISCRETE, "c": POWERS} if truth.linear.a else {"a": POWERS, "b": NUMERATOR}


def _begins_with(truth: Truth, lag: int) -> bool:
    """Whether the numerator is the impulse response up to this lag: without feedback it is at every one."""
    return truth.linear is None or not truth.linear.a or not any(truth.linear.b[:lag])


def _why_others(metric: MetricSpec, name: str, estimator: EstimatorSpec, truth: Truth) -> str:
    """Why values of one name are not compared, with the remedies; nothing if they are."""
    found = other_quantities(compared_values(metric), estimator, truth)
    if not found:
        return ""
    said = dict.fromkeys(found.values())
    each = "; ".join(
        f"{', '.join(of for of, pair in found.items() if pair == (one, other))}: {one} in the estimate, "
        f"{other} in the system"
        for one, other in said
    )
    provides = estimator.provides()
    instead = [
        *(["the impulse response (impulse_response_error)"] if {"linear", "continuous"} & provides else []),
        *(["the nonlinearity (nonlinearity_percent_error)"] if "nonlinearity" in provides else []),
    ]
    remedies = [
        *([f"score {' or '.join(instead)} instead"] if instead else []),
        "name other values by 'of:'",
        "limit the metric to other estimators by 'estimators:' under it",
    ]
    return (
        f"compares values that have one name and are different quantities with estimator '{name}' "
        f"({estimator.kind}) and this system ({each}): {_either(remedies)}"
    )


def depends_on_estimate(metric: MetricSpec, estimator: EstimatorSpec) -> bool:
    """Whether the form in which the metric compares depends on what an estimate has found."""
    return any(rule.found for rule, _ in kept(metric, estimator))


def truth_for(
    metric: MetricSpec,
    estimator: EstimatorSpec,
    truth: Truth,
    dt: float | None,
    estimate: Estimate | None = None,
) -> Truth:
    """The truth that the metric compares the estimator's estimates with, or the one ``estimate``.

    It is the one given, to the last bit, where that keeps the estimator's rules already, or the metric is to
    compare it as it is written.

    Raises
    ------
    ValueError
        If nothing brings the system to a rule.
    """
    if why := _why_others(metric, "estimator", estimator, truth):
        raise ValueError(why)
    return brought(truth, [rule.of(estimate) for rule, _ in kept(metric, estimator)], dt)


def in_units(
    scored: Iterable[tuple[str, MetricSpec, EstimatorSpec]], number: int, truth: Truth, dt: float | None
) -> list[list[str]]:
    """The names of estimators of one system, those together whose scores are in one unit.

    They are those of a metric's number in its order, from 0. An estimator that does not say how it fixes the
    factor between the blocks is in none.
    """
    groups: list[tuple[Truth, list[str]]] = []
    for name, metric, estimator in scored:
        if estimator.normalisations() is None:
            continue
        form = truth_for(metric, estimator, truth, dt)
        own = next((names for of, names in groups if metric.in_one_unit(of, form)[number]), None)
        if own is None:
            groups.append((form, [name]))
        elif name not in own:
            own.append(name)
    return [names for _, names in groups]


def to_one_unit(scored: Iterable[tuple[MetricSpec, EstimatorSpec]]) -> str:
    """What to do about scores that are in several units: what stands under the metric, or else instead."""
    asked: set[Freedom] = set()
    for metric, estimator in scored:
        if not isinstance(metric, Comparing) or "gain" not in metric.choices:
            return "score what does not depend on the factor instead"
        complete = completed(metric, estimator, None)
        assert isinstance(complete, Comparing)
        asked |= {"gain", "sign", *(complete.up_to or ())}
    named = one_of(name for name in FREEDOMS if name in asked)
    return f"'up_to: [{named}]' under the metric brings all to the system's own units"


def form_of(
    estimator: EstimatorSpec, truth: Truth, dt: float | None, estimate: Estimate | None = None
) -> Truth:
    """The truth in the estimator's form, as far as there is one: what a figure shows beside its estimates.

    Without the values that are other quantities than the estimator's of their names, or of which that does
    not say what they are.
    """
    given = estimator.provides()
    own = [name for name in truth.values if f"value {name}" in given]
    if others := {*other_quantities(truth.values, estimator, truth), *unsaid(own, estimator)}:
        values = {name: value for name, value in truth.values.items() if name not in others}
        truth = replace(truth, values=values)
    rules = [rule.of(estimate) for rule in estimator.normalisations() or ()]
    return brought(truth, [rule for rule in rules if _can_be_kept(rule, truth, dt)], dt)


def _can_be_kept(rule: Normalisation, truth: Truth, dt: float | None) -> bool:
    try:
        rule.off(truth, dt)
    except ValueError:
        return False
    return True


def moved(metric: MetricSpec, estimator: EstimatorSpec, system: SystemSpec, dt: float | None) -> Factors:
    """What the system's blocks are divided by to keep the rules on which a score depends; empty if none."""
    factors: dict[str, float] = {}
    for rule, _ in kept(metric, estimator):
        factors |= rule.off(system.truth(), dt)
    return factors


def incomparable(
    metric: MetricSpec, name: str, estimator: EstimatorSpec, system: SystemSpec, dt: float | None
) -> Iterator[str]:
    """Why the metric's score of an estimator, by its name in the file, would say nothing."""
    if why := _why_others(metric, name, estimator, system.truth()):
        yield why
        return
    rules = list(kept(metric, estimator))
    for tried in ([one] for one in rules):
        yield from _unkept(tried, metric, name, estimator, system, dt)
    if all(_can_be_kept(rule, system.truth(), dt) for rule, _ in rules):
        yield from _unkept(rules, metric, name, estimator, system, dt)


def _unkept(
    rules: Sequence[tuple[Normalisation, list[str]]],
    metric: MetricSpec,
    name: str,
    estimator: EstimatorSpec,
    system: SystemSpec,
    dt: float | None,
) -> Iterator[str]:
    """Why nothing brings the system to the rules together; nothing if something does."""
    try:
        brought(system.truth(), [rule for rule, _ in rules], dt)
    except ValueError as error:
        named = one_of(dict.fromkeys(part.removeprefix("value ") for _, parts in rules for part in parts))
        said = " and ".join(f"'{rule.said(system.truth(), dt)}'" for rule, _ in rules)
        compares, of = "absolute values", ""
        if keeps_sign(metric):
            compares, of = "up to a positive factor", "sign of the "
        yield (
            f"compares {compares} ({named}), and no data determine the {of}factor between the blocks: "
            f"estimator '{name}' ({estimator.kind}) fixes it by the rule {said}; "
            f"{_either([str(error), *_instead(metric, rules[0][0], estimator, system)])}"
        )


def _instead(
    metric: MetricSpec, rule: Normalisation, estimator: EstimatorSpec, system: SystemSpec
) -> list[str]:
    """What else can be done, with the metrics that do not depend on the factor."""
    given, true = estimator.provides(), system.provides()
    metrics = [
        *(["validation_error"] if "response" in given & true else []),
        *(["linear_percent_error"] if "continuous" in true and {"continuous", "linear"} & given else []),
    ]
    score = [f"score what does not depend on it ({one_of(metrics)})"] if metrics else []
    if isinstance(metric, Comparing):
        asked = {*(metric.up_to or ()), "sign"} if keeps_sign(metric) else rule.free
        free = [name for name in metric.choices if name in asked]
        up_to = f"up_to: [{one_of(free)}]"
        score.append(
            f"choose it for the least error by '{up_to}' under it"
            if free
            else f"compare the values as they are written by '{up_to}' under it"
        )
    return [*score, "limit the metric to other estimators by 'estimators:' under it"]


def _either(alternatives: Sequence[str]) -> str:
    *others, last = alternatives
    return f"{', '.join(others)}, or {last}" if others else last
