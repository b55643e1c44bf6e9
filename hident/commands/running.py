"""Runs of plans on one set of workers: the verbs run and accept."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from hident import arithmetic
from hident.engine.experiment import Plan
from hident.engine.run_files import PAGE
from hident.engine.runner import CrashReport, Progress, run
from hident.engine.store import Store
from hident.errors import ConfigError, Exit, NothingToCompare
from hident.run_folder import RunFolder

if TYPE_CHECKING:
    from hident.engine.results import Results
    from hident.ledger.sensitivity import Sensitivity
    from hident.ledger.trial_values import TrialValues


@dataclass(frozen=True)
class Place:
    """Where outputs and trials are kept, and how many seconds to wait for another run."""

    out: Path
    store: Path
    wait: float = 0.0

    def folder(self, plan: Plan) -> Path:
        """The folder of a plan's outputs."""
        return self.out / plan.name


@dataclass(frozen=True)
class _Bench:
    """A place with workers, for runs one after the other."""

    place: Place
    executor: Executor
    workers: int
    quiet: bool

    def run(self, plan: Plan, *, keep_going: bool) -> tuple[str, ...]:
        """Run a plan, if its outputs are not there; a message for each figure that cannot be drawn."""
        from hident.engine.preflight import check_records
        from hident.reports.output import Outputs

        outputs = Outputs(plan, self.place.folder(plan))
        note = f"{plan.name}: {outputs.folder} is up to date"
        undrawn: tuple[str, ...] = ()
        if outputs.state() != "up to date":
            with Store(self.place.store).writing(self.place.wait) as writer:
                # Asked again, as another run may have held the store until now.
                if outputs.state() != "up to date":
                    start = time.perf_counter()
                    check_records(plan)
                    results = run(
                        plan,
                        store=writer,
                        executor=self.executor,
                        workers=self.workers,
                        keep_going=keep_going,
                        progress=self._progress(plan.name),
                    )
                    wall = round(time.perf_counter() - start, 3)
                    undrawn = outputs.write(results, {"workers": self.workers, "wall_seconds": wall})
                    note = f"{plan.name}: wrote {outputs.folder}"
        if not self.quiet:
            print(note, file=sys.stderr)
        return undrawn

    def sensitivity(self, plan: Plan, perturbations: int, values: TrialValues) -> Sensitivity:
        """How many trials of a plan, whose values are given, move when their records are a last bit away."""
        from hident.ledger.sensitivity import Sensitivity
        from hident.ledger.trial_values import TrialValues

        repeated = (self._perturbed(plan, k, perturbations) for k in range(1, perturbations + 1))
        return Sensitivity.measured(values, map(TrialValues.of, repeated))

    def _perturbed(self, plan: Plan, k: int, perturbations: int) -> Results:
        with Store(self.place.store).writing(self.place.wait) as writer:
            return run(
                plan.changed(perturbation=k),
                store=writer,
                executor=self.executor,
                workers=self.workers,
                progress=self._progress(f"{plan.name}, perturbation {k} of {perturbations}"),
            )

    def _progress(self, name: str) -> Progress:
        from hident.progress import chosen

        return chosen(name, quiet=self.quiet)


def run_plans(
    plans: Sequence[Plan],
    place: Place,
    jobs: int | None,
    plugin_files: Iterable[Path],
    *,
    keep_going: bool,
    quiet: bool,
) -> Exit:
    """Run plans one after the other on one set of workers; a single one's tables are printed."""

    def work(bench: _Bench) -> Exit:
        code = Exit.FINE
        for plan in plans:
            try:
                for undrawn in bench.run(plan, keep_going=keep_going):
                    print(f"error: {undrawn}; all other outputs are written", file=sys.stderr)
                    code = max(code, Exit.DIFFERS)
                if not quiet and len(plans) == 1:
                    print((place.folder(plan) / PAGE).read_text(encoding="utf-8"))
            except CrashReport as crash:
                kept = RunFolder(place.folder(plan)).keep_tracebacks(crash.tracebacks)
                where = f"\nTracebacks: {kept}" if kept else f"\n{crash.tracebacks}"
                print(f"error: {plan.name}: {crash}{where}", file=sys.stderr)
                code = crash.exit_code
                if not keep_going:
                    break
        return code

    return _on_workers(work, place, jobs, _files(plans, plugin_files), quiet=quiet)


def accept_plans(
    plans: Sequence[Plan],
    place: Place,
    results: Path,
    jobs: int | None,
    plugin_files: Iterable[Path],
    *,
    perturbations: int,
    quiet: bool,
) -> Exit:
    """Accept the outputs of plans, each with how many of its trials a last bit moves."""
    from hident.ledger.accept import accept
    from hident.reports.output import Outputs

    for plan in plans:
        outputs = Outputs(plan, place.folder(plan))
        if outputs.state() == "old":
            raise ConfigError(
                f"{outputs.folder} is not what {plan.path} gives now: hident run {plan.name}, or repeat here "
                "the --set, --trials and --seed of that run"
            )

    def work(bench: _Bench) -> Exit:
        for plan in plans:
            measure = partial(bench.sensitivity, plan, perturbations)
            print(accept(place.folder(plan), results, measure, perturbations))
        return Exit.FINE

    return _on_workers(work, place, jobs, _files(plans, plugin_files), quiet=quiet)


def _on_workers(
    work: Callable[[_Bench], Exit],
    place: Place,
    jobs: int | None,
    plugin_files: Iterable[Path],
    *,
    quiet: bool,
) -> Exit:
    """Do the work on a set of workers, which end with it; Ctrl-C ends both with a message."""
    from hident.engine.cores import usable_cores
    from hident.engine.executors import end, make_executor

    warn_of_arithmetic()
    workers = jobs or usable_cores()
    executor = make_executor(workers, plugin_files)
    try:
        code = work(_Bench(place, executor, workers, quiet))
        executor.shutdown()
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        print(
            f"interrupted: all stored trials are kept in {place.store}; the same command resumes",
            file=sys.stderr,
        )
        code = Exit.INTERRUPTED
    finally:
        end(executor)
    return code


def _files(plans: Iterable[Plan], plugin_files: Iterable[Path]) -> tuple[Path, ...]:
    """The plugin files that workers need."""
    named = [file for plan in plans for file in plan.plugin_files]
    return tuple(dict.fromkeys([*plugin_files, *named]))


def warn_of_arithmetic() -> None:
    """Say so where the arithmetic in use is not the one that was asked for."""
    if said := arithmetic.shortfall(arithmetic.in_use()):
        print(f"warning: {said}", file=sys.stderr)


def check_finished(names: Iterable[str], out: Path) -> None:
    """Check that each configuration has a folder of outputs.

    Raises
    ------
    NothingToCompare
        If one has none.
    """
    for name in names:
        folder = out / Path(name).stem
        if not RunFolder(folder).finished:
            raise NothingToCompare(f"{folder} holds no finished run: hident run {Path(name).stem}")
