"""From a file of samples to a model: the verb identify."""

from __future__ import annotations

import os
import shlex
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np
import yaml

from hident import __version__
from hident.arrays import Array
from hident.block_chain import Beginning, Block
from hident.commands.looking import delay_in_words
from hident.commands.measured import record_of
from hident.commands.models import draw_model, save_figure
from hident.commands.showing import print_columns
from hident.config.spec import canonical
from hident.config.suggest import counted, did_you_mean, none_of, one_of
from hident.engine.work import pin_blas
from hident.errors import ConfigError, EstimationError
from hident.estimators.base import varies
from hident.fitted_model import FittedModel
from hident.identification.bootstrap import Bootstrap, bootstrap
from hident.identification.candidates import STRUCTURES
from hident.identification.identify import By, Identification, Trial, identify
from hident.linear_blocks import TransferFunction
from hident.measurements.first_look import first_look
from hident.measurements.measured_record import MeasuredRecord
from hident.models.formulas import formulas
from hident.models.model_file import write_model
from hident.new_files import made_folder, replacing
from hident.numerics.judgement import Residuals
from hident.numerics.parts import Parts
from hident.records import Record

_SHOWN_OF_EACH = 3
# Of more samples than this a figure shows so many, where the output varies most.
_MOST_SHOWN, _SHOWN = 2000, 500
_EVERY = 20.0
# Said of the samples kept apart, if more than this share has inputs that were not fitted; so many are listed.
_MUCH, _LISTED = 0.05, 5
# Said of a model, if more than this share of its numbers is below their standard errors.
_UNDETERMINED = 1.0 / 3.0
# A fit below this, in percent, explains next to nothing.
_POOR = 20.0
# A lower one is a number without a meaning.
_LEAST_SHOWN = -1e4


def identify_file(
    files: Sequence[Path],
    structures: Sequence[str],
    by: str,
    n_init: int | None,
    start: str,
    delay: int | None,
    bootstraps: int,
    out: Path | None,
    **options: Any,
) -> None:
    """Fit structures to the record of some files, print what came out, and write it to a folder.

    Raises
    ------
    ConfigError
        If the record cannot be read, a structure is unknown, or nothing could be fitted.
    """
    for name in structures:
        if name not in STRUCTURES:
            near = did_you_mean(name, list(STRUCTURES))
            raise ConfigError(
                f"--structure: unknown structure '{name}'{near} (allowed: {one_of(STRUCTURES)})"
            )
    for option, value, allowed in (
        ("--by", by, get_args(By)),
        ("--start", start, get_args(Beginning)),
    ):
        if value not in allowed:
            raise ConfigError(f"{option}: {none_of(value, allowed)}")
    spec = record_of(files, **options)
    record = spec.read(Path())
    folder = out or Path("out") / f"identify_{files[0].stem}"
    # Before what takes long: a folder that cannot be made would cost it.
    made_folder(folder)
    begun = time.monotonic()
    pin_blas()
    wrong = [*_wrong(record)]
    for sentence in wrong:
        print(f"warning: {sentence}", file=sys.stderr)
    try:
        found = identify(
            record,
            structures or tuple(STRUCTURES),
            by=cast(By, by),
            n_init=n_init,
            start=cast(Beginning, start),
            delay=delay,
            tell=_Progress(begun),
        )
        model = _model(found, record, spec)
        again = bootstrap(found, bootstraps, tell=_Progress(begun).bootstrapped) if bootstraps else None
    except EstimationError as error:
        raise ConfigError(f"{one_of(map(str, files))}: {error}") from None
    finally:
        _clear()
    residuals, verdict = _judged(found)
    lines = list(_said(found, record, model, verdict, again, delay))
    print_columns(_rows(found, record, _SHOWN_OF_EACH))
    for line in lines:
        print(line)
    print(formulas(model))
    written = _write(folder, found, record, spec, model, wrong, lines, residuals, again)
    print(f"\n{folder}: {', '.join(written)} ({time.monotonic() - begun:.0f} s)")


def _wrong(record: Record) -> Iterator[str]:
    """What `hident show` says is wrong with the record, and with that for validation."""
    yield from first_look(record).wrong
    if record.validation is not None:
        yield from (f"For validation: {sentence}" for sentence in first_look(record.validation).wrong)


def _judged(found: Identification) -> tuple[Residuals | None, Sequence[str]]:
    """What is left of the samples kept apart, and the verdict on it."""
    try:
        residuals = found.residuals()
        sentences = residuals.sentences
    except EstimationError as error:
        return None, [str(error)]
    return (None if residuals.vanish else residuals), sentences


