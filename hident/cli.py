"""The verbs of the command line, and nothing else; heavy imports stand inside the verbs."""

from __future__ import annotations

import atexit
import errno
import functools
import inspect
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

import hident
from hident import arithmetic, console, stopping
from hident.config.suggest import did_you_mean, one_of
from hident.errors import ConfigError, Exit, HidentError, NothingToCompare

if TYPE_CHECKING:
    from hident.engine.experiment import Plan


def _spread(**tables: Mapping[str, Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """The verb, with the options of each table in the place of a parameter that takes them as a mapping."""

    def spread(verb: Callable[..., None]) -> Callable[..., None]:
        signature = inspect.signature(verb, eval_str=True)
        parameters: list[inspect.Parameter] = []
        for name, own in signature.parameters.items():
            if name not in tables:
                parameters.append(own.replace(kind=own.KEYWORD_ONLY))
            for field, annotation in tables.get(name, {}).items():
                parameters.append(
                    inspect.Parameter(field, own.KEYWORD_ONLY, default=None, annotation=annotation)
                )

        @functools.wraps(verb)
        def spreading(**given: Any) -> None:
            mappings = {name: {field: given.pop(field) for field in table} for name, table in tables.items()}
            verb(**given, **mappings)

        del spreading.__wrapped__
        spreading.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        spreading.__annotations__ = {one.name: one.annotation for one in parameters}
        return spreading

    return spread


class _Unforeseen(Exception):
    """Carries an exception past what Typer makes of it."""


class _Verbs(TyperGroup):
    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except (OSError, EOFError) as error:
            # Typer would exit with 1, which stands for results that differ.
            raise _Unforeseen from error


app = typer.Typer(
    cls=_Verbs,
    no_args_is_help=True,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Monte Carlo experiments on identifying Hammerstein, Wiener and Wiener-Hammerstein systems.",
    epilog="Exit codes: 0 fine, 1 differs, unsound or a figure not drawn, 2 bad configuration or arguments, "
    "3 trials crashed, 4 nothing to compare, 70 an unforeseen error (a fault of hident), 75 another run "
    "holds the store, 130 interrupted (143 by SIGTERM, 129 by SIGHUP).",
)

Configs = Annotated[list[Path], typer.Argument(help="YAML files, or names of files under configs/.")]
Config = Annotated[Path, typer.Argument(help="A YAML file, or the name of a file under configs/.")]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY.PATH=VALUE", help="Override one key; may be repeated."),
]
Trials = Annotated[int | None, typer.Option(help="Override the number of trials.")]
Seed = Annotated[int | None, typer.Option(help="Override the seed.")]
Plugins = Annotated[
    list[Path] | None, typer.Option("--plugin", metavar="FILE.py", help="Load components from a file.")
]
StoreFolder = Annotated[Path, typer.Option("--store", help="Folder of the trials store.")]
Out = Annotated[Path, typer.Option("--out", help="Folder of the outputs.")]
Jobs = Annotated[
    int | None, typer.Option("--jobs", "-j", min=1, help="Worker processes; the usable cores by default.")
]
Workers = Annotated[
    str | None,
    typer.Option(
        "--executor",
        metavar="NAME",
        help="Where trials run: processes (the default), dask, or MODULE:FACTORY of any "
        "concurrent.futures.Executor.",
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="A Dask scheduler that stands: tcp://HOST:PORT, or its file."),
]
Formats = Annotated[
    str | None,
    typer.Option(
        "--format", metavar="FORMATS", help="Override the formats of the files: png,pdf,svg and tex."
    ),
]
Wait = Annotated[float, typer.Option(min=0, help="Seconds to wait while another run holds the store.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress and no tables.")]
TrialTimeout = Annotated[
    float | None,
    typer.Option(
        metavar="SECONDS",
        help="End a trial that takes longer: it counts as failed and is not stored. No limit by default.",
    ),
]
Log = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Append a line of JSON for each chunk of trials and each fault."),
]
Samples = Annotated[
    list[Path],
    typer.Argument(help="A file of samples (CSV, Parquet, MAT, NPZ, HDF5, ...), or one for each experiment."),
]
_WHICH: Mapping[str, Any] = {
    "input": Annotated[
        str | None,
        typer.Option(
            "--input", metavar="COLUMN", help="Name or number of the input's column; A,B: experiments."
        ),
    ],
    "output": Annotated[
        str | None,
        typer.Option("--output", metavar="COLUMN", help="Name or number of the output's column."),
    ],
    "estimation": Annotated[
        str | None,
        typer.Option("--estimate", metavar="FIRST..LAST", help="Samples to estimate from, counted from 1."),
    ],
    "validation": Annotated[
        str | None,
        typer.Option(
            "--validate",
            metavar="WHAT",
            help="For validation: FIRST..LAST, two columns INPUT,OUTPUT, or FILE[,INPUT,OUTPUT].",
        ),
    ],
    "units": Annotated[
        str | None,
        typer.Option(metavar="IN,OUT,TIME", help="Units of input, output and time, such as V,degC,s."),
    ],
}
"""Which samples are meant, by the fields of a record."""
_HOW: Mapping[str, Any] = {
    "dt": Annotated[
        str | None,
        typer.Option("--dt", metavar="DT", help="Sampling interval; a formula such as 1/51200 too."),
    ],
    "time": Annotated[
        str | None, typer.Option(metavar="COLUMN", help="The column of the sampling times, in place of --dt.")
    ],
    "detrend": Annotated[
        str | None, typer.Option(metavar="mean|linear", help="Take off the means, or a line.")
    ],
    "resample": Annotated[
        str | None, typer.Option(metavar="DT", help="Interpolate uneven times at an interval, along lines.")
    ],
    "decimate": Annotated[
        int | None, typer.Option(metavar="FACTOR", help="Keep every so many-th sample, behind a filter.")
    ],
    "gaps": Annotated[
        str | None,
        typer.Option(
            metavar="error|split", help="A missing sample is an error (the default), or a part's end."
        ),
    ],
    "missing": Annotated[
        str | None,
        typer.Option(metavar="VALUES", help="What stands for a missing sample, such as -9999; several: A,B."),
    ],
    "decimal": Annotated[
        str | None,
        typer.Option(metavar=".|,", help="What stands before decimals in text; by default, as seen."),
    ],
}
"""How a record is read, by its fields: one table for all verbs that read one."""
ModelFile = Annotated[Path, typer.Argument(help="A fitted model: model.json.")]
_STORE, _OUT, _RESULTS = Path(".hident"), Path("out"), Path("results")


