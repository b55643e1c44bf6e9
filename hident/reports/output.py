"""What a run writes to its folder: made beside it, and moved in when all files are there."""

from __future__ import annotations

import hashlib
import lzma
import math
import platform
import subprocess
import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any, get_args

import numpy as np

import hident
from hident import arithmetic
from hident.config.load import Problem
from hident.config.spec import canonical
from hident.config.suggest import counted, one_of
from hident.config.variables import texts as texts_in
from hident.engine.experiment import Plan
from hident.engine.fingerprint import code
from hident.engine.results import Results
from hident.engine.run_files import (
    DEFAULT_FORMAT,
    PAGE,
    PAGE_TEX,
    TABLE,
    TEX,
    TIMING,
    TRIALS,
    VERDICTS,
    drawn_file,
    figure_file,
    figure_formats,
    table_file,
    tex_file,
    vector_file,
)
from hident.engine.trial import digest
from hident.errors import TrialFailed
from hident.ledger.power import FEWEST, VerdictPower, power_of, without_reports
from hident.ledger.published import PUBLISHED, REASONS
from hident.ledger.trial_values import TrialValues
from hident.ledger.verdicts import LEVEL, RUNS, Verdict, Word, fitting_runs, frame, judge
from hident.new_files import replacing
from hident.numerics.influence import largest_share
from hident.reports import drawn as drawing
from hident.reports import latex
from hident.reports.base import FigureSpec, ReportSpec, Table, TableSpec, misfits
from hident.reports.mathematics import typeset, whole
from hident.reports.scoring import scoring
from hident.reports.style import printed, style
from hident.reports.tables.writing import failing, failures, written
from hident.run_folder import RunFolder, State, phase

_PACKAGES = ("numpy", "scipy", "finufft", "pandas", "matplotlib", "pydantic")


class Outputs:
    """The outputs of a plan in a folder."""

    def __init__(self, plan: Plan, folder: Path) -> None:
        self.plan, self.folder = plan, folder

    @cached_property
    def key(self) -> str:
        """Hash of everything that the files depend on, with the paper's files as the plan knows them."""
        experiment, power = self.plan.experiment, power_of(self.plan)
        return digest(
            {
                "units": self.plan.keys,
                # With a rule, that and the units decide how many they are.
                "trials": self.plan.trials if self.plan.rule is None else canonical(self.plan.rule),
                "experiment": canonical(experiment),
                "paper": [
                    content and hashlib.sha256(content).hexdigest()
                    for content in map(self.plan.paper_file, (PUBLISHED, REASONS))
                ],
                "power": power and power.files(),
                "code": code(["hident.reports.output", *_modules(experiment.tables, experiment.figures)]),
                "libraries": [version(name) for name in _PACKAGES],
            }
        )

    def state(self) -> State:
        """Whether the folder holds, unaltered, what a run of the plan writes."""
        return RunFolder(self.folder).state(self.key)

    @np.errstate(all="ignore")
    def write(
        self, results: Results, run: Mapping[str, Any], seconds: Mapping[str, float] = MappingProxyType({})
    ) -> tuple[str, ...]:
        """Write tables, figures, verdicts and run.json.

        ``run`` joins the provenance, and ``seconds`` those of its phases.

        Returns a message for each figure that cannot be drawn, such as one with a label that is no
        mathematics: all else is written, and run.json lists the files of the figures as ``undrawn``. It
        counts the trials that the trial timeout ended as ``timed_out``. Whatever else a figure raises is a
        fault, and is raised when all else is written.

        Raises
        ------
        StoreError
            If the folder cannot be written.
        ConfigError
            If a table or the verdicts ask for a printed number that does not exist.
        """
        # With a rule, that of the results knows how many trials were needed.
        plan, seconds = results.plan, dict(seconds)
        formats = plan.experiment.formats
        with RunFolder(self.folder).renewed() as new, whole(_texts(plan)):
            with phase(seconds, "tables"):
                verdicts = judge(results)
                files = _write_tables(results, verdicts, new)
            with phase(seconds, "figures"):
                undrawn = _write_figures(results, verdicts, new.path)
            drawn = [name for name in plan.experiment.figures if name not in undrawn]
            files += [*self._figure_files(drawn), *map(drawn_file, drawn), *map(vector_file, drawn)]
            new.seal(
                {
                    "experiment": {**_described(plan), **_stopped(results)},
                    "files": sorted(files),
                    **({"formats": [*formats]} if formats != (DEFAULT_FORMAT,) else {}),
                    **({"undrawn": sorted(self._figure_files(undrawn))} if undrawn else {}),
                    "failures": _failures(results),
                    **({"timed_out": _timed_out(results)} if results.timed_out else {}),
                    "provenance": {**_provenance(plan), **run, "seconds": seconds, "key": self.key},
                }
            )
        with replacing(self.folder / TIMING) as file:
            results.timing_frame().to_csv(file, index=False, lineterminator="\n", float_format="%.4g")
        for error in undrawn.values():
            if not isinstance(error, ValueError | TrialFailed):
                raise error
        return tuple(
            f"{plan.path}: figures.{name}: cannot be drawn ({said})"
            for name, error in undrawn.items()
            for said in str(error).strip().splitlines()[-1:] or [type(error).__name__]
        )

    def _figure_files(self, names: Iterable[str]) -> list[str]:
        kinds = figure_formats(self.plan.experiment.formats)
        return [figure_file(name, kind) for name in names for kind in kinds]