class _Progress:
    """A line on a terminal that says what has been tried; elsewhere one from time to time."""

    def __init__(self, begun: float) -> None:
        self.begun, self.count, self.said = begun, 0, begun

    def __call__(self, trial: Trial) -> None:
        self.count += 1
        self._say(f"{self.count} chains tried, {{}}: {trial.structure}")

    def bootstrapped(self, done: int) -> None:
        self._say(f"{counted(done, 'bootstrap')} fitted, {{}}")

    def _say(self, text: str) -> None:
        now = time.monotonic()
        text = text.format(f"{now - self.begun:.0f} s")
        if sys.stderr.isatty():
            print(f"\r{text:70}", end="", file=sys.stderr, flush=True)
        elif now - self.said > _EVERY:
            self.said = now
            print(text, file=sys.stderr, flush=True)


def _clear() -> None:
    if sys.stderr.isatty():
        print(f"\r{'':70}\r", end="", file=sys.stderr, flush=True)


def _model(found: Identification, record: Record, spec: MeasuredRecord) -> FittedModel:
    model = found.estimate(record).model
    assert isinstance(model, FittedModel)
    signals = model.signals(record)[:-1]
    about = {
        **model.about,
        "input": ",".join(map(str, spec.input)),
        "output": ",".join(map(str, spec.output)),
        "units": {name: unit for name, unit in record.units.items() if unit},
        "data": {Path(file).name: MeasuredRecord.digest(_one(spec, file), Path()) for file in spec.file},
        "hident": __version__,
        "command": shlex.join(["hident", *sys.argv[1:]]),
        "chosen_on": found.parts.said,
        "offsets": dict(record.offsets),
        **({"detrend": spec.detrend} if spec.detrend else {}),
    }
    ranges = tuple((float(np.min(x)), float(np.max(x))) for x in signals)
    return replace(model, about=about, ranges=ranges)


def _one(spec: MeasuredRecord, file: str) -> MeasuredRecord:
    return spec.model_copy(update={"file": (file,), "validation": None})


def blocks_in_words(trial: Trial) -> str:
    """The blocks of a trial: ``3/2 z-1`` has 3 numerator coefficients, 2 poles and a delay of 1."""
    words = []
    for block in trial.spec.blocks:
        written = canonical(block)
        match written["kind"]:
            case "linear":
                delay = f" z-{written['nk']}" if written.get("nk") else ""
                words.append(f"{written['nb']}/{written.get('nf', 0)}{delay}")
            case "polynomial":
                words.append(f"degree {written['degree']}")
            case kind:
                words.append(f"{kind.replace('_', ' ')} {written.get('knots', '')}".strip())
    return ", ".join(words)


def _rows(found: Identification, record: Record, most: int | None) -> list[tuple[str, ...]]:
    """The table of what was tried: the best of each structure first."""
    unit = record.units.get("output", "")
    rmse = f"RMSE {unit}".strip()
    head = ("structure", "blocks", "parameters", f"fitted {rmse}", f"kept apart {rmse}")
    rows: list[tuple[str, ...]] = [(*head, "fit %", "AIC", "BIC", "agreeing", "")]
    done = [(i, one) for i, one in enumerate(found.trials) if one.fit is not None]
    order = sorted(done, key=lambda pair: pair[1].worth(found.by))
    seen: dict[str, int] = {}
    for i, one in order:
        seen[one.structure] = seen.get(one.structure, 0) + 1
        if most is not None and seen[one.structure] > most and one is not found.chosen:
            continue
        assert one.fit is not None
        fit = _fit(found, one)
        mark = "chosen" if one is found.chosen else "within one standard error" if i in found.within else ""
        rows.append(
            (
                one.structure,
                blocks_in_words(one),
                str(one.count),
                f"{one.estimation:.4g}",
                f"{one.rms:.4g}",
                "-" if fit is None or fit < _LEAST_SHOWN else f"{fit:.2f}",
                f"{one.aic:.0f}",
                f"{one.bic:.0f}",
                f"{one.fit.agreeing} of {one.fit.finalists}",
                mark,
            )
        )
    return rows


def _fit(found: Identification, trial: Trial) -> float | None:
    """100 (1 - NRMSE) of the samples kept apart; None if their output is constant, and has no spread."""
    output = found.parts.output
    return 100.0 * (1.0 - trial.rms / float(np.std(output))) if varies(output) else None


def _still(found: Identification) -> Iterator[str]:
    """Whether the samples kept apart stand still, and so tell little of a model."""
    for name, signal in (("input", found.parts.input), ("output", found.parts.output)):
        if not varies(signal):
            yield (
                f"warning: the {name} is {signal[0]:g} in all samples kept apart, which tell little of what "
                "is chosen by them: keep others apart (--validate)"
            )


