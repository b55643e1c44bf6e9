"""What is done with a fitted model: the verbs simulate and convert, and show for a model."""

from __future__ import annotations

import csv
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np

from hident.arrays import Array
from hident.block_chain import Beginning, BlockChain, settled_state
from hident.commands.measured import record_of
from hident.config.suggest import none_of
from hident.errors import ConfigError, EstimationError
from hident.fitted_model import FittedModel
from hident.initial_states import showing
from hident.linear_blocks import TransferFunction
from hident.models.convert import target
from hident.models.formulas import formulas, time_unit
from hident.models.model_file import load_model
from hident.models.source_text import level
from hident.new_files import made_folder, replacing
from hident.records import Record
from hident.static_functions import StaticFunction

# Times written with a few digits give an interval that is off by their rounding.
_SAME_INTERVAL = 1e-3
# A signal computed again is off by rounding, which is not beyond a range.
_ROUNDING = 1e-9


def print_model(file: Path, out: Path | None) -> None:
    """Print the formulas of a model, and write its figures to a folder if one is given."""
    model = load_model(file)
    _warn(_unstable(model))
    print(formulas(model))
    if out is not None:
        names = draw_model(model, out)
        print(f"\n{out}: {', '.join(names)}")


def draw_model(model: FittedModel, folder: Path, others: Sequence[BlockChain] = ()) -> list[str]:
    """Draw a model into a folder, with bands of others, such as bootstraps; the names of the files."""
    from hident.reports.model_figures import figures

    made_folder(folder)
    found = figures(model, others)
    for name, draw in found.items():
        save_figure(folder / name, draw)
    return list(found)


def save_figure(path: Path, draw: Any) -> None:
    """Draw a figure in the house's style, whole or not at all."""
    from hident.reports.mathematics import typeset
    from hident.reports.style import style

    with style(), replacing(path) as new, np.errstate(all="ignore"):
        try:
            figure = draw()
            typeset(figure)
            figure.savefig(new, format="png", metadata={"Software": None})
        except (ValueError, OverflowError, np.linalg.LinAlgError) as error:
            raise ConfigError(f"{path} cannot be drawn: numbers are too large ({error})") from None


def convert_model(file: Path, to: str, out: Path | None) -> None:
    """Print the source that a model is converted to, or write it to a file."""
    wanted = target(to)
    model = load_model(file)
    _warn(_unstable(model))
    if model.is_detrended:
        print(f"note: {level(model)}; so it is for the source", file=sys.stderr)
    if out is None:
        print(wanted.source(model, "response"), end="")
        return
    if out.suffix != wanted.suffix:
        raise ConfigError(f"{out}: the name must end in {wanted.suffix} (--to {to})")
    source = wanted.source(model, out.stem)
    with replacing(out) as new:
        new.write_text(source, encoding="utf-8")
    print(f"{out}: {wanted.meaning}")


def simulate_model(
    file: Path,
    files: Sequence[Path],
    *,
    input_name: str | None,
    compare: str | None,
    steps: int,
    n_init: int,
    start: str | None,
    any_dt: bool,
    out: Path | None,
    plot: Path | None,
    **options: Any,
) -> None:
    """Print what a model makes of a record's input, and write it to files if they are given.

    The options are those of the record: see :class:`MeasuredRecord`.
    """
    for path, suffix in ((out, ".csv"), (plot, ".png")):
        if path is not None and path.suffix != suffix:
            raise ConfigError(f"{path}: the name must end in {suffix}")
    if steps and compare is None:
        raise ConfigError("--k-step predicts from measured outputs: name their column by --compare")
    if start is not None and start not in get_args(Beginning):
        raise ConfigError(f"--start: {none_of(start, get_args(Beginning))}")
    if start == "estimated" and compare is None:
        raise ConfigError(
            "--start estimated takes the states from measured outputs: name their column by --compare"
        )
    model = load_model(file)
    column = input_name or model.about.get("input")
    if not column:
        raise ConfigError(f"{file} does not say which column its input is: name it by --input")
    data = ", ".join(map(str, files))
    if refused := _wrong_trend(model, options.get("detrend"), compare):
        raise ConfigError(f"{data}: {file} {refused}")
    record = _record(files, column, compare, options)
    if model.is_detrended:
        # Inputs with nothing to compare are taken as they stand, with a warning.
        record = replace(record, detrended=True)
    if start is not None:
        model = replace(model, start=cast(Beginning, start))
    if not any_dt:
        model = _at_interval(record, model, data, steps)
    if start in ("settled", "estimated"):
        _settling(model, start)
    run = _Run(model, record, column, compare, steps, n_init, any_dt, options.get("detrend"))
    run.check(data)
    _warn(run.warnings())
    if out is not None:
        run.write(out)
    if plot is not None:
        save_figure(plot, run.figure)
    for line in run.said(data):
        print(line)
    for path in filter(None, (out, plot)):
        print(f"written: {path}")


