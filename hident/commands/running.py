"""Runs of plans on one set of workers: the verbs run and accept."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import chdir, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from hident import arithmetic, stopping
from hident.config.suggest import counted
from hident.engine.cores import usable_cores
from hident.engine.executors import Workers, named_executor
from hident.engine.experiment import Plan
from hident.engine.log import tell, warn
from hident.engine.preflight import check_records
from hident.engine.run_files import PAGE, POWER
from hident.engine.runner import CrashReport, mended, run
from hident.engine.store import Store, TrialStore, Writer
from hident.errors import ConfigError, Exit, NothingToCompare
from hident.progress import chosen, reminder
from hident.run_folder import RunFolder, phase

if TYPE_CHECKING:
    from hident.engine.results import Results
    from hident.ledger.sensitivity import Sensitivity
    from hident.ledger.trial_values import TrialValues


@dataclass(frozen=True)
class Bench:
    """Where plans are run one after the other: the folders of outputs and of trials, and workers."""

    plans: Sequence[Plan]
    out: Path
    store: Path
    wait: float
    """How many seconds to wait for another run."""
    workers: Workers
    quiet: bool

    def run(self, *, keep_going: bool) -> Exit:
        """Run the plans; a single one's tables are printed."""
        code = Exit.FINE
        for plan in self.plans:
            try:
                for undrawn in self._written(plan, keep_going=keep_going):
                    warn("not drawn", undrawn, config=plan.name)
                    print(f"error: {undrawn}; all other outputs are written", file=sys.stderr)
                    code = max(code, Exit.DIFFERS)
                if not self.quiet and len(self.plans) == 1:
                    print((self.out / plan.name / PAGE).read_text(encoding="utf-8"))
            except CrashReport as crash:
                kept = RunFolder(self.out / plan.name).keep_tracebacks(crash.tracebacks)
                where = f"\nTracebacks: {kept}" if kept else f"\n{crash.tracebacks}"
                print(f"error: {plan.name}: {crash}{where}", file=sys.stderr)
                code = crash.exit_code
                if not keep_going:
                    break
        return code

    def power(self, trials: int | None) -> None:
        """Run the alternatives of the plans, and write what the printed numbers make of them."""
        from hident.engine.alternatives import alternative_plans
        from hident.ledger.mutation import measured, trials_of
        from hident.reports.output import write_power

        numbers = [trials_of(plan, trials) for plan in self.plans]
        # What is wrong with any is said before the first is run.
        every = [alternative_plans(plan, number) for plan, number in zip(self.plans, numbers, strict=True)]
        for plan, number, alternatives in zip(self.plans, numbers, every, strict=True):
            with self._writing(plan) as writer:
                power = measured(plan, alternatives, partial(self._alternative, plan, writer))
            folder = self.out / POWER / plan.name
            write_power(plan, power, number, folder, self.workers.used)
            if not self.quiet:
                alone = len(self.plans) == 1
                print(
                    (folder / PAGE).read_text(encoding="utf-8") if alone else f"{plan.name}: wrote {folder}"
                )

    def _alternative(self, plan: Plan, writer: TrialStore, name: str, alternative: Plan) -> Results:
        return self._trials(alternative, writer, f"{plan.name}, {name}")

    def accept(self, results: Path, perturbations: int) -> None:
        """Accept the outputs of the plans, each with how many of its trials a last bit moves."""
        from hident.ledger.accept import accept
        from hident.reports.output import Outputs

        for plan in self.plans:
            outputs = Outputs(plan, self.out / plan.name)
            if outputs.state() == "old":
                raise ConfigError(
                    f"{outputs.folder} is not what {plan.path} gives now: hident run {plan.name}, or repeat "
                    "here the --set, --trials, --seed and --format of that run"
                )
        for plan in self.plans:
            measure = partial(self._sensitivity, plan, perturbations)
            print(accept(self.out / plan.name, results, measure, perturbations))

    def _written(self, plan: Plan, *, keep_going: bool) -> tuple[str, ...]:
        """Run a plan, if its outputs are not there; a message for each figure that cannot be drawn."""
        from hident.reports.output import Outputs, hanging_means

        outputs = Outputs(plan, self.out / plan.name)
        note = f"{plan.name}: {outputs.folder} is up to date"
        undrawn: tuple[str, ...] = ()
        if outputs.state() != "up to date":
            with self._writing(plan) as writer:
                # Asked again, as another run may have held the store until now.
                if outputs.state() != "up to date":
                    seconds: dict[str, float] = {}
                    said = (
                        f"{plan.name}: still at the records of trial 0, which are simulated first; every "
                        "trial takes as long. Ctrl-C stops, --trial-timeout SECONDS ends what takes longer"
                    )
                    with phase(seconds, "records checked"), reminder(said, quiet=self.quiet):
                        check_records(plan)
                    with phase(seconds, "trials"):
                        results = self._trials(plan, writer, plan.name, keep_going=keep_going)
                    undrawn = outputs.write(results, results.how, seconds)
                    note = f"{plan.name}: wrote {outputs.folder}"
                    if (hanging := hanging_means(results)) and not self.quiet:
                        print(f"{plan.name}: {hanging}", file=sys.stderr)
        tell("outputs", note, config=plan.name)
        if not self.quiet:
            print(note, file=sys.stderr)
        return undrawn

    @contextmanager
    def _writing(self, plan: Plan) -> Iterator[Writer]:
        """Hold the store for the runs of a plan; what was saved of a damaged one is told."""
        with Store(self.store).writing(self.wait) as writer:
            if said := mended(plan, writer):
                warn("store mended", said)
                print(f"warning: {said}", file=sys.stderr)
            yield writer

    def _sensitivity(self, plan: Plan, perturbations: int, values: TrialValues) -> Sensitivity:
        """How many trials of a plan, whose values are given, move when their records are a last bit away."""
        from hident.ledger.sensitivity import Sensitivity
        from hident.ledger.trial_values import TrialValues

        def repeated(k: int) -> TrialValues:
            with self._writing(plan) as writer:
                name = f"{plan.name}, perturbation {k} of {perturbations}"
                # With a rule, as many as the run came to.
                perturbed = plan.changed(perturbation=k, trials=values.trials)
                return TrialValues.of(self._trials(perturbed, writer, name))

        return Sensitivity.measured(values, map(repeated, range(1, perturbations + 1)))

    def _trials(self, plan: Plan, store: TrialStore, name: str, *, keep_going: bool = False) -> Results:
        # An estimator may go elsewhere, and paths may be relative.
        with chdir(Path.cwd()):
            results = run(
                plan,
                store=store,
                executor=self.workers,
                keep_going=keep_going,
                progress=chosen(name, len(plan.units), quiet=self.quiet),
            )
        if count := results.timed_out:
            print(
                f"warning: {name}: {counted(count, 'trial')} took longer than the trial timeout of "
                f"{plan.trial_timeout:g} s: counted as failed, not stored, and computed by the next run",
                file=sys.stderr,
            )
        return results


