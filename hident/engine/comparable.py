"""Whether the absolute values that a metric compares mean the same in an estimate and in the true system.

No data determine the factor between the blocks, and each estimator fixes it by a rule of its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from hident.config.suggest import one_of
from hident.estimators.base import EstimatorSpec
from hident.estimators.normalisation import CLOSE, Normalisation
from hident.metrics.base import MetricSpec
from hident.systems.base import SystemSpec
from hident.systems.blocks import Hammerstein, Wiener

_PLACES = {"linear": "b of the linear block", "input": "b of input_linear", "output": "b of output_linear"}


def governed(metric: MetricSpec, estimator: EstimatorSpec) -> Iterator[tuple[Normalisation, list[str]]]:
    """The estimator's rules on which the metric's score depends, with the parts that it compares."""
    alternatives = {part for need in metric.compares() for part in need.split(" or ")}
    compared = sorted(alternatives & estimator.provides())
    for rule in estimator.normalisations() or ():
        if parts := [part for part in compared if rule.governs(part)]:
            yield rule, parts


def incomparable(
    metric: MetricSpec,
    name: str,
    estimators: Mapping[str, EstimatorSpec],
    system: SystemSpec,
    dt: float | None,
) -> Iterator[str]:
    """Why the metric's score of an estimator would say nothing.

    ``estimators`` are all that it scores on the same system, by their names in the file; ``name`` is the one
    meant. What would bring the system to its rule is no remedy where another one's rule asks for another
    factor.
    """
    estimator = estimators[name]
    for rule, parts in governed(metric, estimator):
        named = one_of(part.removeprefix("value ") for part in parts)
        said = (
            f"compares absolute values ({named}), and no data determine the factor between the blocks: "
            f"estimator '{name}' ({estimator.kind}) fixes it by the rule '{rule.rule}'"
        )
        try:
            factors = rule.factors(system.truth(), dt) or {}
        except ValueError as error:
            yield f"{said}; {_either([str(error), *_instead(estimator, system)])}"
            continue
        off = {place: factor for place, factor in factors.items() if abs(factor - 1.0) > CLOSE}
        if off:
            found = one_of(f"{factor:.4g}" for factor in off.values())
            said += f", and the system has {found} in place of 1. "
            against = next(_against(metric, factors, estimators, system, dt), None)
            if against is None:
                same = f"{_remedy(system, off)}, which is the same system"
                yield said + _either([same, *_instead(estimator, system)])
            else:
                other, theirs = against
                yield (
                    f"{said}The same system with that factor moved would not keep the rule of estimator "
                    f"'{other}', '{theirs.rule}': {_either(_instead(estimator, system))}"
                )


def _against(
    metric: MetricSpec,
    factors: Mapping[str, float],
    estimators: Mapping[str, EstimatorSpec],
    system: SystemSpec,
    dt: float | None,
) -> Iterator[tuple[str, Normalisation]]:
    """The estimators with the rules for which the system's blocks must be divided by other factors."""
    for name, estimator in estimators.items():
        for rule, _ in governed(metric, estimator):
            try:
                theirs = rule.factors(system.truth(), dt)
            except ValueError:
                # Nothing brings the system to that rule, and its own message says so.
                continue
            if theirs and not _agree(factors, theirs):
                yield name, rule


def _agree(one: Mapping[str, float], other: Mapping[str, float]) -> bool:
    """Whether the same factor moved between the blocks keeps two rules."""
    first, second = (
        {"linear": 1.0 / of["nonlinearity"]} if "nonlinearity" in of else of for of in (one, other)
    )
    return all(abs(first[place] / second[place] - 1.0) <= CLOSE for place in first.keys() & second.keys())


def _remedy(system: SystemSpec, factors: Mapping[str, float]) -> str:
    """What brings the system to a rule, given what each of its blocks must be divided by."""
    if isinstance(system, Hammerstein | Wiener):
        hammerstein = isinstance(system, Hammerstein)
        if (factor := factors.get("linear")) is not None:
            back = (
                "multiply the nonlinearity by it"
                if hammerstein
                else "multiply the nonlinearity's argument by it"
            )
            return f"Divide {_PLACES['linear']} by {factor:.10g} and {back}"
        back = "the nonlinearity" if hammerstein else "the nonlinearity's argument"
        return f"Divide {back} by {factors['nonlinearity']:.10g} and multiply {_PLACES['linear']} by it"
    divided = one_of(f"{_PLACES.get(place, place)} by {factor:.10g}" for place, factor in factors.items())
    return f"Divide {divided}, and multiply before and after the nonlinearity instead"


def _instead(estimator: EstimatorSpec, system: SystemSpec) -> list[str]:
    """What else can be done, with the metrics that do not depend on the factor."""
    given, true = estimator.provides(), system.provides()
    metrics = [
        *(["validation_error"] if "response" in given & true else []),
        *(["linear_percent_error"] if "continuous" in true and {"continuous", "linear"} & given else []),
    ]
    score = [f"score what does not depend on it ({one_of(metrics)})"] if metrics else []
    return [*score, "limit the metric to other estimators by 'estimators:' under it"]


def _either(alternatives: Sequence[str]) -> str:
    *others, last = alternatives
    return f"{', '.join(others)}, or {last}" if others else last