def write_power(plan: Plan, power: VerdictPower, trials: int, folder: Path, run: Mapping[str, Any]) -> None:
    """Write what the printed numbers of a plan make of its alternatives, and run.json.

    StoreError if the folder cannot be written.
    """
    texts = {**power.files(), PAGE: _power_page(plan, power, trials)}
    with RunFolder(folder).renewed() as new:
        for name, text in texts.items():
            new.write_text(name, text)
        new.seal(
            {
                "experiment": {
                    "config": plan.name,
                    "seed": plan.seed,
                    "trials": trials,
                    "hash": without_reports(plan.experiment),
                },
                "files": sorted(texts),
                "provenance": {**_provenance(plan), **run},
            }
        )


def _power_page(plan: Plan, power: VerdictPower, trials: int) -> str:
    """What each table makes of each alternative, in words."""
    parts = [
        f"# {plan.experiment.title}",
        f"What the printed numbers make of the alternatives, by {counted(trials, 'trial')} of each.",
    ]
    if trials < FEWEST:
        parts.append(f"Fewer than {FEWEST} reject nothing by one number.")
    for table in dict.fromkeys(one.table for one in power.mutations):
        rejected, tried = power.score(table)
        rows = tuple(
            (
                one.alternative,
                f"{one.excluding} of {one.numbers}",
                "-" if math.isnan(one.joint_p) else written(one.joint_p, 2),
                "rejected" if one.rejected else "survives",
            )
            for one in power.of_table(table)
        )
        header = ("alternative", "numbers that exclude it", "joint p", "the table")
        title = f"{table}: mutation score {rejected} of {tried}"
        parts.append(Table(title, header, rows).markdown())
    return "\n\n".join(parts) + "\n"


def _texts(plan: Plan) -> Iterator[str]:
    """What the author of the file calls things, in tables and figures too."""
    experiment = plan.experiment
    for axis in plan.axes:
        yield from (axis.name, *map(str, axis.labels))
    for name, metric in experiment.metrics.items():
        yield from (name, *metric.labels(name))
    yield from experiment.estimators
    shown = {**experiment.tables, **experiment.figures}
    yield from (text for _, text in texts_in([canonical(spec) for spec in shown.values()], keys=True))


def check(plan: Plan) -> None:
    """Check that every table and figure can show this plan.

    Raises
    ------
    ConfigError
        With one line for each that cannot.
    """
    experiment = plan.experiment
    problems = [
        Problem((family, name, *place), message)
        for family, specs in (("tables", experiment.tables), ("figures", experiment.figures))
        for name, spec in specs.items()
        if isinstance(spec, ReportSpec)
        for place, message in misfits(plan, spec)
    ]
    if problems:
        raise plan.document.error(problems)


def markdown(results: Results, verdicts: Sequence[Verdict], tables: Mapping[str, Table]) -> str:
    """The text of table.md."""
    experiment = results.plan.experiment
    parts = [f"# {experiment.title}", f"{counted(results.plan.trials, 'trial')}, seed {results.plan.seed}."]
    if rule := _rule_said(results):
        parts.append(rule)
    if records := _records(results.plan):
        parts.append(" ".join(records))
    if said := list(scoring(results.plan)):
        parts.append(" ".join(said))
    parts += [table.markdown() for table in tables.values()]
    if not tables:
        parts.append(_plain_table(results).markdown())
    # The plain table says it of itself.
    if (
        tables
        and not any("failed" in note for table in tables.values() for note in table.notes)
        and (lost := _failed(results))
    ):
        parts.append(lost)
    if hanging := hanging_means(results):
        parts.append(f"{hanging}.")
    if verdicts:
        words = [verdict.word for verdict in verdicts]
        counts = ", ".join(f"{words.count(word)} {word}" for word in get_args(Word) if word in words)
        parts.append(f"Printed numbers: {len(words)}, of which {counts}.")
        parts += _differences(verdicts)
        parts += _runs(verdicts, results)
    return "\n\n".join(parts) + "\n"


