"""Alternatives: the same experiment with a plausible mistake in it, or in another reading of the paper.

An alternative is one more axis with a single label, whose patches come after those of all cases. The units
that it touches are run on the same seed; what a printed number says about it is for the ledger.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from hident.config.load import Document, Problem
from hident.config.suggest import did_you_mean, one_of, there_is_no
from hident.engine.cases import sound_axes
from hident.engine.experiment import Plan, Statistic, Unit, load
from hident.errors import ConfigError

AXIS = "alternative"
STATISTIC = "statistic"
AT = "at"
_EVERY = "*"
_REPORTS = ("tables", "figures", "alternatives")
_STATISTICS: tuple[Statistic, ...] = ("mean", "median", "std")


def alternative_plan(plan: Plan, name: str, trials: int | None = None) -> Plan:
    """The plan of an alternative: its units alone, of so many trials, beside the printed numbers.

    ConfigError if what the alternative sets does not exist, is not sound, or changes nothing.
    """
    document, changes = plan.document, dict(plan.experiment.alternatives[name])
    at = ("alternatives", name)
    document = _restricted(document, name, changes.pop(AT, {}))
    statistic = changes.pop(STATISTIC, None)
    if statistic not in (None, *_STATISTICS):
        message = f"must be one of {one_of(_STATISTICS)}"
        raise document.error([Problem((*at, STATISTIC), message, statistic)])
    options = {"trials": plan.trials if trials is None else trials, "seed": plan.seed}
    patched = _patched(document, name, _paths(document, name, changes))
    try:
        found = load(patched, (), options).changed(trial_timeout=plan.trial_timeout)
    except ConfigError as error:
        said = str(error).replace(f"cases.{AXIS}", "alternatives")
        lines = (f"{line} (alternative '{name}')" for line in said.splitlines())
        raise ConfigError("\n".join(lines)) from None
    if changes:
        known = {key for keys in plan.keys for key in keys.values()}
        units = [
            replace(
                unit,
                metrics={metric: unit.metrics[metric] for metric, key in keys.items() if key not in known},
            )
            for unit, keys in zip(found.units, found.keys, strict=True)
        ]
        if not any(unit.metrics for unit in units):
            raise document.error([Problem(at, "changes no estimate: it is what the file holds")])
        found = replace(found, units=tuple(filter(None, map(partial(_judged, found), units))))
        if not found.units:
            raise document.error([Problem(at, "changes no estimate that stands beside a printed number")])
    if statistic is None:
        return found
    published = found.experiment.published
    assert published is not None
    cells = tuple(
        cell.model_copy(update={"statistic": statistic})
        for cell in published.cells
        if changes or cell.statistic != statistic
    )
    if not cells:
        raise document.error([Problem((*at, STATISTIC), "is the statistic of every number", statistic)])
    experiment = found.experiment.model_copy(
        update={"published": published.model_copy(update={"cells": cells})}
    )
    return replace(found, experiment=experiment)


def _judged(plan: Plan, unit: Unit) -> Unit | None:
    """The unit with the metrics that stand beside printed numbers; None if none does."""
    assert plan.experiment.published is not None
    labels = {
        metric
        for cell in plan.experiment.published.cells
        if cell.estimator == unit.name and unit.is_at(cell.at)
        for _, metric in cell.pairs()
    }
    metrics = {name: spec for name, spec in unit.metrics.items() if not labels.isdisjoint(spec.labels(name))}
    return replace(unit, metrics=metrics) if metrics else None


def alternative_plans(plan: Plan, trials: int | None = None) -> dict[str, Plan]:
    """The plans of all alternatives by their names.

    ConfigError with what is wrong with any, or if there are alternatives to nothing.
    """
    experiment = plan.experiment
    if experiment.alternatives and experiment.published is None:
        message = "needs 'published', the printed numbers that may tell them apart"
        raise plan.document.error([Problem(("alternatives",), message)])
    found, said = {}, []
    for name in experiment.alternatives:
        try:
            found[name] = alternative_plan(plan, name, trials)
        except ConfigError as error:
            said += str(error).splitlines()
    if said:
        raise ConfigError("\n".join(dict.fromkeys(said)))
    return found


def _restricted(document: Document, name: str, at: Any) -> Document:
    """The document with the cases alone that an alternative's ``at`` names.

    They come first on their axes, as the first label of every axis completes the file.
    """
    place = ("alternatives", name, AT)
    if not isinstance(at, Mapping):
        raise document.error([Problem(place, "must name labels of axes, as 'at' of a table's row does", at)])
    if not at:
        return document
    cases = dict(document.data.get("cases") or {})
    known = {axis.name: list(map(str, axis.labels)) for axis in sound_axes(document, [])}
    skip, problems = list(document.data.get("skip") or ()), []
    for axis, written in at.items():
        named = [str(label) for label in (written if isinstance(written, list) else [written])]
        if axis not in known:
            problems.append(Problem((*place, axis), there_is_no("axis", axis, known)))
            continue
        wrong = [label for label in named if label not in known[axis]]
        problems += [Problem((*place, axis), there_is_no("label", label, known[axis])) for label in wrong]
        is_other = [label not in named for label in known[axis]]
        if any(is_other):
            skip.append({axis: [label for label in known[axis] if label not in named]})
        order = sorted(range(len(is_other)), key=is_other.__getitem__)
        entries = cases[axis]
        if isinstance(entries, Mapping):
            items = list(entries.items())
            cases[axis] = dict(items[i] for i in order)
        else:
            cases[axis] = [entries[i] for i in order]
    if problems:
        raise document.error(problems)
    return replace(document, data={**document.data, "cases": cases, "skip": skip})


def _patched(document: Document, name: str, changes: Mapping[str, Any]) -> Document:
    """The document without its reports, and with the alternative as its last axis."""
    data = {key: value for key, value in document.data.items() if key not in _REPORTS}
    if not changes:
        return replace(document, data=data)
    cases = data.get("cases") or {}
    place = document.place(("alternatives", name))
    if AXIS in cases:
        raise document.error([Problem(("cases", AXIS), "is kept for the alternatives: take another name")])
    data["cases"] = {**cases, AXIS: {name: dict(changes)}}
    return replace(document, data=data, patches={**document.patches, ("cases", AXIS): place})


def _paths(document: Document, name: str, changes: Mapping[str, Any]) -> dict[str, Any]:
    """What it sets, by key paths without a ``*``, which stands for every entry that holds the rest."""
    found: dict[str, Any] = {}
    for path, value in changes.items():
        paths = list(_spelled_out(document.data, path))
        if not paths:
            near = did_you_mean(path, _known_paths(document.data))
            raise document.error([Problem(("alternatives", name, path), f"leads nowhere{near}")])
        found |= dict.fromkeys(paths, value)
    return found


def _spelled_out(data: Mapping[str, Any], path: str) -> Iterator[str]:
    head, star, rest = path.partition(f".{_EVERY}.")
    if not star:
        yield path
        return
    entries = data.get(head)
    for entry, held in entries.items() if isinstance(entries, Mapping) else ():
        at: Any = held
        for key in rest.split("."):
            at = at.get(key, None) if isinstance(at, Mapping) else None
        if at is not None:
            yield f"{head}.{entry}.{rest}"


def _known_paths(data: Mapping[str, Any]) -> set[str]:
    """The key paths with ``*`` that would lead somewhere."""
    return {
        f"{section}.{_EVERY}.{key}"
        for section in ("estimators", "metrics")
        if isinstance(entries := data.get(section), Mapping)
        for held in entries.values()
        if isinstance(held, Mapping)
        for key in held
    }
