"""What the verbs do; :mod:`hident.cli` only reads their arguments."""

from __future__ import annotations

import json
import shutil
import signal
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hident import arithmetic, plugins
from hident.config.schema import json_schema
from hident.config.spec import PLURALS, components
from hident.config.suggest import did_you_mean, one_of
from hident.engine.cases import DATA
from hident.engine.experiment import Experiment, Plan, load
from hident.engine.runner import CrashReport, complete, stored
from hident.engine.store import Store
from hident.errors import ConfigError, Exit, NothingToCompare, StoreError

if TYPE_CHECKING:
    from hident.ledger.sensitivity import Sensitivity
    from hident.ledger.trial_values import TrialValues


@dataclass(frozen=True)
class Place:
    """Where outputs and trials are kept, and how many seconds to wait for another run."""

    out: Path
    store: Path
    wait: float = 0.0


def all_configs() -> list[Path]:
    """The files under configs/."""
    found = sorted(Path("configs").glob("*.yaml"))
    if not found:
        raise ConfigError("there is no configuration under configs/ here; name the files")
    return found


def load_plans(
    configs: Iterable[Path],
    assignments: Sequence[str] | None,
    options: Mapping[str, int | None],
    plugin_files: Iterable[Path],
) -> list[Plan]:
    """All plans, or one error that holds what is wrong with all files."""
    from hident.ledger.published import check_published
    from hident.reports.output import check

    plugins.load(plugin_files)
    plans: list[Plan] = []
    errors: list[str] = []
    for config in configs:
        try:
            plan = load(_file_of(config), assignments or (), options)
            check_published(plan)
            check(plan)
            plans.append(plan)
        except ConfigError as error:
            errors.append(str(error))
    if errors:
        raise ConfigError("\n".join(errors))
    # Names that differ in capitals only are one folder on many systems.
    names = [plan.name.casefold() for plan in plans]
    twice = sorted({plan.name for plan in plans if names.count(plan.name.casefold()) > 1})
    if twice:
        raise ConfigError(f"two files are named {one_of(twice)}, and the name is that of the output folder")
    return plans


def _file_of(config: Path) -> Path:
    """The file that is meant: itself, or the one of this name under configs/ or here."""
    if config.suffix or config.exists():
        return config
    named = (Path("configs") / f"{config}.yaml", Path(f"{config}.yaml"))
    return next((file for file in named if file.exists()), config)


def described(plan: Plan) -> str:
    """One line on a sound configuration."""
    cases, units = len({unit.data.key for unit in plan.units}), len(plan.units)
    return (
        f"{plan.path}: fine: {cases} case{'s' * (cases != 1)}, {units} estimate{'s' * (units != 1)} "
        f"of {plan.trials} trial{'s' * (plan.trials != 1)}"
    )


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
    from hident.run_folder import RunFolder

    def work(executor: Executor, workers: int) -> Exit:
        code = Exit.FINE
        for plan in plans:
            try:
                for undrawn in _run_plan(plan, place, executor, workers, keep_going=keep_going, quiet=quiet):
                    print(f"error: {undrawn}; all other outputs are written", file=sys.stderr)
                    code = max(code, Exit.DIFFERS)
                if not quiet and len(plans) == 1:
                    print((place.out / plan.name / "table.md").read_text(encoding="utf-8"))
            except CrashReport as crash:
                kept = RunFolder(place.out / plan.name).keep_tracebacks(crash.tracebacks)
                where = f"\nTracebacks: {kept}" if kept else f"\n{crash.tracebacks}"
                print(f"error: {plan.name}: {crash}{where}", file=sys.stderr)
                code = crash.exit_code
                if not keep_going:
                    break
        return code

    return _on_workers(work, place, jobs, _files(plans, plugin_files))