Listed = StrEnum(
    "Listed",
    "estimators systems linears nonlinearities excitations noises streams metrics bases blocks tables "
    "figures configs",
)


_LIMITS = {errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EAGAIN}
"""Files, memory and processes."""

_SECONDS_TO_END = 5.0


def main() -> None:
    """Entry point of the console script."""
    # This program opens no window; a notebook's backend, which may not be installed here, ends the import.
    os.environ["MPLBACKEND"] = "agg"
    console.harden()
    stopping.listen()
    code = _exit_code()
    if code == Exit.INTERRUPTED:
        code = stopping.exit_code()
    if lost := console.fault():
        print(f"error: standard output cannot be written ({lost})", file=sys.stderr)
        code = code or Exit.BAD_INPUT
    if code == stopping.exit_code():
        _leave_threads(code)
    sys.exit(code)


def _leave_threads(code: int) -> None:
    """End soon where threads or processes of an executor compute on, perhaps for ever: python would wait."""
    here = threading.current_thread()
    threads = [thread for thread in threading.enumerate() if thread is not here and not thread.daemon]
    children = multiprocessing.active_children()
    if threads or children:
        for child in children:
            os.kill(child.pid or os.getpid(), getattr(signal, "SIGKILL", signal.SIGTERM))
        # What is to be done at the end may wait for them too.
        ending = threading.Thread(target=atexit._run_exitfuncs, daemon=True)
        ending.start()
        ending.join(_SECONDS_TO_END)
        os._exit(code)


def _exit_code() -> int:
    """Run the verb, and say what ended it early."""
    try:
        app()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else Exit.FINE
    except HidentError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        return Exit.INTERRUPTED
    except BaseException as error:
        cause = error.__cause__ if isinstance(error, _Unforeseen) and error.__cause__ else error
        if limit := _limit(cause):
            print(
                f"error: the system gives this program no more ({limit}): raise its limits (ulimit -a shows "
                "them), or run with fewer --jobs",
                file=sys.stderr,
            )
            return Exit.BAD_INPUT
        _report(cause)
        return Exit.UNFORESEEN
    return Exit.FINE