def _warn(lines: Sequence[str]) -> None:
    for line in lines:
        print(f"warning: {line}", file=sys.stderr)


def _unstable(model: FittedModel) -> list[str]:
    """Which linear blocks are unstable, in words; no fit gives one, and an edited file may."""
    with np.errstate(all="ignore"):
        return [
            f"{name} is unstable, as it has a pole of modulus {block.radius():.4g}: "
            "what it gives never settles"
            for name, block in zip(model.chain.names, model.chain.blocks, strict=True)
            if isinstance(block, TransferFunction) and not block.is_stable(integrators=True)
        ]


def _settling(model: FittedModel, start: str) -> None:
    """ConfigError if a block settles nowhere."""
    for name, block in zip(model.chain.names, model.chain.blocks, strict=True):
        if isinstance(block, TransferFunction):
            try:
                settled_state(np.asarray(block.b), block.denominator)
            except ValueError as error:
                raise ConfigError(f"--start {start}: {name}: {error}") from None


def _wrong_trend(model: FittedModel, detrend: str | None, compare: str | None) -> str:
    """Why the model does not suit signals of which this was taken off; empty if it does."""
    if not model.is_detrended:
        return (
            "was fitted to signals of which no straight lines were taken off: leave out --detrend linear"
            if detrend == "linear"
            else ""
        )
    if detrend != "linear" and compare is not None:
        return (
            "was fitted to signals less their straight lines, and there is nothing to compare in others: "
            "take those of this record off by --detrend linear"
        )
    return ""


def _record(files: Sequence[Path], column: str, compare: str | None, options: Mapping[str, Any]) -> Record:
    """The record of some files; without a column to compare with, its output means nothing."""
    called = {"estimation": "samples", "output": "compare"}
    spec = record_of(files, called, input=column, output=column if compare is None else compare, **options)
    if compare is not None:
        return spec.read(Path())
    record = spec.read_input(Path())
    return replace(record, offsets={name: by for name, by in record.offsets.items() if name == "input"})


def _at_interval(record: Record, model: FittedModel, data: str, steps: int) -> FittedModel:
    """The model for the record's samples; ConfigError if it is known to have none at their interval."""
    wanted = model.chain.dt
    if record.dt is None or wanted is None or abs(record.dt - wanted) <= _SAME_INTERVAL * wanted:
        return model
    said = f"{data} is sampled every {record.dt:g}, and the model was fitted to samples every {wanted:g}"
    if not model.chain.is_continuous:
        raise ConfigError(f"{said}: resample the input, or ask for it as it stands by --any-dt")
    if steps and (model.noise.ar or model.noise.ma):
        raise ConfigError(f"{said}, as its noise is: leave out --k-step, or resample the record")
    try:
        found = model.every(record.dt)
    except ValueError as error:
        raise ConfigError(f"{said}: {error}") from None
    print(f"note: {said}: its linear blocks are continuous, and sampled anew", file=sys.stderr)
    return found


