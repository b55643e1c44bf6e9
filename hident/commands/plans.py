"""The configurations that a verb is for."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np

from hident import plugins
from hident.config.load import Document
from hident.config.suggest import counted, one_of
from hident.engine.experiment import Plan, load
from hident.engine.run_files import POWER
from hident.errors import ConfigError, RecordAbsent


def all_configs() -> list[Path]:
    """The files under configs/."""
    found = sorted(Path("configs").glob("*.yaml"))
    if not found:
        raise ConfigError("there is no configuration under configs/ here; name the files")
    return found


def load_plans(
    configs: Iterable[Path | Document],
    assignments: Sequence[str] | None = None,
    options: Mapping[str, int | str | None] = MappingProxyType({}),
    plugin_files: Iterable[Path] = (),
    left_out: Callable[[str], None] | None = None,
) -> list[Plan]:
    """All plans, or one error that holds what is wrong with all files.

    A configuration whose optional record is not here is told to ``left_out`` and has no plan; without that
    function it is an error.
    """
    from hident.ledger.published import check_published
    from hident.reports.output import check

    plugins.load(plugin_files)
    plans: list[Plan] = []
    errors: list[str] = []
    for config in configs:
        try:
            source = config if isinstance(config, Document) else file_of(config)
            # What numbers at the edge of arithmetic lead to is told by the checks, not by numpy.
            with np.errstate(all="ignore"):
                plan = load(source, assignments or (), options)
                check_published(plan)
                check(plan)
            plans.append(plan)
        except RecordAbsent as absent:
            if left_out is None:
                errors.append(str(absent))
            else:
                left_out(str(absent))
        except ConfigError as error:
            errors.append(str(error))
    if errors:
        raise ConfigError("\n".join(errors))
    # Names that differ in capitals only are one folder on many systems.
    names = [plan.name.casefold() for plan in plans]
    if POWER in names:
        raise ConfigError(
            f"a configuration cannot be named '{POWER}', the folder of what hident power writes"
        )
    twice = sorted({plan.name for plan in plans if names.count(plan.name.casefold()) > 1})
    if twice:
        raise ConfigError(f"two files are named {one_of(twice)}, and the name is that of the output folder")
    return plans


def file_of(config: Path) -> Path:
    """The file that is meant: itself, or the one of this name under configs/ or here."""
    if config.suffix or config.exists():
        return config
    named = (Path("configs") / f"{config}.yaml", Path(f"{config}.yaml"))
    return next((file for file in named if file.exists()), config)


def is_config(file: Path) -> bool:
    """Whether a configuration is meant, by its ending or by its name."""
    file = file_of(file)
    return file.suffix.lower() in (".yaml", ".yml") or not (file.suffix or file.exists())


def described(plan: Plan) -> str:
    """One line on a sound configuration."""
    cases, units = len({unit.data.key for unit in plan.units}), len(plan.units)
    return f"{plan.path}: fine: {counted(cases, 'case')}, {counted(units, 'estimate')} of {plan.trials_said}"
