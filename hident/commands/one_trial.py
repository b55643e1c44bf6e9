"""One trial of a configuration, made again: the verb show."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from hident.commands.exporting import ESTIMATE, RECORD, estimate_rows, record_rows, write_rows
from hident.commands.models import save_figure
from hident.commands.showing import print_columns
from hident.config.suggest import one_of, there_is_no
from hident.engine.experiment import Label, Plan, Unit
from hident.engine.replay import OneTrial, Realised, replayed
from hident.engine.run_files import SHOWN
from hident.engine.runner import reached
from hident.engine.store import Reader, Store
from hident.engine.trial import OF_METRIC
from hident.engine.work import pin_blas
from hident.errors import ConfigError, Exit, NothingToCompare
from hident.new_files import made_folder

_MOST_FAILURES = 40
"""The failed trials that are listed; of more, the first."""
_UNSAFE = re.compile(r"[^\w.+-]+")


@dataclass(frozen=True)
class Wanted:
    """What is to be shown: a trial by its number, or the one that is worst or best by a metric."""

    trial: int | None = None
    worst: str | None = None
    best: str | None = None
    failed: bool = False
    estimator: str | None = None
    cases: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        given = {
            "--trial": self.trial is not None,
            "--worst": self.worst is not None,
            "--best": self.best is not None,
            "--failed": self.failed,
        }
        if sum(given.values()) > 1:
            named = " and ".join(name for name, there in given.items() if there)
            raise ConfigError(f"{named} cannot stand together: each names what is shown")


def show_trial(plan: Plan, folder: Path, wanted: Wanted, out: Path | None, *, parquet: bool) -> Exit:
    """Print what one trial of a plan gave, and write its record, estimates and a figure.

    The folder is ``out``, or by default one for the trial in that of the run. The scores are held against
    those that are stored, if they are: they differ where something is wrong, and the exit code says so.

    Raises
    ------
    ConfigError
        If what is wanted does not exist.
    NothingToCompare
        If a trial is to be found among those that are stored, and none is.
    TrialsCrashed
        If the trial ends in an error that is no result.
    """
    units = _meant(plan, wanted)
    with Store(folder).reading() as reader:
        plan = reached(plan, reader)
        if wanted.failed:
            _print_failed(plan, reader, units)
            return Exit.FINE
        number = wanted.trial or 0
        if (label := wanted.worst or wanted.best) is not None:
            unit, number = _odd(plan, reader, units, label, worst=wanted.worst is not None)
            print(f"{label} is {'worst' if wanted.worst else 'best'} in trial {number} of {unit.described()}")
            units = [one for one in units if one.data.key == unit.data.key]
        stored = {id(unit): _stored(plan, reader, unit) for unit in units}
    # One case: that of the first estimate that is meant.
    units = [unit for unit in units if unit.data.key == units[0].data.key]
    for unit in units if number else ():
        if said := unit.data.unrepeatable(unit.estimator):
            raise ConfigError(f"trial {number}: {said}")
    pin_blas()
    trial = OneTrial(plan, number)
    shown = {unit_name: (unit, replayed(trial, unit)) for unit_name, unit in _named(units).items()}
    folder = out or Path("out") / plan.name / f"{SHOWN}{number}" / _case_folder(plan, units[0])
    files = _write(trial, shown, made_folder(folder), parquet=parquet)
    case = _case(units)
    print(f"{plan.name}: trial {number}{f' at {case}' if case else ''}, seed {plan.seed}")
    differing = _print_scores(trial, shown, stored)
    for name, (_, realised) in shown.items():
        if realised.failure:
            print(f"{name} failed: {realised.failure}")
    print(f"{folder}: {one_of(files)}")
    return Exit.DIFFERS if differing else Exit.FINE


def _meant(plan: Plan, wanted: Wanted) -> list[Unit]:
    """The units that the options leave."""
    names = list(dict.fromkeys(unit.name for unit in plan.units))
    if wanted.estimator is not None and wanted.estimator not in names:
        raise ConfigError(f"--estimator: {there_is_no('estimator', wanted.estimator, names)}")
    labels: dict[str, Label] = {}
    for text in wanted.cases:
        axis, label = _label(plan, text)
        if axis in labels:
            raise ConfigError(f"--case {text}: {axis}={labels[axis]} is given already, and one case is shown")
        labels[axis] = label
    found = [unit for unit in plan.units if wanted.estimator in (None, unit.name) and unit.is_at(labels)]
    if not found:
        at = ", ".join(f"{axis} {label}" for axis, label in labels.items())
        raise ConfigError(f"there is no estimate of '{wanted.estimator or one_of(names)}' at {at}")
    return found


def _label(plan: Plan, text: str) -> tuple[str, Label]:
    """The axis and the label that ``--case AXIS=LABEL`` means."""
    axes = {axis.name: axis.labels for axis in plan.axes}
    name = next((axis for axis in axes if text.startswith(f"{axis}=")), None)
    if name is None:
        written, equals, _ = text.partition("=")
        if not equals:
            raise ConfigError(f"--case {text}: must be AXIS=LABEL")
        raise ConfigError(f"--case {text}: {there_is_no('axis', written, axes)}")
    written = text.removeprefix(f"{name}=")
    label = next((one for one in axes[name] if str(one) == written), None)
    if label is None:
        raise ConfigError(f"--case {text}: {there_is_no(f'label of {name}', written, map(str, axes[name]))}")
    return name, label


def _odd(plan: Plan, reader: Reader, units: Sequence[Unit], label: str, *, worst: bool) -> tuple[Unit, int]:
    """The unit and the stored trial that are worst, or best, by a metric."""
    labels = dict.fromkeys(one for unit in units for one in unit.metric_labels)
    if label not in labels:
        raise ConfigError(f"--{'worst' if worst else 'best'}: {there_is_no('metric', label, labels)}")
    found: list[tuple[float, Unit, int]] = []
    stored = 0
    for unit in units:
        for name, metric in unit.metrics.items():
            if label not in metric.labels(name):
                continue
            stored += reader.counted(unit.keys(plan.seed, plan.perturbation)[name], plan.trials).trials
            values = _series(plan, reader, unit, name)[:, metric.labels(name).index(label)]
            # Least is best from here on.
            badness = -values if metric.best == "highest" else np.abs(values)
            if np.isfinite(badness).any():
                place = int((np.nanargmax if worst else np.nanargmin)(badness))
                found.append((float(badness[place]), unit, place))
    if not found and stored:
        raise NothingToCompare(
            f"{label} is a number in none of the {stored} stored trials: "
            f"hident show {plan.path} --failed says why"
        )
    if not found:
        raise NothingToCompare(f"no trial with {label} is stored: hident run {plan.name}")
    _, unit, number = (max if worst else min)(found, key=lambda one: one[0])
    return unit, number


def _series(plan: Plan, reader: Reader, unit: Unit, metric: str) -> np.ndarray:
    """The stored values (N, labels) of a metric; nan where none is."""
    key = unit.keys(plan.seed, plan.perturbation)[metric]
    values = np.full((plan.trials, len(unit.metrics[metric].labels(metric))), np.nan)
    for scores in reader.trials(key, plan.trials):
        values[scores.trials] = scores.values
    return values


@dataclass(frozen=True, eq=False)
class _Series:
    """The stored values (N,) of a label, and whether each trial is stored.

    ``by_modulus`` is whether they are the better the nearer they are to zero, from either side.
    """

    values: np.ndarray
    there: np.ndarray
    by_modulus: bool


def _stored(plan: Plan, reader: Reader, unit: Unit) -> dict[str, _Series]:
    found: dict[str, _Series] = {}
    for name, metric in unit.metrics.items():
        key = unit.keys(plan.seed, plan.perturbation)[name]
        there = np.zeros(plan.trials, dtype=bool)
        for scores in reader.trials(key, plan.trials):
            there[scores.trials] = True
        values = _series(plan, reader, unit, name)
        signed = metric.best == "zero"
        found |= {label: _Series(values[:, i], there, signed) for i, label in enumerate(metric.labels(name))}
    return found


def _print_failed(plan: Plan, reader: Reader, units: Sequence[Unit]) -> None:
    """List the stored trials that failed, with the reasons."""
    rows, example = [("estimator", "case", "trial", "reason")], ""
    for unit in units:
        found = [*_failures(plan, reader, unit)]
        rows += [(unit.name, _labels(unit.labels), *row) for row in found]
        if found and not example:
            cases = [word for a, x in unit.labels.items() for word in ("--case", f"{a}={x}")]
            words = [str(plan.path), "--trial", found[0][0], "--estimator", unit.name, *cases]
            example = shlex.join(["hident", "show", *words])
    if len(rows) == 1:
        keys = {key for unit in units for key in unit.keys(plan.seed, plan.perturbation).values()}
        count = max(reader.counted(key, plan.trials).trials for key in keys)
        if not count:
            raise NothingToCompare(f"no trial is stored: hident run {plan.name}")
        print(f"{plan.name}: none of the {count} stored trials failed")
        return
    print_columns(rows[: _MOST_FAILURES + 1])
    if (more := len(rows) - 1 - _MOST_FAILURES) > 0:
        print(f"and {more} more: hident export {plan.name} FILE.csv has all")
    print(f"one of them: {example}")


def _failures(plan: Plan, reader: Reader, unit: Unit) -> Iterator[tuple[str, str]]:
    said: dict[int, dict[str, None]] = {}
    for name, key in unit.keys(plan.seed, plan.perturbation).items():
        for scores in reader.trials(key, plan.trials):
            for trial, reason in scores.failures.items():
                own = reason.removeprefix(OF_METRIC)
                said.setdefault(trial, {})[reason if own == reason else f"{name}: {own}"] = None
            for row in np.flatnonzero(~np.isfinite(scores.values).all(axis=1)).tolist():
                if (trial := int(scores.trials[row])) not in scores.failures:
                    said.setdefault(trial, {})[f"{name}: a value is not finite"] = None
    for trial in sorted(said):
        yield str(trial), "; ".join(said[trial])


def _named(units: Sequence[Unit]) -> dict[str, Unit]:
    """The units of a case by names that tell them apart: an estimator may stand there at several labels."""
    alike = {unit.name for unit in units if sum(other.name == unit.name for other in units) > 1}
    common = dict(set.intersection(*(set(unit.labels.items()) for unit in units)))
    return {
        f"{unit.name}, {_labels({a: x for a, x in unit.labels.items() if a not in common})}"
        if unit.name in alike
        else unit.name: unit
        for unit in units
    }


def _case(units: Sequence[Unit]) -> str:
    common = set.intersection(*(set(unit.labels.items()) for unit in units))
    return _labels({axis: label for axis, label in units[0].labels.items() if (axis, label) in common})


def _labels(labels: Mapping[str, Label]) -> str:
    return ", ".join(f"{axis} {label}" for axis, label in labels.items())


def _case_folder(plan: Plan, unit: Unit) -> str:
    """The name of the case's folder inside the trial's; none where there is one case."""
    cases = list(dict.fromkeys(one.data.key for one in plan.units))
    if len(cases) == 1:
        return "."
    of_case = [one.labels for one in plan.units if one.data.key == unit.data.key]
    common = {a: x for a, x in of_case[0].items() if all(other.get(a) == x for other in of_case)}
    words = "_".join(f"{axis}_{label}" for axis, label in common.items())
    return f"case-{cases.index(unit.data.key) + 1}_{_UNSAFE.sub('-', words)[:80]}"


def _write(
    trial: OneTrial, shown: Mapping[str, tuple[Unit, Realised]], folder: Path, *, parquet: bool
) -> list[str]:
    """Write the files of a trial; their names."""
    from hident.engine.estimate_curves import curves
    from hident.reports.style import LINES
    from hident.reports.trial_figure import trial_figure

    suffix, files = "parquet" if parquet else "csv", []
    first, realised = next(iter(shown.values()))
    noise_free = trial.noise_free(first.data)
    records = {"": realised.record}
    if first.data.resampled and trial.number:
        records = {f"_{_UNSAFE.sub('-', name)}": made.record for name, (_, made) in shown.items()}
    for name, record in records.items():
        if record is not None:
            files.append(f"record{name}.{suffix}")
            write_rows(folder / files[-1], RECORD, record_rows(record, noise_free))
            if record.validation is not None and not name:
                files.append(f"validation.{suffix}")
                write_rows(folder / files[-1], RECORD, record_rows(record.validation, None))
    made = {name: one for name, (_, one) in shown.items() if one.found is not None}
    if made:
        files.append(f"estimates.{suffix}")
        rows = ((name, *row) for name, one in made.items() for row in estimate_rows(one))
        write_rows(folder / files[-1], ("estimator", *ESTIMATE), rows)
    files.append(f"scores.{suffix}")
    scores = (
        (name, label, value, failure)
        for name, (unit, _) in shown.items()
        for label, (value, failure) in trial.scores(unit).items()
    )
    write_rows(folder / files[-1], ("estimator", "metric", "value", "failure"), scores)
    if (record := realised.record) is not None:
        found = {name: list(curves(one)) for name, one in made.items()}
        # No more estimates in one figure than can be told apart.
        names, most = list(found), len(LINES)
        for first_name in range(0, max(len(names), 1), most):
            together = {name: found[name] for name in names[first_name : first_name + most]}
            files.append(f"trial-{first_name // most + 1}.png" if first_name else "trial.png")
            save_figure(folder / files[-1], partial(trial_figure, record, noise_free, together, trial.number))
    return files


def _print_scores(
    trial: OneTrial,
    shown: Mapping[str, tuple[Unit, Realised]],
    stored: Mapping[int, Mapping[str, _Series]],
) -> bool:
    """Print the scores beside those of all stored trials; whether one is not what is stored."""
    rows = [("estimator", "metric", "here", "median of all", "smaller than here", "")]
    differing = False
    for name, (unit, _) in shown.items():
        for label, (value, failure) in trial.scores(unit).items():
            known = stored[id(unit)][label]
            there = trial.number < len(known.there) and bool(known.there[trial.number])
            said = "" if there else "not stored"
            if there and not _same(value, known.values[trial.number]):
                said, differing = f"stored is {float(known.values[trial.number])!r}", True
            others = known.values[np.isfinite(known.values)]
            median = f"{np.median(others):.4g}" if len(others) else "-"
            here, share = value, "-"
            if known.by_modulus:
                others, here = np.abs(others), np.abs(here)
            if len(others) and not failure:
                modulus = " by modulus" * known.by_modulus
                share = f"{100.0 * np.mean(others < here):.0f} %{modulus}"
            rows.append((name, label, "failed" if failure else f"{value:.6g}", median, share, said))
    print_columns(rows)
    if differing:
        print("the scores differ from those that the run stored, which must not be: hident doctor")
    return differing


def _same(one: float, other: float) -> bool:
    return one == other or (np.isnan(one) and np.isnan(other))