def _beyond(found: Identification) -> Iterator[str]:
    """Where the samples kept apart have other inputs than those that were fitted."""
    fitted, kept = found.parts.everything.u[found.parts.fitted], found.parts.input
    if found.functions.levels is not None:
        beyond = ~np.isin(kept, fitted)
        new = one_of(f"{level:g}" for level in np.unique(kept[beyond])[:_LISTED])
        which = f"levels ({new})"
    else:
        low, high = float(np.min(fitted)), float(np.max(fitted))
        beyond = (kept < low) | (kept > high)
        which = f"values, outside of {low:.4g} to {high:.4g},"
    share = float(np.mean(beyond))
    if share > _MUCH:
        yield (
            f"warning: {100.0 * share:.0f} % of the samples kept apart have input {which} that were not "
            "fitted: what a static function is there is a guess"
        )


def _undetermined(model: FittedModel) -> Iterator[str]:
    """Whether many of a model's parameters are no larger than their standard errors."""
    small = [
        abs(_numbers(block)[name]) <= error
        for block, errors in zip(model.chain.blocks, model.errors, strict=True)
        for name, error in errors.items()
    ]
    if sum(small) > _UNDETERMINED * len(small):
        yield (
            f"warning: {sum(small)} of {len(small)} numbers of the model are below their standard errors: "
            "the record does not determine them, and a chain with fewer may be as good on another record"
        )


def _numbers(block: Block) -> dict[str, float]:
    """The numbers of a block by the names of their standard errors."""
    if isinstance(block, TransferFunction):
        named = {"b": enumerate(block.b), "a": enumerate(block.a, start=1)}
        return {f"{letter}_{k}": value for letter, values in named.items() for k, value in values}
    shape = dict(zip(("low", "high"), block.basis.shape, strict=False))
    return shape | {f"c_{k}": value for k, value in enumerate(block.coefficients, start=1)}


def _said(
    found: Identification,
    record: Record,
    model: FittedModel,
    verdict: Sequence[str],
    again: Bootstrap | None,
    delay: int | None,
) -> Iterator[str]:
    shown = sum(one.fit is not None for one in found.trials)
    yield ""
    by = "the simulation of" if found.by == "validation" else f"{found.by.upper()}; kept apart:"
    yield (
        f"{len(found.trials)} chains tried, {shown} fitted; chosen by {by} {found.parts.said}, "
        f"without the first {found.chosen.spec.n_init} samples of what is fitted"
    )
    in_chain = sum(canonical(block).get("nk", 0) for block in found.chosen.spec.blocks)
    as_given = "" if delay is None else ", as given"
    yield f"delay: {delay_in_words(found.delay, record)}; {in_chain} in the chosen chain{as_given}"
    yield from found.notes
    reasons: dict[str, list[str]] = {}
    for one in found.trials:
        if one.reason:
            reasons.setdefault(one.structure, []).append(one.reason)
    for structure, said in reasons.items():
        yield f"not fitted: {len(said)} of {structure}, such as: {said[0]}"
    yield from _still(found)
    yield from _beyond(found)
    yield from _undetermined(model)
    if found.model_fit.finalists > 1 and found.model_fit.agreeing == 1:
        yield "warning: only one of the starts came to this optimum: there may be a better one"
    fit = _fit(found, found.chosen)
    if fit is not None and fit < _POOR:
        low = f"{fit:.1f}" if fit > _LEAST_SHOWN else f"below {_LEAST_SHOWN:.0f}"
        yield (
            f"warning: the best of these explains next to nothing (fit {low} %): are these the right "
            "columns, is the system stable, does the input vary enough? `hident show` says more"
        )
    if found.parts.everything is not found.parts.estimation:
        yield "the chosen chain was then fitted to all samples"
    yield "what it leaves of the samples kept apart:"
    yield from (f"- {sentence}" for sentence in verdict)
    if again is not None:
        failed = f", {again.failed} more failed" if again.failed else ""
        bootstraps = counted(len(again.chains), "bootstrap")
        yield f"bands: {bootstraps} of the residuals in blocks of {again.length} samples{failed}"
    yield ""


