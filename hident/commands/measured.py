"""Records that are named on the command line by their files and columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hident.errors import ConfigError
from hident.measurements.measured_record import MeasuredRecord, Units

_OPTIONS = {"estimation": "estimate", "validation": "validate"}
"""The options that are not named as the fields of a record are."""


def record_of(
    files: Sequence[Path], called: Mapping[str, str] | None = None, **options: Any
) -> MeasuredRecord:
    """The record of some files; options that are None are left to their defaults.

    ``called`` says by which options the verb names fields otherwise.

    Raises
    ------
    ConfigError
        If an option cannot be used, by the option's name.
    """
    for name in ("input", "output"):
        if options.get(name) is None:
            raise ConfigError(
                f"--{name} is required: the column of the {name}, by its name or its number from 1"
            )
    names = _OPTIONS | {**(called or {})}
    given = {name: value for name, value in options.items() if value is not None}
    if "units" in given:
        given["units"] = _units(given["units"])
    columns = {name: _listed(given[name]) for name in ("input", "output", "missing") if name in given}
    try:
        return MeasuredRecord(file=[str(file) for file in files], **(given | columns))
    except ConfigError as error:
        raise ConfigError("\n".join(_by_option(line, names) for line in str(error).splitlines())) from None


def _units(text: str) -> dict[str, str]:
    units = _listed(text)
    if len(units) > 3:
        raise ConfigError(
            f"--units: must be at most three, those of the input, the output and time (got '{text}')"
        )
    return dict(zip(Units.model_fields, units, strict=False))


def _listed(columns: str) -> list[str]:
    return [name.strip() for name in columns.split(",")]


def _by_option(message: str, names: Mapping[str, str]) -> str:
    """The message about a field as one about its option."""
    name, colon, rest = message.removeprefix(f"{MeasuredRecord.__name__}: ").partition(":")
    field = name.partition(".")[0].partition("[")[0]
    if field not in MeasuredRecord.model_fields:
        return message
    for other in ("dt", "time", "estimation", "detrend"):
        rest = rest.replace(f"'{other}'", option(other, names))
    return f"{option(field, names)}{colon}{rest}"


def option(field: str, names: Mapping[str, str] = _OPTIONS) -> str:
    """The option that gives a field of a record."""
    return f"--{names.get(field, field)}"
