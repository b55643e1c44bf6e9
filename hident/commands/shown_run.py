"""What a run found, from its folder: the verb show for folders of results."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from hident.commands.results_folders import FoundRun, is_run, list_runs, runs_in
from hident.commands.shown_numbers import print_numbers, print_series
from hident.commands.terminal import signed, terminal, text_of
from hident.config.suggest import did_you_mean, one_of
from hident.engine.run_files import NUMBERS, PAGE, RUN, in_format
from hident.errors import ConfigError, Exit, HidentError
from hident.reports.failures import failures_of
from hident.reports.page import Page
from hident.reports.table import Table, is_number
from hident.run_folder import RunFolder

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table as Shown
    from rich.text import Text

_PRINTED = "printed"
_MOST_ROWS = 500
"""The rows of a table that are printed; of more, the first."""
_MOST_REASONS = 20
_MOST_CASES = 10
"""Of reasons why trials failed, and of the cases of each, those that are printed."""


def show_results(path: Path, results: Path) -> Exit:
    """Print what a run found, or list the runs of a folder.

    ``results`` is the folder of the accepted ones, where what is known of alternatives stands.

    Raises
    ------
    ConfigError
        If there is no such run, or its verdicts cannot be read.
    NothingToCompare
        If the folder holds no run.
    """
    if is_run(path):
        return _show_run(FoundRun(RunFolder(path)), results)
    if path.is_dir():
        return list_runs([path])
    near = did_you_mean(path.name, (one.name for one in runs_in(path.parent)))
    raise ConfigError(f"{path}: there is no such run{near} (hident show {path.parent} lists them)")


def _show_run(run: FoundRun, results: Path) -> Exit:
    console = terminal()
    console.print(text_of(f"{run.name}: {run.page.title if run.page else 'no table.md is here'}", "bold"))
    for line in _head(run):
        console.print(line)
    if run.page:
        _print_tables(console, run.page)
    if run.numbers:
        print_numbers(console, run, results)
    print_series(console, run)
    for line in _failures(run):
        console.print(line)
    for text in run.page.below if run.page else ():
        console.print()
        console.print(signed(text) if text.startswith("Printed") else text_of(text))
    console.print()
    for line in _files(run):
        console.print(line)
    return Exit.FINE


def _head(run: FoundRun) -> Iterator[Text]:
    """What was run, whether the files are as it wrote them, and where they come from."""
    sound = run.state == "fine"
    yield text_of(f"{run.folder.path}: {run.state}", "" if sound else "bold red")
    if paper := run.resolved.get("paper"):
        yield text_of(f"paper: {paper} (experiments/{paper})")
    if run.page:
        yield from map(text_of, run.page.above)
    provenance = run.content.get("provenance")
    if isinstance(provenance, dict):
        commit = str(provenance.get("git_commit") or "")[:10]
        changed = " with changes" if provenance.get("git_dirty") else ""
        libraries = provenance.get("libraries") or {}
        numpy, scipy = (libraries.get(name, "?") for name in ("numpy", "scipy"))
        yield text_of(
            f"made {str(provenance.get('finished', '?'))[:10]} by hident {provenance.get('hident', '?')}"
            f"{f', commit {commit}{changed}' if commit else ''}, numpy {numpy}, scipy {scipy}; "
            f"{(provenance.get('arithmetic') or {}).get('identity', 'arithmetic unknown')}"
        )


def _print_tables(console: Console, page: Page) -> None:
    """The tables of table.md, each note once."""
    said: set[str] = set()
    for table in page.tables:
        console.print()
        console.print(text_of(table.title, "bold underline"))
        first = Table(table.title, table.header, table.rows[:_MOST_ROWS])
        for part in _blocks(first, console.width):
            console.print(_shown(part))
        if more := len(table.rows) - len(first.rows):
            console.print(text_of(f"and {more} more rows: {PAGE} has all"))
        for note in table.notes:
            if note not in said:
                console.print(text_of(note.replace("`", "")))
            said.add(note)


def _blocks(table: Table, width: int) -> Iterator[Table]:
    """The table in parts that are no wider than the terminal, the first column in each."""
    columns = [*zip(table.header, *table.rows, strict=True)]
    widths = [max(map(len, column)) + 2 for column in columns]
    block: list[int] = []
    for i in range(1, len(columns)):
        # A printed number stands beside ours.
        together = [i, i + 1] if table.header[i + 1 : i + 2] == (_PRINTED,) else [i]
        if table.header[i] == _PRINTED and block and block[-1] == i - 1:
            block.append(i)
            continue
        if block and widths[0] + sum(widths[j] for j in [*block, *together]) - 2 > width:
            yield _part(table, [0, *block])
            block = []
        block.append(i)
    yield _part(table, [0, *block])


def _part(table: Table, columns: Sequence[int]) -> Table:
    header, *rows = (tuple(row[i] for i in columns) for row in (table.header, *table.rows))
    return Table(table.title, header, tuple(rows))


def _shown(table: Table) -> Shown:
    from rich.table import Table as Shown

    shown = Shown(box=None, pad_edge=False, header_style="bold")
    for i, name in enumerate(table.header):
        numbers = all(is_number(row[i]) for row in table.rows)
        shown.add_column(text_of(name), justify="right" if numbers else "left")
    for row in table.rows:
        is_verdict = [name == _PRINTED or row[0] == _PRINTED for name in table.header]
        cells = zip(row, is_verdict, strict=True)
        shown.add_row(*(signed(cell) if verdict else text_of(cell) for cell, verdict in cells))
    return shown


def _failures(run: FoundRun) -> Iterator[Text]:
    """Why trials failed, the most frequent reason first, and where."""
    by_reason = failures_of(run.folder).by_reason
    if by_reason:
        yield text_of("")
        yield text_of("failures", "bold underline")
    for reason, rows in islice(by_reason.items(), _MOST_REASONS):
        yield text_of(f"{sum(row.trials for row in rows)} times: {reason}", "bold")
        for row in rows[:_MOST_CASES]:
            what = f": {', '.join(row.metrics)}" if row.metrics else ""
            at = ", ".join(filter(None, (f"estimator {row.estimator}", row.case)))
            yield text_of(f"  {row.trials} of {row.of}, {at}{what}")
        if len(rows) > _MOST_CASES:
            yield text_of(f"  and {len(rows) - _MOST_CASES} more cases: {RUN} has all")
    if len(by_reason) > _MOST_REASONS:
        yield text_of(f"and {len(by_reason) - _MOST_REASONS} more reasons: {RUN} has all")


def _files(run: FoundRun) -> Iterator[Text]:
    """Its figures and other files, and the commands that make it again."""
    names = run.folder.files()
    figures = [name for name in names if in_format(name) not in (None, "tex")]
    if figures:
        yield text_of(f"figures in {run.folder.path}: {one_of(figures)}")
    if others := [name for name in names if name not in figures]:
        yield text_of(f"files in {run.folder.path}: {one_of(others)}")
    if run.folder.finished:
        yield text_of("again:", "bold")
        yield from (text_of(f"  {command}") for command in _again(run))


def _again(run: FoundRun) -> Iterator[str]:
    name = shlex.quote(run.name)
    if NUMBERS in run.folder.files():
        yield f"hident power {name}"
        return
    options = "".join(
        f" --{option} {run.experiment[option]}"
        for option in ("trials", "seed")
        if option in run.experiment and _is_another(run, option)
    )
    yield f"hident run {name}{options}"
    yield f"hident show {name} --trial 0"
    if run.resolved.get("alternatives"):
        yield f"hident power {name}"


def _is_another(run: FoundRun, option: str) -> bool:
    """Whether the configuration, as it is now, asks for another number than the run had."""
    from hident.commands.plans import file_of
    from hident.config.load import read

    try:
        asked = read(file_of(Path(run.name))).data.get(option)
    except (HidentError, AttributeError):
        return False
    return isinstance(asked, int) and asked != run.experiment.get(option)
