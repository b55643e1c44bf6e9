"""How the metrics of a run score, in a line of words for its tables."""

from __future__ import annotations

from collections.abc import Iterator

from hident.config.suggest import one_of
from hident.engine.comparable import governed
from hident.engine.experiment import Plan, Unit


def scoring(plan: Plan) -> Iterator[str]:
    """Where absolute values are compared, by which rule, and what each metric says of itself: sentences."""
    rules: dict[str, dict[str, list[str]]] = {}
    said: dict[str, list[str]] = {}
    for unit in plan.units:
        for name, metric in unit.metrics.items():
            for rule in _rules(unit, name):
                _add(rules.setdefault(name, {}).setdefault(rule, []), unit.name)
            if words := metric.says(unit.data.dt):
                _add(said.setdefault(name, []), words)
    groups: dict[str, list[str]] = {}
    for name, of_metric in rules.items():
        groups.setdefault(_in_words(of_metric), []).append(name)
    for words, metrics in groups.items():
        named = one_of(metrics)
        yield f"Absolute values are compared in {named}; the free factor between the blocks: {words}."
    for name, sentences in said.items():
        yield f"Metric {name}: {'; '.join(sentences)}."


def _add(names: list[str], name: str) -> None:
    if name not in names:
        names.append(name)


def _rules(unit: Unit, name: str) -> Iterator[str]:
    """The rules on which a score depends, in words."""
    metric, estimator = unit.metrics[name], unit.estimator
    if estimator.normalisations() is None:
        # Of a whole response no factor is free.
        if metric.compares() - {"response"}:
            yield "not stated"
        return
    for rule, _ in governed(metric, estimator):
        yield rule.rule


def _in_words(rules: dict[str, list[str]]) -> str:
    if len(rules) == 1:
        return next(iter(rules))
    return "; ".join(f"{rule} ({one_of(estimators)})" for rule, estimators in rules.items())