def _failed(results: Results) -> str:
    """What to say of trials without a number where no table says it; nothing if there are none."""
    if not (found := [one for one in results.series if one.statistics["failed"]]):
        return ""
    worst = max(found, key=lambda one: one.statistics["failed"])
    why = f", {worst.reasons[0][0]}" if worst.reasons else ""
    return (
        f"{len(found)} of {len(results.series)} values failed in some trials, which their statistics leave "
        f"out (most often {worst.metric} of {worst.unit.described()}: in {worst.statistics['failed']:.0f} of "
        f"{worst.statistics['trials']:.0f}{why}); table.csv counts them."
    )


def hanging_means(results: Results) -> str:
    """What to say of means that hang on a single trial each; nothing if none does."""
    if not (found := results.hanging):
        return ""
    first = found[0]
    share = 100.0 * largest_share(first.values)
    return (
        f"{len(found)} of {len(results.series)} means hang on a single trial each (the first: {first.metric} "
        f"of {first.unit.described()}, where it is {share:.0f} % of the sum of squares); table.csv has the "
        "medians"
    )


def _records(plan: Plan) -> list[str]:
    """What is said of the measured records, each once."""
    return [*filter(None, dict.fromkeys(unit.data.says() for unit in plan.units))]


def _rule_said(results: Results) -> str:
    """What table.md says of the rule that ended the run; empty if there was none."""
    if (rule := results.plan.rule) is None:
        return ""
    which = one_of(rule.of) if rule.of else "every metric"
    looks = one_of(str(number) for number in rule.decisions if number <= results.plan.trials)
    said = (
        f"A sequential rule ended the run: the standard error of the {rule.statistic} of {which} was to be "
        f"at most {100 * rule.relative_se:g} % of it, for every estimator and case. It was asked after "
        f"{looks} trials"
    )
    if not (imprecise := results.imprecise()):
        return f"{said}, and met."
    names = dict.fromkeys(f"{one.metric} of {one.unit.described()}" for one in imprecise)
    return f"{said}, and with the most allowed not met by {'; '.join(names)}."


def _plain_table(results: Results) -> Table:
    """The main statistics of every series, where the configuration asks for no table."""
    columns = [axis.name for axis in results.plan.axes]
    columns += ["estimator", "metric", "trials", "failed", "mean", "std", "median"]
    rows = tuple(
        tuple(written(value) if isinstance(value, float) else str(value) for value in row)
        for row in results.frame()[columns].itertuples(index=False)
    )
    return Table("All statistics", tuple(columns), rows, tuple(failures(results.series)))


def _differences(verdicts: Sequence[Verdict]) -> list[str]:
    """The numbers that differ, those of one reason together."""
    differing = [verdict for verdict in verdicts if verdict.word == "differs"]
    return [
        "\n".join(
            [
                f"Differs: {reason or 'no reason is given yet.'}",
                "",
                *(
                    f"- {v.name}: printed {v.printed.printed}, ours {v.ours:.4g} [{v.low:.4g}, {v.high:.4g}]"
                    for v in differing
                    if v.reason == reason
                ),
            ]
        )
        for reason in dict.fromkeys(verdict.reason for verdict in differing)
    ]


def _runs(verdicts: Sequence[Verdict], results: Results) -> list[str]:
    """How many runs the paper may have averaged that does not say it."""
    found = fitting_runs(verdicts, results)
    lines = [
        f"- {name}: {', '.join(map(str, runs)) if runs else 'none of them'}" for name, runs in found.items()
    ]
    head = (
        f"Of means of {one_of(map(str, RUNS))} runs, the numbers together permit (joint p above {LEVEL:g}):"
    )
    return ["\n".join([head, "", *lines])] if lines else []


def _write_tables(results: Results, verdicts: Sequence[Verdict], folder: RunFolder) -> list[str]:
    tables = {
        name: spec.built(results, verdicts)
        for name, spec in results.plan.experiment.tables.items()
        if isinstance(spec, TableSpec)
    }
    texts = {TABLE: results.frame().to_csv(index=False, lineterminator="\n")}
    for name, table in tables.items():
        if table.data is not None:
            texts[table_file(name)] = table.data.to_csv(index=False, lineterminator="\n")
    if verdicts:
        texts[VERDICTS] = frame(verdicts).to_csv(index=False, lineterminator="\n")
    texts[PAGE] = markdown(results, verdicts, tables)
    if TEX in results.plan.experiment.formats:
        texts |= _tex(results, tables)
    for name, text in texts.items():
        folder.write_text(name, text)
    TrialValues.of(results).write(folder.path / TRIALS)
    return [*texts, TRIALS]


