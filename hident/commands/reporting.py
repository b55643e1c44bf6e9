"""The site of results: the verb report."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from hident import plugins
from hident.commands.serving import PORT, serve
from hident.config.suggest import counted
from hident.engine.run_files import POWER
from hident.errors import Exit
from hident.reports.site.build import build


def report(
    folders: Sequence[Path],
    out: Path,
    experiments: Path,
    configs: Path,
    docs: Path | None,
    plugin_files: Iterable[Path],
) -> Exit:
    """Build the site, and say what is wrong with the runs that it shows, and where it is."""
    plugins.load(plugin_files)
    built = build(folders, out, experiments=experiments, configs=configs, docs=docs)
    for line in built.left_out:
        print(f"left out: {line}")
    for fault in built.faults:
        print(f"unsound: {fault}")
    runs = counted(built.runs, "run")
    print(f"{runs} on {built.pages} pages, {built.made or 'none'} of them made anew: {built.front}")
    print(built.front.resolve().as_uri())
    return Exit.DIFFERS if built.faults else Exit.FINE


def serve_report(
    folders: Sequence[Path],
    out: Path,
    experiments: Path,
    configs: Path,
    docs: Path | None,
    plugin_files: Iterable[Path],
    port: int | None,
) -> Exit:
    """Build the site, serve it to this machine, and build it again when its sources change."""
    # What is known of the alternatives of a run stands beside its folder.
    watched = [*folders, *(folder.parent / POWER for folder in folders), experiments, configs]
    watched += [] if docs is None else [docs]
    serve(
        lambda: report(folders, out, experiments, configs, docs, plugin_files),
        watched,
        out,
        PORT if port is None else port,
    )
    return Exit.FINE