def _on_workers(
    work: Callable[[Executor, int], Exit], place: Place, jobs: int | None, plugin_files: Iterable[Path]
) -> Exit:
    """Do the work on a set of workers, which end with it; Ctrl-C ends both with a message."""
    from hident.engine.cores import usable_cores
    from hident.engine.executors import end, make_executor

    warn_of_arithmetic()
    workers = jobs or usable_cores()
    executor = make_executor(workers, plugin_files)
    try:
        code = work(executor, workers)
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


def _run_plan(
    plan: Plan, place: Place, executor: Executor, workers: int, *, keep_going: bool, quiet: bool
) -> tuple[str, ...]:
    """Run a plan, if its outputs are not there; a message for each figure that cannot be drawn."""
    from hident.engine.preflight import check_records
    from hident.engine.runner import run
    from hident.progress import chosen
    from hident.reports.output import Outputs

    outputs = Outputs(plan, place.out / plan.name)
    note = f"{plan.name}: {outputs.folder} is up to date"
    undrawn: tuple[str, ...] = ()
    if outputs.state() != "up to date":
        with Store(place.store).writing(place.wait) as writer:
            # Asked again, as another run may have held the store until now.
            if outputs.state() != "up to date":
                start = time.perf_counter()
                check_records(plan)
                results = run(
                    plan,
                    store=writer,
                    executor=executor,
                    workers=workers,
                    keep_going=keep_going,
                    progress=chosen(plan.name, quiet=quiet),
                )
                wall = round(time.perf_counter() - start, 3)
                undrawn = outputs.write(results, {"workers": workers, "wall_seconds": wall})
                note = f"{plan.name}: wrote {outputs.folder}"
    if not quiet:
        print(note, file=sys.stderr)
    return undrawn


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
        outputs = Outputs(plan, place.out / plan.name)
        if outputs.state() == "old":
            raise ConfigError(
                f"{outputs.folder} is not what {plan.path} gives now: hident run {plan.name}, or repeat here "
                "the --set, --trials and --seed of that run"
            )

    def work(executor: Executor, workers: int) -> Exit:
        for plan in plans:
            measure = partial(_sensitivity, plan, place, executor, workers, perturbations, quiet)
            print(accept(place.out / plan.name, results, measure, perturbations))
        return Exit.FINE

    return _on_workers(work, place, jobs, _files(plans, plugin_files))


def _sensitivity(
    plan: Plan,
    place: Place,
    executor: Executor,
    workers: int,
    perturbations: int,
    quiet: bool,
    values: TrialValues,
) -> Sensitivity:
    """How many trials of a plan, whose values are given, move when their records are a last bit away."""
    from hident.engine.runner import run
    from hident.ledger.sensitivity import Sensitivity
    from hident.ledger.trial_values import TrialValues
    from hident.progress import chosen

    def repeated(k: int) -> TrialValues:
        with Store(place.store).writing(place.wait) as writer:
            found = run(
                plan.changed(perturbation=k),
                store=writer,
                executor=executor,
                workers=workers,
                progress=chosen(f"{plan.name}, perturbation {k} of {perturbations}", quiet=quiet),
            )
        return TrialValues.of(found)

    return Sensitivity.measured(values, map(repeated, range(1, perturbations + 1)))


def check_finished(names: Iterable[str], out: Path) -> None:
    """Check that each configuration has a folder of outputs.

    Raises
    ------
    NothingToCompare
        If one has none.
    """
    from hident.run_folder import RunFolder

    for name in names:
        folder = out / Path(name).stem
        if not RunFolder(folder).finished:
            raise NothingToCompare(f"{folder} holds no finished run: hident run {Path(name).stem}")


def print_listing(families: Sequence[str], plugin_files: Iterable[Path]) -> None:
    """One line for each component of the families; a heading for each where there are several."""
    plugins.load(plugin_files)
    several = len(families) > 1
    for family in families:
        lines = list(_config_titles()) if family == "configs" else _summaries(family)
        if several:
            print(f"{family}:")
        width = max((len(name) for name, _ in lines), default=0)
        for name, text in lines:
            print(f"{'  ' * several}{name:<{width}}  {text}")