def _tex(results: Results, tables: Mapping[str, Table]) -> dict[str, str]:
    """Each table for LaTeX, and all of them in one file."""
    plan = results.plan
    said = [*_records(plan), *scoring(plan)]
    found = {
        name: latex.table(name, table, latex.caption(table, plan.trials, plan.seed), said)
        for name, table in (tables or {"results": _plain_table(results)}).items()
    }
    texts = {PAGE_TEX: "\n".join([latex.PREAMBLE, *found.values()])}
    return texts | {tex_file(name): latex.PREAMBLE + found[name] for name in tables}


def _write_figures(results: Results, verdicts: Sequence[Verdict], folder: Path) -> dict[str, Exception]:
    """Write what can be drawn; why the others cannot, by their names."""
    undrawn: dict[str, Exception] = {}
    kinds = figure_formats(results.plan.experiment.formats)
    for name, spec in results.plan.experiment.figures.items():
        assert isinstance(spec, FigureSpec)
        # Of values without a logarithm matplotlib says that there is nothing to draw, which the figure shows.
        with style(), warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            try:
                figure = spec.drawn(results, verdicts)
                (folder / drawn_file(name)).write_bytes(drawing.encoded(figure))
                typeset(figure)
                files = printed(figure, dict.fromkeys([*kinds, "svg"]))
                for kind in kinds:
                    (folder / figure_file(name, kind)).write_bytes(files[kind])
                (folder / vector_file(name)).write_bytes(lzma.compress(files["svg"]))
            except OSError:
                raise
            except Exception as error:
                undrawn[name] = error
                # What was begun of it.
                for file in (
                    drawn_file(name),
                    vector_file(name),
                    *(figure_file(name, kind) for kind in kinds),
                ):
                    (folder / file).unlink(missing_ok=True)
    return undrawn


def _described(plan: Plan) -> dict[str, Any]:
    """The experiment in run.json."""
    resolved, records = canonical(plan.experiment), _records(plan)
    # In which files it is shown is no matter of what was run.
    resolved.pop("formats", None)
    optional = [*dict.fromkeys(name for unit in plan.units for name in unit.data.optional_files)]
    return {
        "config": plan.name,
        "hash": digest(resolved),
        "seed": plan.seed,
        "trials": plan.trials,
        **({"records": records} if records else {}),
        **({"optional_files": optional} if optional else {}),
        "resolved": resolved,
    }


def _stopped(results: Results) -> dict[str, Any]:
    """In run.json, the rule that ended the run, if there was one."""
    if (rule := results.plan.rule) is None:
        return {}
    looks = [number for number in rule.decisions if number <= results.plan.trials]
    return {"sequential": {"looks": looks, "met": not results.imprecise()}}


def _failures(results: Results) -> list[dict[str, Any]]:
    """Which trials failed and why, in run.json: of each unit those that failed alike."""
    return [
        {
            "estimator": one.series[0].unit.name,
            "at": dict(one.series[0].unit.labels),
            # Without them, the estimate itself failed.
            **({"metrics": [*one.metrics]} if one.of_metrics else {}),
            "failed": one.failed,
            "trials": one.trials,
            "reasons": [{"reason": reason, "trials": count} for reason, count in one.reasons],
        }
        for one in failing(results.series)
    ]


def _timed_out(results: Results) -> dict[str, Any]:
    """The trials that the clock ended, in run.json."""
    return {"trials": results.timed_out, "trial_timeout": results.plan.trial_timeout}


def _provenance(plan: Plan) -> dict[str, Any]:
    """Where the files come from, in run.json."""
    return {
        "hident": hident.__version__,
        "python": platform.python_version(),
        "libraries": {name: version(name) for name in _PACKAGES},
        **_git(plan.root),
        "platform": platform.platform(),
        "cpu": _cpu(),
        "arithmetic": {"identity": arithmetic.identity(), **arithmetic.in_use()},
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def _modules(*families: Mapping[str, Any]) -> set[str]:
    return {type(spec).__module__ for family in families for spec in family.values()}


def _git(folder: Path) -> dict[str, Any]:
    def git(*arguments: str) -> str | None:
        try:
            done = subprocess.run(
                ["git", "-C", str(folder), *arguments], capture_output=True, text=True, check=True, timeout=10
            )
        except (OSError, subprocess.SubprocessError):
            return None
        return done.stdout.strip()

    commit = git("rev-parse", "HEAD")
    # Accepting the runs before this one has changed what is accepted, on which no run depends.
    changes = git("status", "--porcelain", "--untracked-files=no", "--", ":/", ":(exclude)results")
    return {"git_commit": commit, "git_dirty": None if changes is None else bool(changes)}


def _cpu() -> str:
    if sys.platform == "linux":
        try:
            for line in Path("/proc/cpuinfo").read_text().splitlines():
                if line.startswith("model name"):
                    return line.partition(":")[2].strip()
        except OSError:
            pass
    return platform.processor() or platform.machine()
