"""How the metrics of a run score, in a line of words for its tables."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence

from hident.config.suggest import one_of
from hident.engine.comparable import (
    completed,
    depends_on_estimate,
    governed,
    in_units,
    is_as_declared,
    keeps_sign,
    moved,
    quantity_of,
    to_one_unit,
    unsaid,
)
from hident.engine.experiment import Plan, Unit
from hident.estimators.normalisation import MissedConstant, level_at_zero
from hident.estimators.selection.select import Select
from hident.metrics.base import Comparing, MetricSpec
from hident.numerics.freedoms import Freedom, in_words

_PLACES = {
    "linear": "linear block",
    "nonlinearity": "nonlinearity",
    "input": "input block",
    "output": "output block",
}
# So many factors are written out; they may differ from case to case.
_MOST_FACTORS = 4


def scoring(plan: Plan) -> Iterator[str]:
    """Up to what values are compared, in which form, and what each metric says of itself: sentences."""
    rules: dict[str, dict[str, list[str]]] = {}
    signs: dict[str, dict[str, list[str]]] = {}
    said: dict[str, list[str]] = {}
    apart: dict[tuple[str, str], list[str]] = {}
    counted: dict[tuple[str, str], list[str]] = {}
    factors: dict[str, dict[str, list[str]]] = {}
    turned: dict[str, dict[str, list[str]]] = {}
    for unit in plan.units:
        for name, metric in unit.metrics.items():
            of = signs if keeps_sign(metric) else rules
            for rule in _rules(unit, name):
                _add(of.setdefault(name, {}).setdefault(rule, []), unit.name)
            at = " at the system's own delay" if depends_on_estimate(metric, unit.estimator) else ""
            by = turned if keeps_sign(metric) else factors
            for place, factor in moved(metric, unit.estimator, unit.data.system, unit.data.dt).items():
                _add(by.setdefault(unit.name, {}).setdefault(place, []), f"{factor:.4g}{at}")
            if words := _taken_off(metric, unit):
                _add(apart.setdefault((name, words), []), unit.name)
            if words := _counted(metric, unit):
                _add(counted.setdefault((name, words), []), unit.name)
            if words := metric.says(unit.data.dt):
                _add(said.setdefault(name, []), words)
    for words, metrics in _alike(rules):
        named = one_of(metrics)
        yield f"Absolute values are compared in {named}; the free factor between the blocks: {words}."
    if factors:
        yield f"The truth is brought to that form: {'; '.join(_divided(factors))}."
    for words, metrics in _alike(signs):
        named = one_of(metrics)
        yield f"A positive factor is chosen in {named}, and has the sign of the method's rule: {words}."
    if turned:
        yield f"The truth is turned to that sign: {'; '.join(_divided(turned))}."
    for (name, words), estimators in apart.items():
        yield f"Metric {name}: {words} ({one_of(estimators)})."
    for (name, words), estimators in counted.items():
        yield f"Metric {name}: {words} ({one_of(estimators)})."
    for name, sentences in said.items():
        yield f"Metric {name}: {'; '.join(sentences)}."
    yield from _in_several_units(plan)
    yield from _not_held(plan)
    yield from _not_tried(plan)
    yield from _by_name(plan)


def _in_several_units(plan: Plan) -> Iterator[str]:
    """Which numbers are in several units, as the forms of the truth that they are errors from differ."""
    cases: dict[tuple[int, str], list[Unit]] = {}
    for unit in plan.units:
        for name in unit.metrics:
            cases.setdefault((unit.data.key, name), []).append(unit)
    said: dict[tuple[str, str], list[str]] = {}
    for (_, name), units in cases.items():
        scored = [(unit.name, unit.metrics[name], unit.estimator) for unit in units]
        data = units[0].data
        for number, label in enumerate(units[0].metrics[name].labels(name)):
            groups = in_units(scored, number, data.system.truth(), data.dt)
            if len(groups) > 1:
                words = "; ".join(map(one_of, groups)), to_one_unit(one[1:] for one in scored)
                _add(said.setdefault(words, []), label)
    for (each, remedy), labels in said.items():
        yield (
            f"Metric {one_of(labels)}: in several units, as each method fixes the factor between the blocks "
            f"by its own rule, and not to be compared across them ({each}): {remedy}."
        )


def _not_held(plan: Plan) -> Iterator[str]:
    """Which methods cannot hold the constant of a true nonlinearity, which biases all that they find."""
    found: dict[str, dict[MissedConstant, list[str]]] = {}
    for unit in plan.units:
        nonlinearity = unit.data.system.truth().nonlinearity
        if nonlinearity is None:
            continue
        if missed := unit.estimator.misses_constant(nonlinearity):
            levels = found.setdefault(unit.name, {}).setdefault(missed, [])
            _add(levels, f"{level_at_zero(nonlinearity):.4g}")
    groups: dict[tuple[str, MissedConstant], list[str]] = {}
    for name, of in found.items():
        for missed, levels in of.items():
            said = one_of(levels) if len(levels) <= _MOST_FACTORS else "another value in each case"
            groups.setdefault((said, missed), []).append(name)
    for (said, missed), names in groups.items():
        yield (
            f"The system's nonlinearity is {said} at zero, and {one_of(names)} "
            f"{_misses(missed, len(names) == 1)}, which biases the estimates: {missed.remedy}."
        )


def _misses(missed: MissedConstant, is_one: bool) -> str:
    """What one method or several do, in words."""
    if missed.is_zero:
        words = f"{'takes' if is_one else 'take'} it to be 0 there"
    else:
        words = f"{'has' if is_one else 'have'} basis functions that hold no constant"
    return words + (f" with {missed.when}" if missed.when else "")


def _not_tried(plan: Plan) -> Iterator[str]:
    """Which candidates a selection leaves out in all trials, as its records do not suit them."""
    found: dict[str, dict[str, list[str]]] = {}
    for unit in plan.units:
        if not isinstance(unit.estimator, Select):
            continue
        if why := unit.estimator.unsuited(unit.data.samples, unit.data.dt):
            shown = [f"{words} ({reason})" for words, reason in itertools.islice(why.items(), _MOST_FACTORS)]
            more = [f"{len(why) - len(shown)} more"] if len(why) > len(shown) else []
            at = one_of(f"{axis} {label}" for axis, label in unit.labels.items())
            _add(found.setdefault(unit.name, {}).setdefault(one_of([*shown, *more]), []), at)
    for name, cases in found.items():
        each = (said + (f" at {'; '.join(where)}" if any(where) else "") for said, where in cases.items())
        yield f"Estimator {name} leaves out what its records do not suit: {'; '.join(each)}."


def _by_name(plan: Plan) -> Iterator[str]:
    """Which coefficients stand beside others of their name that are, or may be, other quantities."""
    quantities: dict[tuple[str, str], dict[str | None, list[str]]] = {}
    systems: set[tuple[str, str]] = set()
    for unit in plan.units:
        true = unit.data.system.truth().values
        for name, metric in unit.metrics.items():
            for value in _coefficients(metric, unit):
                one = name, value
                _add(
                    quantities.setdefault(one, {}).setdefault(quantity_of(value, unit.estimator), []),
                    unit.name,
                )
                systems |= {one} if value in true else set()
    notes: dict[tuple[str, str, str], list[str]] = {}
    for (name, value), of in quantities.items():
        for before, after in _doubts(of, (name, value) in systems):
            _add(notes.setdefault((name, before, after), []), value)
    for (name, before, after), values in notes.items():
        yield f"Metric {name}: {before}: {one_of(values)}{after}."


def _doubts(of: Mapping[str | None, list[str]], in_system: bool) -> Iterator[tuple[str, str]]:
    """What is to be said of a name, given the estimators to which it is each quantity (None: not said).

    It stands before and after the name.
    """
    known = {what: names for what, names in of.items() if what is not None}
    if len(known) > 1:
        each = "; ".join(f"{what} ({one_of(names)})" for what, names in known.items())
        yield "several quantities have one name", f": {each}"
    silent, others = of.get(None, []), [name for names in known.values() for name in names]
    others += ["the system"] * in_system
    if silent and len(silent) + len(others) > 1:
        beside = f" with {one_of(others)}" if others else ""
        yield (
            "compared by name alone, as 'letters' does not say what they are",
            f" of {one_of(silent)}{beside}",
        )


def _coefficients(metric: MetricSpec, unit: Unit) -> Iterator[str]:
    """The coefficients of the estimate that a metric scores, without standard errors."""
    for need in sorted(metric.needs_of_estimate()):
        value = need.removeprefix("value ")
        is_known = quantity_of(value, unit.estimator) is not None
        if value != need and not value.startswith("se_") and (is_known or unsaid([value], unit.estimator)):
            yield value


def _add(names: list[str], name: str) -> None:
    if name not in names:
        names.append(name)


def _rules(unit: Unit, name: str) -> Iterator[str]:
    """The rules on which a score depends, in words."""
    metric, estimator = unit.metrics[name], unit.estimator
    if not is_as_declared(metric) and not keeps_sign(metric):
        return
    if estimator.normalisations() is None:
        # Of a whole response no factor is free.
        if metric.compares() - {"response"}:
            yield "not stated"
        return
    for rule, _ in governed(metric, estimator):
        yield rule.said(unit.data.system.truth(), unit.data.dt)


def _taken_off(metric: MetricSpec, unit: Unit) -> str:
    """What is chosen for the least error though nothing is written, because the method leaves it open."""
    if not isinstance(metric, Comparing) or metric.up_to is not None:
        return ""
    words, settings = _as_left_open(metric, unit).left_in_words(), _settings_that_leave(metric, unit)
    # One metric scores all trials of a selection, whatever each has chosen.
    return f"{words}{settings}: so in all trials" if settings else words


def _counted(metric: MetricSpec, unit: Unit) -> str:
    """What is not chosen though the method leaves it open, because something else is written."""
    if not isinstance(metric, Comparing) or not metric.up_to:
        return ""
    if not (left := [one for one in _left_open(metric, unit) if one not in metric.up_to]):
        return ""
    remedy = ", ".join([*metric.up_to, *left])
    settings = _settings_that_leave(metric, unit)
    return (
        f"{in_words(left)} counts, which the method leaves open{settings}, unless 'up_to: [{remedy}]' is "
        "written"
    )


def _left_open(metric: Comparing, unit: Unit) -> Sequence[Freedom]:
    """What the metric would choose where nothing is written: what the method leaves open."""
    return _as_left_open(metric, unit).up_to or ()


def _settings_that_leave(metric: Comparing, unit: Unit) -> str:
    """With which settings of a selection something is left open, in words; nothing if it is with all."""
    if not isinstance(unit.estimator, Select):
        return ""
    blank = metric.model_copy(update={"up_to": None})
    every = [completed(blank, candidate, unit.data.dt) for candidate in unit.estimator.candidates]
    settings = unit.estimator.settings_with([isinstance(one, Comparing) and bool(one.up_to) for one in every])
    return f" with {settings}" if settings else ""


def _as_left_open(metric: Comparing, unit: Unit) -> Comparing:
    """The metric as it scores the unit where nothing is written."""
    complete = completed(metric.model_copy(update={"up_to": None}), unit.estimator, unit.data.dt)
    assert isinstance(complete, Comparing)
    return complete


def _alike(rules: Mapping[str, dict[str, list[str]]]) -> Iterator[tuple[str, list[str]]]:
    """The rules of each metric in words, with all metrics that have these."""
    groups: dict[str, list[str]] = {}
    for name, of_metric in rules.items():
        groups.setdefault(_in_words(of_metric), []).append(name)
    yield from groups.items()


def _divided(factors: dict[str, dict[str, list[str]]]) -> Iterator[str]:
    """What the blocks are divided by for each estimator."""
    for name, places in factors.items():
        each = (
            f"{_PLACES.get(place, place)} divided by "
            + (one_of(values) if len(values) <= _MOST_FACTORS else "a factor of each case")
            for place, values in places.items()
        )
        yield f"{one_of(each)} ({name})"


def _in_words(rules: dict[str, list[str]]) -> str:
    if len(rules) == 1:
        return next(iter(rules))
    return "; ".join(f"{rule} ({one_of(estimators)})" for rule, estimators in rules.items())