def _summaries(family: str) -> list[tuple[str, str]]:
    return [(kind, cls.summary()) for kind, cls in components(PLURALS[family]).items()]


def _config_titles() -> Iterator[tuple[str, str]]:
    from hident.config.load import read

    for path in sorted(Path("configs").glob("*.yaml")):
        try:
            yield path.stem, str(read(path).data.get("title", ""))
        except ConfigError as error:
            yield path.stem, f"({error})"


def print_component(family: str, kind: str, plugin_files: Iterable[Path]) -> None:
    """A component's description, source and fields."""
    from hident.config.describe import fields

    plugins.load(plugin_files)
    known = components(PLURALS[family])
    if kind not in known:
        near = did_you_mean(kind, known)
        raise ConfigError(f"no {PLURALS[family]} is named '{kind}'{near} (there are: {one_of(known)})")
    cls = known[kind]
    print(f"{kind}: {cls.summary()}")
    if cls.source:
        print(f"source: {cls.source}")
    if rows := list(fields(cls)):
        print()
        _print_columns([("key", "holds", "default", "meaning"), *rows])


def print_config(config: Path, plugin_files: Iterable[Path]) -> None:
    """A configuration's title, path, cases and estimators."""
    [plan] = load_plans([config], (), {}, plugin_files)
    print(f"{plan.name}: {plan.experiment.title}")
    print(described(plan))
    cases = [(axis.name, one_of(map(str, axis.labels))) for axis in plan.axes]
    estimators = [(name, spec.summary()) for name, spec in plan.experiment.estimators.items()]
    for header, rows in ((("case", "labels"), cases), (("estimator", "what it is"), estimators)):
        if rows:
            print()
            _print_columns([header, *rows])


def _print_columns(rows: Sequence[tuple[str, ...]]) -> None:
    """Columns, the last one wrapped to the width of the terminal."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]) - 1)]
    indent = sum(widths) + 2 * len(widths)
    room = max(30, shutil.get_terminal_size((120, 24)).columns - indent)
    for row in rows:
        head = "".join(f"{cell:<{width}}  " for cell, width in zip(row, widths, strict=False))
        first, *rest = textwrap.wrap(row[-1], room) or [""]
        print(f"{head}{first}".rstrip())
        for line in rest:
            print(" " * indent + line)


def print_status(plans: Sequence[Plan], place: Place) -> None:
    """For each plan: how many of its trials are stored, and the state of its outputs."""
    from hident.reports.output import Outputs

    store = Store(place.store)
    rows = [("configuration", "trials stored", "of", "outputs")]
    for plan in plans:
        done, wanted = sum(stored(plan, store)), plan.trials * len(plan.units)
        rows.append((plan.name, str(done), str(wanted), Outputs(plan, place.out / plan.name).state()))
    _print_columns(rows)
    print(f"{store.path}: {store.count()} scores in all")


def print_comparison(ours: Path, reference: Path, rtol: float, *, complete: bool, common: bool) -> Exit:
    """Print every difference between two folders of results, and what differs and may."""
    from hident.ledger.compare import compare

    comparison = compare(ours, reference, rtol=rtol, complete=complete, partial=common)
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
    _print_columns(rows)
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
    _print_columns([(finding.topic, finding.text) for finding in findings if not finding.state])
    for finding in findings:
        if finding.state:
            print(f"{finding.state}: {finding.topic}: {finding.text}")
    unsound = any(finding.state == "unsound" for finding in findings)
    print("something is unsound" if unsound else "nothing is unsound")
    return Exit.DIFFERS if unsound else Exit.FINE


def schema(plugin_files: Iterable[Path], *, unicode: bool = True) -> str:
    """The JSON Schema of configurations, in ASCII alone if it is to be."""
    plugins.load(plugin_files)
    return json.dumps(json_schema(Experiment, DATA), indent=2, ensure_ascii=not unicode)


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