class _Run:
    """A record and what the model makes of it."""

    def __init__(
        self,
        model: FittedModel,
        record: Record,
        column: str,
        compare: str | None,
        steps: int,
        n_init: int,
        any_dt: bool,
        detrend: str | None,
    ) -> None:
        self.model, self.record, self.column, self.compare = model, record, column, compare
        self.steps, self.n_init, self.detrend = steps, n_init, detrend
        self.level = model.level(record)
        """The record as the blocks know it."""
        # Without a column to compare with, the output of the record means nothing.
        known = model if compare is not None else replace(model, start=model.past)
        if any_dt:
            record = replace(record, dt=None)
        with np.errstate(all="ignore"):
            self.signals = known.signals(record)
            self.made = known.predict(record, steps) if steps else known.simulate(record)
        self.how = f"{steps}-step prediction" if steps else "simulation"

    def _begun(self) -> str:
        """How a model whose start is found begins each experiment."""
        if self.compare is None:
            return "begun settled to the first input: --compare tells the states at the first sample"
        found = []
        for part in self.record.experiments:
            u, y = self.level.u[part], self.level.y[part]
            if self.model.known(u, y) is not None:
                found.append("that the fit found for these samples")
            else:
                found.append(f"with which the first {showing(self.model.chain, len(u))} samples are met best")
        return f"begun with the states {' and '.join(dict.fromkeys(found))}"

    def _taken_off(self) -> str:
        """What was taken off the record before, and is missing in the numbers."""
        lines = self.detrend == "linear"
        if self.compare is None:
            return f"'{self.column}' is less its {'straight line' if lines else 'mean'} in this record"
        return f"all numbers are less the {'straight lines' if lines else 'means'} of this record"

    def check(self, data: str) -> None:
        """ConfigError if the output is not finite, or too few samples are left to compare."""
        if len(wrong := np.flatnonzero(~np.isfinite(self.made))):
            raise ConfigError(
                f"{data}: the model's output to this input is not finite from sample {wrong[0]} on"
            )
        if self.compare is not None and not np.any(self._counted()):
            raise ConfigError(
                f"{data}: --n-init {self.n_init} leaves no sample to compare (of {len(self.record)})"
            )

    def _counted(self) -> Any:
        counted = np.full(len(self.record), True)
        for part in self.record.experiments:
            counted[part.start : min(part.start + self.n_init, part.stop)] = False
        return counted

    def warnings(self) -> list[str]:
        """Where the record is not like that of the fit, in words: its trend, the ranges of static blocks.

        First of all, which blocks are unstable.
        """
        found = _unstable(self.model)
        if self.model.is_detrended and self.detrend != "linear":
            found.append(f"{level(self.model)}; '{self.column}' is taken as it stands")
        for i, (name, block) in enumerate(zip(self.model.chain.names, self.model.chain.blocks, strict=True)):
            fitted = self.model.range_of(i)
            if not isinstance(block, StaticFunction) or fitted is None:
                continue
            slack = _ROUNDING * max(map(abs, fitted))
            x = self.signals[i]
            beyond = int(np.sum((x < fitted[0] - slack) | (x > fitted[1] + slack)))
            if beyond:
                if i == 0:
                    # In the units of the record, less no offset.
                    shift, _ = self.model.shifts(self.record)
                    fitted = (fitted[0] + shift, fitted[1] + shift)
                    x = self.record.u
                found.append(
                    f"{beyond} of {len(x)} samples ({_percent(beyond / len(x))}) of the input of {name} lie "
                    f"beyond {fitted[0]:.4g} to {fitted[1]:.4g}, where it was fitted (here {x.min():.4g} to "
                    f"{x.max():.4g}): no measurement supports the model there"
                )
        return found

    def said(self, data: str) -> list[str]:
        """A summary for people."""
        chain, made, unit = self.model.chain, self.made, self._unit()
        lines = [
            f"{data}: {len(made)} samples of '{self.column}', {self.how} by {chain.structure}",
            *([self._begun()] if self.model.start == "estimated" else []),
            *([level(self.model)] if any(self.model.offsets) else []),
            *([self._taken_off()] if self.detrend else []),
            f"output from {made.min():.5g} to {made.max():.5g}{unit}, mean {made.mean():.5g}",
        ]
        if self.compare is not None:
            counted = self._counted()
            left_out = f", without the first {self.n_init} samples" if self.n_init else ""
            found = self._scores(self.record.y[counted], made[counted])
            lines.append(f"against '{self.compare}' ({self.how}{left_out}): {found}")
        return lines

    def _unit(self) -> str:
        unit = self.model.about.get("units", {}).get("output", "")
        return f" {unit}" if unit else ""

    def _scores(self, y: Array, made: Array) -> str:
        """By the definitions of nonlinear_benchmarks: NRMSE = RMSE/std(y), fit = 100 (1 - NRMSE)."""
        from hident.metrics.fit import nrmse, rmse

        with np.errstate(over="ignore"):
            said = f"RMSE {rmse(y, made):.5g}{self._unit()}"
            try:
                relative = nrmse(y, made)
            except EstimationError:
                return f"{said} ('{self.compare}' is constant: no NRMSE)"
        return f"{said}, NRMSE {relative:.4g}, fit {100.0 * (1.0 - relative):.2f} %"

    def time(self) -> Array:
        """From the first sample of each experiment on, in samples if no interval is known."""
        dt = self.record.dt or self.model.chain.dt or 1.0
        lengths = [part.stop - part.start for part in self.record.experiments]
        return dt * np.concatenate([np.arange(length, dtype=float) for length in lengths])

    def write(self, out: Path) -> None:
        """Write time, input and output, and what they are compared with, to a CSV file."""
        columns = {"time": self.time(), self.column: self.record.u}
        columns["predicted" if self.steps else "simulated"] = self.made
        if self.compare is not None:
            columns |= {self.compare: self.record.y, "residual": self.record.y - self.made}
        with replacing(out) as new, new.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))

    def figure(self) -> Any:
        """The output over time."""
        from hident.reports.model_figures import comparison

        units = self.model.about.get("units", {})
        unit = time_unit(self.model)
        known = self.record.dt is not None or self.model.chain.dt is not None
        time = self.time() if len(self.record.experiments) == 1 else np.arange(len(self.record), dtype=float)
        label = f"time ({unit})" if known and unit else "time" if known else "sample"
        names = [
            name + (f" ({units[side]})" if units.get(side) else "")
            for name, side in ((self.column, "input"), (self.compare or "output", "output"))
        ]
        y = None if self.compare is None else self.record.y
        return comparison(time, label, self.record.u, self.made, y, (names[0], names[1], self.how))


def _percent(share: float) -> str:
    return f"{100.0 * share:.1f} %" if share >= 1e-3 else "under 0.1 %"