def _write(
    folder: Path,
    found: Identification,
    record: Record,
    spec: MeasuredRecord,
    model: FittedModel,
    wrong: Sequence[str],
    lines: Sequence[str],
    residuals: Residuals | None,
    again: Bootstrap | None,
) -> list[str]:
    write_model(model, folder / "model.json")
    with replacing(folder / "experiment.yaml") as new:
        new.write_text(_experiment(found, spec, folder), encoding="utf-8")
    pictures = [*draw_model(model, folder, again.chains if again else ())]
    pictures += _draw_kept_apart(folder, found, record, spec, residuals, again)
    rows = _rows(found, record, None)
    with replacing(folder / "table.md") as new:
        head = [f"# What was tried on {one_of(Path(file).name for file in spec.file)}", ""]
        table = ["| " + " | ".join(row) + " |" for row in rows]
        table.insert(1, "| " + " | ".join("---" for _ in rows[0]) + " |")
        page = ["```", formulas(model), "```", "", *(f"![{Path(name).stem}]({name})" for name in pictures)]
        known = ["", "What to know of the record:", *(f"- {sentence}" for sentence in wrong)] if wrong else []
        new.write_text("\n".join([*head, *table, *known, *lines, *page, ""]), encoding="utf-8")
    return ["model.json", "table.md", "experiment.yaml", *pictures]


def _draw_kept_apart(
    folder: Path,
    found: Identification,
    record: Record,
    spec: MeasuredRecord,
    residuals: Residuals | None,
    again: Bootstrap | None,
) -> list[str]:
    """Draw what the chosen chain makes of what was kept apart, and what it leaves; the names of the files."""
    from hident.reports.model_figures import comparison
    from hident.reports.one_trial.residuals import residual_figure

    parts, units = found.parts, record.units
    names = [
        name + (f" ({units[side]})" if units.get(side) else "")
        for side in ("input", "output")
        for name in [one_of(map(str, _kept_columns(spec, side)))]
    ]
    assert found.chosen.fit is not None
    made = parts.simulated(found.chosen.fit.point.parameters.chain)
    # Of a chain that was fitted to what was kept apart as well, bands would be those of another fit.
    is_apart = again is not None and parts.everything is parts.estimation
    others = [parts.simulated(chain) for chain in again.chains] if again and is_apart else []
    step, label = 1.0, "sample kept apart"
    if record.dt is not None and len(parts.kept_experiments) == 1:
        step = record.dt
        label = (
            "time"
            + (f" ({units['time']})" if units.get("time") else "")
            + " since the first sample kept apart"
        )
    shown = _shown(parts.output, parts.kept_experiments)
    instants = np.arange(len(made), dtype=float) * step
    save_figure(
        folder / "kept_apart.png",
        lambda: comparison(
            instants[shown],
            label,
            parts.input[shown],
            made[shown],
            parts.output[shown],
            (names[0], names[1], "simulation"),
            [other[shown] for other in others],
            [part.start - 0.5 for part in parts.kept_experiments[1:] if part.start < shown.stop],
        ),
    )
    if residuals is None:
        return ["kept_apart.png"]
    unit = f" ({units['output']})" if units.get("output") else ""
    save_figure(
        folder / "residuals.png", lambda: residual_figure(residuals, step, (label, f"residual e{unit}"))
    )
    return ["kept_apart.png", "residuals.png"]


def _kept_columns(spec: MeasuredRecord, side: str) -> Sequence[Any]:
    """The columns that the input or the output of the samples kept apart are from."""
    columns: Sequence[Any] = getattr(spec.validation, side, None) or getattr(spec, side)
    return columns


def _shown(y: Array, experiments: Parts) -> slice:
    """Which samples of y (N,) a figure shows: all if they are few."""
    if len(y) <= _MOST_SHOWN:
        return slice(0, len(y))
    longest = max(experiments, key=lambda part: part.stop - part.start)
    sums = (np.concatenate(([0.0], np.cumsum(signal))) for signal in (y[longest], y[longest] ** 2))
    first, second = ((total[_SHOWN:] - total[:-_SHOWN]) / _SHOWN for total in sums)
    begin = longest.start + int(np.argmax(second - first**2)) if len(first) else 0
    return slice(begin, begin + _SHOWN)


def _experiment(found: Identification, spec: MeasuredRecord, folder: Path) -> str:
    """The chosen model as a configuration, whose files are named from its folder."""
    record = canonical(spec)
    files = [Path(file).resolve() for file in spec.file]
    record["file"] = [_from(folder, file) for file in files]
    chosen = canonical(found.chosen.spec)
    on = "validation" if spec.validation else "estimation"
    written = {
        "version": 1,
        "title": f"The model that was chosen for {one_of(Path(file).name for file in spec.file)}",
        "record": record,
        "trials": 1,
        "estimators": {"chosen": chosen},
        "metrics": {"fit": {"kind": "fit_index", "on": on, "n_init": found.parts.everything.n_init}},
    }
    return yaml.safe_dump(written, sort_keys=False, allow_unicode=True)


def _from(folder: Path, file: Path) -> str:
    """How a file is named from a folder; from its root where no way leads there, as between drives."""
    try:
        return Path(os.path.relpath(file, folder.resolve())).as_posix()
    except ValueError:
        return file.as_posix()
