"""What is stored and how results stand: the verbs status, compare, verify and doctor."""

from __future__ import annotations

import json
import math
import shutil
import textwrap
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from hident import plugins
from hident.config.suggest import counted, one_of
from hident.engine.experiment import Plan
from hident.engine.runner import reached, stored
from hident.engine.store import Store
from hident.errors import Exit


def print_status(plans: Sequence[Plan], out: Path, folder: Path) -> None:
    """For each plan: how many of its trials are stored, and the state of its outputs."""
    from hident.reports.output import Outputs

    store = Store(folder)
    rows = [("configuration", "trials stored", "of", "outputs")]
    for plan in plans:
        with store.reading() as reader:
            now = reached(plan, reader)
        done, wanted = sum(stored(now, store)), now.trials * len(plan.units)
        # With a rule, the next decision may ask for more.
        more = " or more" if now.trials < now.decisions[-1] and done < wanted else ""
        rows.append((plan.name, str(done), f"{wanted}{more}", Outputs(plan, out / plan.name).state()))
    print_columns(rows)
    with store.reading() as reader:
        print(f"{store.path}: {reader.count()} scores in all")


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
    for line in comparison.left_out:
        print(f"left out: {line}")
    if comparison.absent:
        print(f"not run here: {one_of(comparison.absent)}")
    count = len(comparison.differences)
    folders = counted(comparison.compared, "configuration")
    differences = counted(count, "difference") if count else "no differences"
    print(f"{ours} against {reference}: {folders}, {differences}")
    return Exit.DIFFERS if count else Exit.FINE


def print_verification(
    folder: Path, experiments: Path, results: Path, configs: Path, *, complete: bool, as_json: bool
) -> Exit:
    """Print the state of the ledger."""
    from hident.ledger.verify import verify

    if complete:
        plugins.load()
    found = verify(folder, experiments, results, configs if complete else None)
    always = {
        "differs without a reason": found.unexplained,
        "reasons that cover no difference": found.idle,
        "not up to date": found.stale,
    }
    of_all = {
        "printed, but not judged here": found.unjudged,
        "reasons of configurations that are not here": found.astray,
    }
    lists = always | of_all
    owed = [title for title, lines in (lists if complete else always).items() if lines]
    code = Exit.DIFFERS if owed else Exit.FINE
    if as_json:
        print(json.dumps({"tables": [table.plain() for table in found.tables], **lists}, indent=2))
        return code
    words = ("exact", "agrees", "untestable", "differs")
    rows: list[tuple[str, ...]] = [
        ("configuration", "table", "printed", *words, "wide", "joint p", "mutation score", "survivors")
    ]
    for table in found.tables:
        numbers = [table.counts.get(word, 0) for word in words]
        p = "-" if math.isnan(table.joint_p) else f"{table.joint_p:.2g}"
        printed = sum(numbers) + sum(table.uncounted.values())
        of = f"{sum(numbers)} of {printed}" if table.uncounted else str(printed)
        cells = [of, *map(str, [*numbers, table.wide]), p, table.score, "; ".join(table.survivors)]
        rows.append((table.config, table.table, *cells))
    print_columns(rows)
    for title, lines in lists.items():
        for line in lines:
            print(f"{title}: {line}")
    uncounted = Counter[str]()
    for table in found.tables:
        uncounted.update(table.uncounted)
    if uncounted:
        print(f"not counted: {', '.join(f'{count} {why}' for why, count in sorted(uncounted.items()))}")
    if any(table.wide for table in found.tables):
        print("wide: they agree, by an interval wider than the printed number itself")
    print(f"{folder}: {one_of(owed) if owed else 'every difference has its reason'}")
    return code


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