def _limit(error: BaseException) -> str:
    """What the system gave no more of; empty if the error is another one."""
    if isinstance(error, MemoryError):
        return str(error) or "out of memory"
    return str(error.strerror) if isinstance(error, OSError) and error.errno in _LIMITS else ""


def _report(error: BaseException) -> None:
    """One line on an unforeseen exception, and its traceback in a file; here if no file can be written."""
    import tempfile
    import traceback

    text = "".join(traceback.format_exception(error))
    said = " ".join("".join(traceback.format_exception_only(error)).split())
    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix="hident-", suffix=".txt", delete=False, encoding="utf-8", errors="backslashreplace"
        ) as file:
            file.write(f"hident {hident.__version__}: {sys.argv[1:]!r}\n\n{text}")
        where = f"the traceback is in {file.name}"
    except OSError:
        where = f"the traceback:\n{text}"
    print(f"error: unforeseen, a fault of hident: {said}; {where}", file=sys.stderr)


def _plans(
    configs: Iterable[Path],
    assignments: list[str] | None,
    trials: int | None,
    seed: int | None,
    plugin: list[Path] | None,
    trial_timeout: float | None = None,
    formats: str | None = None,
) -> list[Plan]:
    """The plans of all configurations but those whose optional records are not here, which it names."""
    from hident.commands.plans import load_plans

    def left_out(said: str) -> None:
        print(f"left out: {said}", file=sys.stderr)

    options = {"trials": trials, "seed": seed, "formats": formats}
    plans = load_plans(configs, assignments, options, plugin or (), left_out)
    return [plan.changed(trial_timeout=trial_timeout) for plan in plans]


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"hident {hident.__version__}")
        raise typer.Exit


