"""``of: all``: every value that a metric can score, or that the metric of a table or a figure scores.

``estimators: all`` of a table or a figure are those that its metric scores.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from hident.config.load import Document, Problem
from hident.config.spec import Of
from hident.config.yaml12 import Complaint
from hident.engine.comparable import compared_values, other_quantities
from hident.engine.expansion import not_given
from hident.estimators.base import EstimatorSpec
from hident.metrics.base import MetricSpec
from hident.systems.base import SystemSpec

ALL = "all"
_OF_A_VALUE = "value "


def with_every_value(document: Document, first: Document, complaints: list[Complaint]) -> Document:
    """The document with names in the place of ``of: all``; ``first`` is it at the first label of every axis.

    A metric's are in the order of their names, numbers in them by size; those of a table or a figure in the
    order of its metric's.
    """
    for section in ("metrics", "tables", "figures"):
        entries = document.data.get(section)
        for name, entry in entries.items() if isinstance(entries, Mapping) else ():
            if not isinstance(entry, Mapping):
                continue
            if section != "metrics" and entry.get("estimators") == ALL:
                at = (section, name, "estimators")
                document = document.patched(".".join(at), _scoring(document, entry), document.place(at))
            if entry.get("of") != ALL:
                continue
            at = (section, name, "of")
            found = list(_scored(first, entry) if section == "metrics" else _shown(document, entry))
            if found:
                document = document.patched(".".join(at), found, document.place(at))
            elif section == "metrics":
                message = "no value is given by all that it scores: name the values, or 'estimators'"
                complaints += document.complaints_of([Problem(at, message, ALL)])
            else:
                message = "'metric' must be the name of a metric whose values have names"
                if "table" in entry:
                    message = "'table' must be the name of a table that holds named values"
                complaints += document.complaints_of([Problem(at, message, ALL)])
    return document


def _shown(document: Document, entry: Mapping[str, Any]) -> list[str]:
    """The values of the metric of a table or a figure, or of the table that a figure draws."""
    tables, table = document.data.get("tables"), entry.get("table")
    if isinstance(tables, Mapping) and isinstance(table, str) and isinstance(tables.get(table), Mapping):
        return _listed(tables[table].get("of"))
    metrics, name = document.data.get("metrics"), entry.get("metric")
    metric = metrics.get(name) if isinstance(metrics, Mapping) and isinstance(name, str) else None
    return _listed(metric.get("of")) if isinstance(metric, Mapping) else []


def _scoring(document: Document, entry: Mapping[str, Any]) -> list[str]:
    """The estimators that the metric of a table or a figure scores: all, if it does not name them."""
    metrics, estimators = document.data.get("metrics"), document.data.get("estimators")
    label = entry.get("metric")
    for name, metric in metrics.items() if isinstance(metrics, Mapping) else ():
        # A label is the name of its metric, or that and the name of a value.
        named = isinstance(label, str) and f"{label} ".startswith(f"{name} ")
        if named and isinstance(metric, Mapping) and (written := _listed(metric.get("estimators"))):
            return written
    return list(estimators) if isinstance(estimators, Mapping) else []


def _listed(written: Any) -> list[str]:
    return written if isinstance(written, list) else []


def _scored(first: Document, metric: Mapping[str, Any]) -> list[str]:
    """The values that a metric can score of every estimator that it is for."""
    known = first.data.get("estimators")
    every = known if isinstance(known, Mapping) else {}
    written = metric.get("estimators")
    names = [one for one in written if isinstance(one, str)] if isinstance(written, list) else list(every)
    try:
        system = _system(first)
        estimators = [Of("estimator").validate(every[name]) for name in names if name in every]
    except ValidationError:
        # Which is told as well.
        return []
    specs = [e for e in estimators if isinstance(e, EstimatorSpec)]
    true, estimated = frozenset() if system is None else system.provides(), [e.provides() for e in specs]
    prefix = metric.get("prefix", "")
    candidates = {
        name.removeprefix(_OF_A_VALUE).removeprefix(prefix if isinstance(prefix, str) else "")
        for provided in (true, *estimated)
        for name in provided
        if name.startswith(_OF_A_VALUE)
    }
    return sorted(
        (name for name in candidates if _scores({**metric, "of": [name]}, system, specs)), key=_by_size
    )


def _system(first: Document) -> SystemSpec | None:
    """The system, of which nothing is known behind a measured record."""
    if first.data.get("record") is not None:
        return None
    system = Of("system").validate(first.data.get("system"))
    assert isinstance(system, SystemSpec)
    return system


def _scores(metric: Mapping[str, Any], system: SystemSpec | None, estimators: list[EstimatorSpec]) -> bool:
    try:
        spec = Of("metric").validate(metric)
    except ValidationError:
        return False
    assert isinstance(spec, MetricSpec)
    true = frozenset[str]() if system is None else system.provides()
    if not_given(spec.needs_of_truth(), true):
        return False
    return not any(
        not_given(spec.needs_of_estimate(), one.provides())
        or (system is not None and other_quantities(compared_values(spec), one, system.truth()))
        for one in estimators
    )


def _by_size(name: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name)]