@contextmanager
def bench(
    plans: Sequence[Plan],
    out: Path,
    store: Path,
    wait: float,
    jobs: int | None,
    plugin_files: Iterable[Path],
    quiet: bool,
    executor: str | None = None,
    scheduler: str | None = None,
) -> Iterator[Bench]:
    """A bench with workers, which end with it; Ctrl-C, SIGTERM and SIGHUP end both, and the
    program, with a message."""
    if said := arithmetic.shortfall(arithmetic.in_use()):
        print(f"warning: {said}", file=sys.stderr)
    files = [*dict.fromkeys([*plugin_files, *(file for plan in plans for file in plan.plugin_files)])]
    workers = named_executor(executor, scheduler, jobs or usable_cores(), files, plans)
    workers.tell = lambda said: print(f"warning: {said}", file=sys.stderr)
    try:
        yield Bench(plans, out, store, wait, workers, quiet)
        workers.shutdown()
    except KeyboardInterrupt:
        stopping.ignore()
        print(
            f"interrupted: all stored trials are kept in {store}; the same command resumes", file=sys.stderr
        )
        raise SystemExit(Exit.INTERRUPTED) from None
    finally:
        workers.kill()


def check_finished(names: Iterable[str], out: Path) -> None:
    """Refuse, before anything is loaded, a configuration without a folder of outputs."""
    for name in (Path(name).stem for name in names):
        if not RunFolder(out / name).finished:
            raise NothingToCompare(f"{out / name} holds no finished run: hident run {name}")


def accept_power(plans: Iterable[Plan], out: Path, results: Path) -> Iterator[str]:
    """Accept what was measured of the alternatives; a line for each configuration.

    ConfigError, before anything is accepted, where it was measured for another configuration.
    """
    from hident.ledger.accept import accept
    from hident.ledger.power import without_reports

    plans = list(plans)
    for plan in plans:
        folder = RunFolder(out / POWER / plan.name)
        if not folder.finished:
            raise NothingToCompare(f"{folder.path} holds no finished run: hident power {plan.name}")
        match folder.run():
            case {"experiment": {"hash": known}} if known != without_reports(plan.experiment):
                raise ConfigError(
                    f"{folder.path} is not of {plan.path} as it is now: hident power {plan.name}"
                )
    for plan in plans:
        yield str(accept(out / POWER / plan.name, results / POWER))