@app.callback()
def _program(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    arithmetic.asked()


def _listed(what: str) -> Listed:
    try:
        return Listed(what)
    except ValueError:
        near = did_you_mean(what, Listed)
        raise typer.BadParameter(f"'{what}' cannot be listed{near} (there are: {one_of(Listed)})") from None


@app.command("list")
def list_(
    what: Annotated[
        Listed | None, typer.Argument(parser=_listed, help="What to list; everything by default.")
    ] = None,
    kind: Annotated[
        str | None, typer.Argument(help="One component, to see its fields, or one configuration.")
    ] = None,
    plugin: Plugins = None,
) -> None:
    """List the components that a configuration can use."""
    from hident.commands.listing import print_component, print_config, print_listing

    families = [what.value] if what else [listed.value for listed in Listed]
    if kind is None:
        print_listing(families, plugin or ())
    elif what is Listed.configs:
        print_config(Path(kind), plugin or ())
    else:
        print_component(families[0], kind, plugin or ())


@app.command()
def validate(
    configs: Configs,
    assignments: Set = None,
    trials: Trials = None,
    seed: Seed = None,
    plugin: Plugins = None,
) -> None:
    """Check configurations without running them.

    All errors of all files are shown at once.
    """
    from hident.commands.plans import described
    from hident.engine.alternatives import alternative_plans

    for plan in _plans(configs, assignments, trials, seed, plugin):
        alternative_plans(plan)
        print(described(plan))


@app.command()
def run(
    configs: Configs,
    assignments: Set = None,
    trials: Trials = None,
    at_most: Annotated[
        int | None, typer.Option(min=1, help="No configuration runs more trials than these.")
    ] = None,
    seed: Seed = None,
    jobs: Jobs = None,
    executor: Workers = None,
    scheduler: Scheduler = None,
    out: Out = _OUT,
    store: StoreFolder = _STORE,
    formats: Formats = None,
    keep_going: Annotated[bool, typer.Option("--keep-going", help="Finish the rest after a crash.")] = False,
    trial_timeout: TrialTimeout = None,
    wait: Wait = 0.0,
    log: Log = None,
    quiet: Quiet = False,
    plugin: Plugins = None,
) -> None:
    """Run experiments, and write tables, figures and verdicts.

    Only trials that are not stored yet are computed.
    """
    from hident.commands.log_file import logging_to
    from hident.commands.running import bench

    plans = _plans(configs, assignments, trials, seed, plugin, trial_timeout, formats)
    if at_most is not None:
        plans = [plan.at_most(at_most) for plan in plans]
    with (
        logging_to(log),
        bench(plans, out, store, wait, jobs, plugin or (), quiet, executor, scheduler) as place,
    ):
        code = place.run(keep_going=keep_going)
    raise typer.Exit(code)


@app.command()
def power(
    configs: Configs,
    assignments: Set = None,
    trials: Annotated[
        int | None,
        typer.Option(
            min=1, help="Trials of each alternative; 40 by default, and no more than the configuration's."
        ),
    ] = None,
    jobs: Jobs = None,
    out: Out = _OUT,
    store: StoreFolder = _STORE,
    trial_timeout: TrialTimeout = None,
    wait: Wait = 0.0,
    log: Log = None,
    quiet: Quiet = False,
    plugin: Plugins = None,
) -> None:
    """Run the alternatives, and write what the numbers exclude.

    Configurations without 'alternatives' are left out.
    """
    from hident.commands.log_file import logging_to
    from hident.commands.running import bench

    plans = _plans(configs, assignments, None, None, plugin, trial_timeout)
    plans = [plan for plan in plans if plan.experiment.alternatives]
    if not plans:
        raise NothingToCompare("no configuration that is named has 'alternatives'")
    with logging_to(log), bench(plans, out, store, wait, jobs, plugin or (), quiet) as place:
        place.power(trials)


@app.command()
def status(
    configs: Annotated[
        list[Path] | None, typer.Argument(help="YAML files or names; all of configs/ by default.")
    ] = None,
    assignments: Set = None,
    trials: Trials = None,
    seed: Seed = None,
    out: Out = _OUT,
    store: StoreFolder = _STORE,
    watching: Annotated[
        bool,
        typer.Option("--watch", help="Show how far each case of a run is, until all is stored or Ctrl-C."),
    ] = False,
    interval: Annotated[float, typer.Option(min=0.1, help="Seconds between two looks of --watch.")] = 2.0,
    plugin: Plugins = None,
) -> None:
    """Show how many trials are stored, and the state of outputs."""
    from hident.commands.plans import all_configs
    from hident.commands.showing import print_status
    from hident.commands.watching import watch

    plans = _plans(configs or all_configs(), assignments, trials, seed, plugin)
    if watching:
        watch(plans, store, interval)
    else:
        print_status(plans, out, store)


@app.command()
def compare(
    ours: Annotated[Path, typer.Argument(help="A folder of results, such as out.")] = _OUT,
    reference: Annotated[Path, typer.Argument(help="The folder to hold it against.")] = _RESULTS,
    rtol: Annotated[
        float, typer.Option(min=0, help="Relative tolerance of every number; 0 asks for every bit.")
    ] = 1e-6,
    complete: Annotated[
        bool, typer.Option("--complete", help="A configuration that was not run is a difference too.")
    ] = False,
    partial: Annotated[
        bool, typer.Option("--partial", help="Compare runs of other numbers of trials on the common ones.")
    ] = False,
) -> None:
    """Compare two folders of results, trial by trial.

    Between equal arithmetics no trial may differ; between others as many as the accepted results make likely.
    A missing or extra file, row or column is a difference.
    """
    from hident.commands.showing import print_comparison

    raise typer.Exit(print_comparison(ours, reference, rtol, complete=complete, partial=partial))


@app.command()
def accept(
    configs: Annotated[list[str], typer.Argument(help="Names of configurations whose results to accept.")],
    assignments: Set = None,
    trials: Trials = None,
    seed: Seed = None,
    jobs: Jobs = None,
    out: Out = _OUT,
    results: Annotated[Path, typer.Option(help="Folder of the accepted results.")] = _RESULTS,
    store: StoreFolder = _STORE,
    formats: Formats = None,
    perturbations: Annotated[
        int, typer.Option(min=1, help="Repetitions with records that are a last bit away.")
    ] = 2,
    trial_timeout: TrialTimeout = None,
    wait: Wait = 0.0,
    log: Log = None,
    of_power: Annotated[
        bool, typer.Option("--power", help="What hident power wrote, in the place of runs.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress.")] = False,
    plugin: Plugins = None,
) -> None:
    """Make the outputs of a run the accepted results.

    Measures how many of the trials a last bit moves, for compare. Nothing else changes results/.
    """
    from hident.commands.log_file import logging_to
    from hident.commands.running import accept_power, bench, check_finished

    if of_power:
        plans = _plans(map(Path, configs), assignments, None, seed, plugin)
        for line in accept_power(plans, out, results):
            print(line)
        return
    check_finished(configs, out)
    plans = _plans(map(Path, configs), assignments, trials, seed, plugin, trial_timeout, formats)
    with logging_to(log), bench(plans, out, store, wait, jobs, plugin or (), quiet) as place:
        place.accept(results, perturbations)


@app.command()
def verify(
    folder: Annotated[
        Path | None, typer.Argument(help="A folder of results; out by default, results if there is none.")
    ] = None,
    experiments: Annotated[Path, typer.Option(help="Folder of the papers' ledgers.")] = Path("experiments"),
    complete: Annotated[
        bool,
        typer.Option(
            "--complete",
            help="Every printed number of a paper must be judged, by the configurations as they are now.",
        ),
    ] = False,
    configs: Annotated[Path, typer.Option(help="Folder of the configurations, for --complete.")] = Path(
        "configs"
    ),
    results: Annotated[
        Path, typer.Option(help="Folder of the accepted results, for what is known of alternatives.")
    ] = _RESULTS,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Check that each difference has its reason, and what can differ.

    For each table: how its numbers came out, how likely it is as a whole, and how many of the alternatives it
    rejects.
    """
    from hident.commands.showing import print_verification

    if folder is None:
        folder = _OUT if _OUT.is_dir() else _RESULTS
    raise typer.Exit(
        print_verification(folder, experiments, results, configs, complete=complete, as_json=as_json)
    )


@app.command()
def report(
    folders: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="FOLDER",
            help="Folders of results, or of one run; out by default, results if there is none.",
        ),
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="Folder of the site.")] = Path("site"),
    experiments: Annotated[Path, typer.Option(help="Folder of the papers' ledgers.")] = Path("experiments"),
    configs: Annotated[Path, typer.Option(help="Folder of the configurations.")] = Path("configs"),
    docs: Annotated[
        Path | None, typer.Option(help="Folder of the handbook, if it is not to be hident's own.")
    ] = None,
    serving: Annotated[
        bool,
        typer.Option(
            "--serve", help="Serve it to this machine, and build it again when results change, until Ctrl-C."
        ),
    ] = False,
    port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="Port of --serve: 8000 by default, 0 any free one.")
    ] = None,
    plugin: Plugins = None,
) -> None:
    """Build a site of results, to be opened in a browser.

    The ledger, a page for each run and each component, and the handbook: files that need no network and no
    server. What has not changed since the last time is not made again.
    """
    from hident.commands.reporting import report, serve_report

    if port is not None and not serving:
        raise ConfigError("--port is for --serve: without it, files are written and nothing is served")
    folders = folders or [_OUT if _OUT.is_dir() else _RESULTS]
    sources = (folders, out, experiments, configs, docs, plugin or ())
    raise typer.Exit(serve_report(*sources, port) if serving else report(*sources))


@app.command()
def schema(
    as_markdown: Annotated[
        bool, typer.Option("--markdown", help="The same for readers: every key of every component.")
    ] = False,
    plugin: Plugins = None,
) -> None:
    """Print the JSON Schema of configurations, for editors."""
    from hident.commands.listing import reference, schema

    if as_markdown:
        print(reference(plugin or ()), end="")
        return
    print(schema(plugin or (), unicode=sys.stdout.encoding.lower().startswith("utf")))


@app.command()
def export(
    config: Config,
    file: Annotated[Path, typer.Argument(help="Where to: FILE.csv or FILE.parquet.")],
    what: Annotated[
        str,
        typer.Option(
            metavar="values|records|estimates|timing",
            help="Scores (values, the default) and seconds, as stored; records and estimates, made again.",
        ),
    ] = "values",
    assignments: Set = None,
    trials: Trials = None,
    seed: Seed = None,
    store: StoreFolder = _STORE,
    plugin: Plugins = None,
) -> None:
    """Write the trials to CSV or Parquet.

    One row for each trial and metric; or for each sample of each record, each parameter and point of a curve
    of each estimate, each fit.
    """
    from hident.commands.exporting import What, export
    from hident.commands.plans import load_plans

    if what not in (names := [*What]):
        near = did_you_mean(what, names)
        raise typer.BadParameter(f"'{what}' cannot be exported{near} (allowed: {one_of(names)})")
    [plan] = load_plans([config], assignments, {"trials": trials, "seed": seed}, plugin or ())
    print(export(plan, store, file, What(what)))


@app.command()
@_spread(which=_WHICH, how=_HOW)
def show(
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            help="A folder of results; a configuration; a fitted model (.json); or files of samples (CSV, "
            "MAT, ...). The runs of out and results by default."
        ),
    ] = None,
    *,
    which: Mapping[str, Any],
    how: Mapping[str, Any],
    trial: Annotated[
        int | None, typer.Option(min=0, help="Of a configuration: the number of the trial; 0 by default.")
    ] = None,
    worst: Annotated[
        str | None, typer.Option(metavar="METRIC", help="The stored trial that is worst by this metric.")
    ] = None,
    best: Annotated[
        str | None, typer.Option(metavar="METRIC", help="The stored trial that is best by this metric.")
    ] = None,
    failed: Annotated[
        bool, typer.Option("--failed", help="List the stored trials that failed, with the reasons.")
    ] = False,
    estimator: Annotated[
        str | None, typer.Option(metavar="NAME", help="One estimator; all of the case by default.")
    ] = None,
    case: Annotated[
        list[str] | None,
        typer.Option(metavar="AXIS=LABEL", help="A label of the case; the first case by default."),
    ] = None,
    parquet: Annotated[bool, typer.Option("--parquet", help="Write tables as Parquet, not CSV.")] = False,
    assignments: Set = None,
    trials: Trials = None,
    seed: Seed = None,
    store: StoreFolder = _STORE,
    plugin: Plugins = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder to write to, of anything; for a trial by default out/CONFIG/trial-NUMBER."),
    ] = None,
) -> None:
    """Show a run, one trial, a measured record or a fitted model.

    Of a run, such as out/mzyk_table1: its tables, each printed number beside ours with the trials behind it,
    why some differ, and what makes it again. Of a folder of runs, or of none: the runs and their state. Of a
    trial, which is made again: its scores beside those of all stored trials, and as files the record, the
    estimates (parameters, curves of the blocks), the scores and a figure. Of a record: signals, delay, which
    nonlinearities the input can excite, and what is wrong with it. Of a model (.json): its blocks as
    formulas. Figures of these with --out. The options from --trial on are for a configuration, those before
    for a record.
    """
    from hident.commands.measured import option
    from hident.commands.plans import is_config, load_plans
    from hident.commands.results_folders import is_results, list_runs
    from hident.commands.shown_run import show_results

    of_record = {option(field): value for field, value in {**which, **how}.items()}
    of_trial = {
        "--trial": trial,
        "--worst": worst,
        "--best": best,
        "--failed": failed or None,
        "--estimator": estimator,
        "--case": case,
        "--parquet": parquet or None,
        "--set": assignments,
        "--trials": trials,
        "--seed": seed,
        "--plugin": plugin,
    }
    if not files or (len(files) == 1 and is_results(files[0])):
        options = of_record | of_trial | {"--out": out}
        if strange := [name for name, value in options.items() if value is not None]:
            named = f"{files[0]} is a folder of results" if files else "no file is named"
            raise ConfigError(f"{named}, and {one_of(strange)} is for configurations and measured records")
        raise typer.Exit(show_results(files[0], _RESULTS) if files else list_runs([_OUT, _RESULTS]))
    config = len(files) == 1 and is_config(files[0])
    others = of_record if config else of_trial
    if strange := [name for name, value in others.items() if value is not None]:
        what = ("a configuration", "measured records") if config else ("no configuration", "configurations")
        raise ConfigError(f"{files[0]} is {what[0]}, and {one_of(strange)} is for {what[1]}")
    if config:
        from hident.commands.one_trial import Wanted, show_trial

        wanted = Wanted(trial, worst, best, failed, estimator, tuple(case or ()))
        [plan] = load_plans(files, assignments, {"trials": trials, "seed": seed}, plugin or ())
        raise typer.Exit(show_trial(plan, store, wanted, out, parquet=parquet))
    if len(files) == 1 and files[0].suffix.lower() == ".json":
        from hident.commands.models import print_model

        print_model(files[0], out)
        return
    from hident.commands.looking import show

    raise typer.Exit(show(files, out, **which, **how))


@app.command()
@_spread(which=_WHICH, how=_HOW)
def identify(
    files: Samples,
    *,
    which: Mapping[str, Any],
    how: Mapping[str, Any],
    structure: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="linear, hammerstein, wiener, wiener_hammerstein or hammerstein_wiener; by default all.",
        ),
    ] = None,
    by: Annotated[
        str,
        typer.Option(
            metavar="validation|aic|bic",
            help="What chooses: samples that are kept apart, or a criterion of those that are fitted.",
        ),
    ] = "validation",
    n_init: Annotated[
        int | None,
        typer.Option("--n-init", min=0, help="First samples of each experiment that are not fitted."),
    ] = None,
    start: Annotated[
        str,
        typer.Option(
            metavar="settled|rest|estimated",
            help="Before a record: its first input for ever, nothing, or what its first samples tell.",
        ),
    ] = "settled",
    delay: Annotated[
        int | None,
        typer.Option(min=0, metavar="N", help="The delay in samples; by default from correlation and fits."),
    ] = None,
    bootstraps: Annotated[
        int,
        typer.Option("--bootstrap", min=0, help="Fit the model again so often, for bands in the figures."),
    ] = 0,
    out: Annotated[Path | None, typer.Option(help="Folder to write to (default: out/identify_FILE).")] = None,
) -> None:
    """Find a model of a measured record.

    Structures, orders and static functions are tried, and chosen by samples that are kept apart.
    """
    from hident.commands.identifying import identify_file

    identify_file(
        files,
        structure or (),
        by,
        n_init,
        start,
        delay,
        bootstraps,
        out,
        **which,
        **how,
    )


@app.command()
@_spread(how=_HOW)
def simulate(
    model: ModelFile,
    data: Samples,
    input_name: Annotated[
        str | None,
        typer.Option("--input", metavar="COLUMN", help="Column of the input; by default the model's own."),
    ] = None,
    compare: Annotated[
        str | None, typer.Option(metavar="COLUMN", help="Column of a measured output to compare with.")
    ] = None,
    *,
    how: Mapping[str, Any],
    samples: Annotated[
        str | None, typer.Option(metavar="FIRST..LAST", help="Of each experiment, counted from 1.")
    ] = None,
    k_step: Annotated[
        int,
        typer.Option("--k-step", min=0, help="Predict so many samples ahead from --compare; 0 simulates."),
    ] = 0,
    n_init: Annotated[
        int, typer.Option("--n-init", min=0, help="First samples that the comparison leaves out.")
    ] = 0,
    start: Annotated[
        str | None,
        typer.Option(
            metavar="settled|rest|estimated",
            help="Before the first sample: its input for ever, nothing, or states that --compare tells; by "
            "default as the model was fitted.",
        ),
    ] = None,
    any_dt: Annotated[
        bool, typer.Option("--any-dt", help="Take samples of another interval as if they were the model's.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE.csv", help="Write time, input, output and residual.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw them.")] = None,
) -> None:
    """Simulate a fitted model.

    What was measured can stand beside it, and is compared.
    """
    from hident.commands.models import simulate_model

    simulate_model(
        model,
        data,
        input_name=input_name,
        compare=compare,
        steps=k_step,
        n_init=n_init,
        start=start,
        any_dt=any_dt,
        out=out,
        plot=plot,
        estimation=samples,
        **how,
    )


@app.command()
def convert(
    model: ModelFile,
    to: Annotated[str, typer.Option(metavar="NAME", help="python, scipy, control, matlab or simulink.")],
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Where to; printed by default.")] = None,
) -> None:
    """Write a fitted model as source code.

    The program that it is for gives the same response.
    """
    from hident.commands.models import convert_model

    convert_model(model, to, out)


@app.command()
def new(
    what: Annotated[str, typer.Argument(metavar="study|paper|plugin", help="What to begin.")],
    name: Annotated[str, typer.Argument(help="Its name: small letters, digits and _.")],
    into: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Where to; the current folder by default.")
    ] = Path(),
) -> None:
    """Begin a study, the reproduction of a paper, or a plugin.

    Writes commented files that run as they are; no file that is there is touched. A study compares two
    methods on one system. A paper has its printed numbers, its reasons and a first table. A plugin has a
    method, a metric, their tests and a configuration.
    """
    from hident.commands.starting import start

    for line in start(what, name, into):
        print(line)


@app.command()
def doctor(store: StoreFolder = _STORE, plugin: Plugins = None) -> None:
    """Show what a report of a fault needs, and what is unsound."""
    from hident.commands.showing import print_diagnosis

    raise typer.Exit(print_diagnosis(store, plugin or ()))
