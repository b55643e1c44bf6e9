"""What a file of samples is like before anything is fitted to it: the verb show."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hident.commands.measured import record_of
from hident.commands.showing import print_columns
from hident.config.suggest import counted, one_of
from hident.errors import ConfigError, Exit, StoreError
from hident.measurements.delay import Delay
from hident.measurements.excitation import CONDITION
from hident.measurements.files import SUFFIXES
from hident.measurements.first_look import FirstLook, first_look
from hident.measurements.signal_values import FEW, Signal
from hident.records import Record

_WIDTH = 110


def show(files: Sequence[Path], out: Path | None, **options: Any) -> Exit:
    """Print what the files hold, and write its figures to the folder ``out`` if there is one.

    Raises
    ------
    ConfigError
        If the files cannot be shown.
    """
    if all(file.suffix.lower() in SUFFIXES or file.is_dir() for file in files):
        return _show_record(files, out, options)
    other = next(file for file in files if file.suffix.lower() not in SUFFIXES)
    raise ConfigError(f"{other}: cannot be shown: the name must end in {one_of(SUFFIXES)}")


def _show_record(files: Sequence[Path], out: Path | None, options: dict[str, Any]) -> Exit:
    spec = record_of(files, **options)
    record = spec.read(Path())
    look = first_look(record)
    _print_look(record, look, one_of(map(str, files)))
    if record.validation is not None:
        _print_look(record.validation, first_look(record.validation), "for validation")
    return Exit.FINE if out is None else _write_figures(record, look, out)


def _print_look(record: Record, look: FirstLook, title: str) -> None:
    unit = record.units.get("time", "")
    every = "" if record.dt is None else f" every {record.dt:g} {unit}".rstrip()
    several = f" in {look.experiments} experiments" if look.experiments > 1 else ""
    print(f"{title}: {look.samples} samples{every}{several}")
    signals = {"input": look.input, "output": look.output}
    rows = [("", "range", "mean", "std", "values")]
    for name, signal in signals.items():
        unit = record.units.get(name, "")
        ends = f"{signal.low:g} .. {signal.high:g} {unit}".rstrip()
        rows.append((name, ends, f"{signal.mean:.4g}", f"{signal.std:.4g}", _values(signal)))
    print_columns(rows)
    print(f"delay: {delay_in_words(look.delay, record)}")
    print("a nonlinearity over so many lags: condition number of the regressors")
    head = ("  degree", *(counted(lags, "lag") for lags in look.excitation.lags), "")
    table = zip(look.excitation.degrees, look.excitation.condition, strict=True)
    print_columns([head, *((f"  {degree}", *map(_condition, row), "") for degree, row in table)])
    print("what to know before a fit:" if look.wrong else "nothing looks wrong")
    for sentence in look.wrong:
        print(textwrap.fill(sentence, _WIDTH, initial_indent="- ", subsequent_indent="  "))


def _values(signal: Signal) -> str:
    if signal.levels:
        return f"{len(signal.levels)} levels: {one_of(f'{level:g}' for level in signal.levels)}"
    step = "" if signal.step is None else f", on a grid of {signal.step:.3g}"
    return f"{signal.values} different{step}" if signal.values > FEW else str(signal.values)


def delay_in_words(delay: Delay | None, record: Record) -> str:
    """A delay with its interval, in samples and in time, and how it was found."""
    if delay is None:
        return "none is found: no correlation of the output with the input"
    low, high = delay.low, delay.high
    said = f"{low}" if low == high else f"{low} to {high}"
    if record.dt is not None:
        unit = record.units.get("time", "")
        seconds = [f"{lag * record.dt:g}" for lag in dict.fromkeys((low, high))]
        said = f"{said} samples ({' to '.join(seconds)} {unit}".rstrip() + ")"
    else:
        said += " samples"
    return f"{said}, by the {delay.method}"


def _condition(value: float) -> str:
    if np.isinf(value):
        return "singular"
    return f"{value:.3g}{' (bad)' if value > CONDITION else ''}"


def _write_figures(record: Record, look: FirstLook, out: Path) -> Exit:
    from hident.reports.first_look import figures
    from hident.reports.mathematics import typeset
    from hident.reports.style import style

    code = Exit.FINE
    try:
        out.mkdir(parents=True, exist_ok=True)
        with style():
            for name, draw in figures(record, look).items():
                temporary, file = out / f".{name}.png.part", out / f"{name}.png"
                try:
                    figure = draw()
                    typeset(figure)
                    figure.savefig(temporary, format="png", metadata={"Software": None})
                except (ValueError, ArithmeticError) as error:
                    temporary.unlink(missing_ok=True)
                    print(f"warning: {file} cannot be drawn ({error})", file=sys.stderr)
                    code = Exit.DIFFERS
                    continue
                temporary.replace(file)
                print(file)
    except OSError as error:
        raise StoreError(f"{out} cannot be written: {(error.strerror or str(error)).lower()}") from None
    return code
