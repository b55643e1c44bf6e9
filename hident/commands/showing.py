"""What is stored and how results stand: the verbs status, export, compare, verify and doctor."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hident.config.suggest import one_of
from hident.engine.experiment import Plan
from hident.engine.runner import complete, stored
from hident.engine.store import Store
from hident.errors import ConfigError, Exit, StoreError


def print_status(plans: Sequence[Plan], out: Path, folder: Path) -> None:
    """For each plan: how many of its trials are stored, and the state of its outputs."""
    from hident.reports.output import Outputs

    store = Store(folder)
    rows = [("configuration", "trials stored", "of", "outputs")]
    for plan in plans:
        done, wanted = sum(stored(plan, store)), plan.trials * len(plan.units)
        rows.append((plan.name, str(done), str(wanted), Outputs(plan, out / plan.name).state()))
    print_columns(rows)
    print(f"{store.path}: {store.count()} scores in all")


def print_comparison(ours: Path, reference: Path, rtol: float, *, complete: bool, partial: bool) -> Exit:
    """Print every difference between two folders of results, and what differs and may."""
    from hident.ledger.compare import compare

    comparison = compare(ours, reference, rtol=rtol, complete=complete, partial=partial)
    if comparison.allowed:
        print("allowed, as the accepted results say how often a last bit decides:")
    for allowed in comparison.allowed:
        print(textwrap.indent(allowed, "  "))
    for difference in comparison.differences:
        print(difference)
    if comparison.absent:
        print(f"not run here: {one_of(comparison.absent)}")
    count = len(comparison.differences)
    folders = f"{comparison.compared} configuration{'s' * (comparison.compared != 1)}"
    print(f"{ours} against {reference}: {folders}, {count or 'no'} difference{'s' * (count != 1)}")
    return Exit.DIFFERS if count else Exit.FINE


def print_verification(folder: Path, experiments: Path, *, complete: bool) -> Exit:
    """Print the state of the ledger."""
    from hident.ledger.verify import verify

    found = verify(folder, experiments)
    rows: list[tuple[str, ...]] = [("configuration", "printed", "exact", "agrees", "differs")]
    for config, words in found.counts.items():
        numbers = [words.get(word, 0) for word in ("exact", "agrees", "differs")]
        rows.append((config, *map(str, [sum(numbers), *numbers])))
    print_columns(rows)
    for title, lines in (
        ("differs without a reason", found.unexplained),
        ("printed, but not judged here", found.unjudged),
        ("reasons that cover no difference", found.idle),
    ):
        for line in lines:
            print(f"{title}: {line}")
    print(f"{folder}: {'every difference has its reason' if not found.unexplained else 'reasons are owed'}")
    return Exit.DIFFERS if found.unexplained or (complete and found.unjudged) else Exit.FINE


def print_diagnosis(store: Path, plugin_files: Sequence[Path]) -> Exit:
    """Print what is found about the installation, what is unsound last."""
    from hident.doctor import examine

    findings = list(examine(store, plugin_files))
    print_columns([(finding.topic, finding.text) for finding in findings if not finding.state])
    for finding in findings:
        if finding.state:
            print(f"{finding.state}: {finding.topic}: {finding.text}")
    unsound = any(finding.state == "unsound" for finding in findings)
    print("something is unsound" if unsound else "nothing is unsound")
    return Exit.DIFFERS if unsound else Exit.FINE


def export(plan: Plan, folder: Path, file: Path) -> str:
    """Write the stored trials of a plan to CSV or Parquet; returns a line that says so."""
    import pandas as pd

    if file.suffix not in (".csv", ".parquet"):
        raise ConfigError(f"{file}: the name must end in .csv or .parquet")
    found = Store(folder).read({key for keys in plan.keys for key in keys.values()}, plan.trials)
    rows: list[dict[str, Any]] = [
        {
            **unit.labels,
            "estimator": unit.name,
            "trial": trial.trial,
            "metric": label,
            "value": value,
            "failure": trial.failure,
        }
        for unit, keys in zip(plan.units, plan.keys, strict=True)
        for name, metric in unit.metrics.items()
        for trial in found[keys[name]]
        for label, value in zip(metric.labels(name), trial.values, strict=True)
    ]
    axes = [axis.name for axis in plan.axes]
    data = pd.DataFrame(rows, columns=[*axes, "estimator", "trial", "metric", "value", "failure"])
    temporary = file.with_name(f".{file.name}.part")
    try:
        if file.suffix == ".csv":
            data.to_csv(temporary, index=False)
        else:
            # An axis may hold numbers and names, which a column of Parquet cannot.
            data.astype(dict.fromkeys(axes, str)).to_parquet(temporary, index=False)
        temporary.replace(file)
    except ImportError:
        raise ConfigError("writing Parquet needs pyarrow: pip install 'hident[parquet]'") from None
    except OSError as error:
        raise StoreError(f"{file} cannot be written: {(error.strerror or str(error)).lower()}") from None
    finally:
        temporary.unlink(missing_ok=True)
    wanted = plan.trials * len(plan.units)
    done = sum(complete(found, keys) for keys in plan.keys)
    missing = "" if done == wanted else f"; {wanted - done} trials are not computed yet (hident run)"
    return f"{file}: {len(data)} rows of {done} trials{missing}"


def print_columns(rows: Sequence[tuple[str, ...]]) -> None:
    """Print columns, the last one wrapped to the width of the terminal."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]) - 1)]
    indent = sum(widths) + 2 * len(widths)
    room = max(30, shutil.get_terminal_size((120, 24)).columns - indent)
    for row in rows:
        head = "".join(f"{cell:<{width}}  " for cell, width in zip(row, widths, strict=False))
        first, *rest = textwrap.wrap(row[-1], room) or [""]
        print(f"{head}{first}".rstrip())
        for line in rest:
            print(" " * indent + line)
