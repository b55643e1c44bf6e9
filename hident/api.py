"""What ``import hident`` offers besides the components: the verbs, from Python.

Wherever a component is wanted, an object or its written form will do: ``hident.Abs()``, ``"abs"`` or
``{"kind": "abs"}``. An experiment is a path, a mapping as its YAML file holds it, or an
:class:`Experiment`.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import ValidationError

from hident import arithmetic, plugins
from hident.commands.plans import file_of, load_plans
from hident.config.load import Document, problems_of, read_leniently
from hident.config.schema import json_schema
from hident.config.spec import PLURALS, Of, canonical, components, plain
from hident.config.suggest import counted, one_of
from hident.config.yaml12 import Place
from hident.engine import dask, runner
from hident.engine.cases import DATA
from hident.engine.cores import usable_cores
from hident.engine.executors import Given, SerialExecutor, Workers, make_executor
from hident.engine.expansion import not_given, unfit
from hident.engine.experiment import Experiment, Plan
from hident.engine.fingerprint import without_source
from hident.engine.preflight import check_records
from hident.engine.results import Results
from hident.engine.store import Store, TrialStore
from hident.engine.trial import Data, Job, generate, scoring_of
from hident.engine.work import Terms
from hident.errors import ConfigError
from hident.estimators.base import EstimatorSpec
from hident.metrics.base import MetricSpec
from hident.records import Estimate, Record
from hident.run_folder import phase
from hident.signals.base import ExcitationSpec, NoiseSpec
from hident.signals.streams import NumpyStreams, StreamsSpec
from hident.systems.base import SystemSpec

if TYPE_CHECKING:
    import pandas as pd
    from distributed import Client

    from hident.doctor import Finding
    from hident.ledger.compare import Comparison
    from hident.ledger.power import VerdictPower
    from hident.ledger.verify import Verification

Written = Mapping[str, Any] | str
"""A component as YAML writes it."""
Source = str | Path | Mapping[str, Any] | Experiment
"""An experiment: a file or the name of one under configs/, what such a file holds, or a made one."""
_NONE: Mapping[str, Any] = MappingProxyType({})


@cache
def _load_components() -> None:
    plugins.load()


@contextmanager
def _as_in_a_run() -> Iterator[None]:
    """BLAS on one thread, and numpy silent, as in every trial: so the numbers are a run's."""
    import scipy.linalg  # noqa: F401  (its BLAS must be loaded to be held)
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1), np.errstate(all="ignore"):
        yield


def _made(validate: Callable[[Any], Any], written: Any, name: str) -> Any:
    """What is meant, by a validator of Pydantic's; ``name`` is what a message begins with."""
    _load_components()
    try:
        return validate(plain(written))
    except ValidationError as error:
        raise Document(name, {}).error(problems_of(error)) from None


def simulate(
    system: SystemSpec | Written,
    excitation: ExcitationSpec | Written,
    samples: int,
    *,
    noise: NoiseSpec | Written | Sequence[NoiseSpec | Written] = (),
    dt: float | None = None,
    streams: StreamsSpec | Written = "numpy",
    seed: int = 1,
    trial: int = 0,
) -> Record:
    """The record that trial ``trial`` of a run with this seed has.

    Parameters
    ----------
    system, excitation, noise, streams
        Components; ``noise`` is one or a list, in the order in which they act.
    samples : int
        Length N of the record.
    dt : float, optional
        Sampling interval; leave it out in discrete time. All times are in its unit.
    seed, trial : int
        They decide the random numbers, which depend on the data-generating part and nothing else.

    Returns
    -------
    Record
        Input and output, shape (N,), read-only, with the truth behind them.

    Raises
    ------
    ConfigError
        With all that is wrong with the data-generating part.
    SimulationError
        If the simulation does not converge.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity=hi.DeadZone(low=-1, high=1), linear=hi.Ar(a=[0.5]))
    >>> excitation = hi.Iid(distribution="uniform", low=-3, high=3)
    >>> record = hi.simulate(system, excitation, 500, noise=hi.White(nsr=0.1))
    >>> record.y.shape, record.truth.linear
    ((500,), TransferFunction(b=(1.0,), a=(0.5,)))
    """
    fields = {
        "samples": samples,
        "dt": dt,
        "system": system,
        "excitation": excitation,
        "noise": noise,
        "streams": streams,
    }
    data = _made(Data.model_validate, fields, "simulate")
    if problems := list(unfit(data)):
        raise Document("simulate", {}).error(problems)
    with _as_in_a_run():
        return generate(data, seed, trial)


def fit(estimator: EstimatorSpec | Written, record: Record, *, seed: int = 1, trial: int = 0) -> Estimate:
    """The estimate from a record, as trial ``trial`` of a run with this seed makes it.

    ``estimator.fit(record)`` gives the same, without asking first whether the record suits the method.

    Parameters
    ----------
    estimator
        An estimator.
    record : Record
        Input and output, shape (N,); from :func:`simulate`, :func:`read` or made of arrays.
    seed, trial : int
        They decide the estimator's own random numbers, if it draws any.

    Raises
    ------
    ConfigError
        If the estimator is not sound, or the record lacks what it needs.
    EstimationError
        If the estimate is singular or diverges.

    Examples
    --------
    >>> import numpy as np
    >>> import hident as hi
    >>> record = hi.simulate(
    ...     hi.Hammerstein(nonlinearity="abs", linear=hi.Ar(a=[0.5])),
    ...     hi.Iid(distribution="uniform", low=-3, high=3),
    ...     500,
    ... )
    >>> kernel = hi.Kernel(kernel="gaussian", bandwidth={"h0": 0.5, "alpha": "1/5"})
    >>> hi.fit(kernel, record).nonlinearity(np.linspace(-1, 1, 3)).shape
    (3,)
    >>> hi.fit(kernel, hi.Record(np.zeros(0), np.zeros(0)))
    Traceback (most recent call last):
        ...
    hident.errors.ConfigError: estimator 'kernel' needs at least 1 sample, and the record has 0
    """
    spec: EstimatorSpec = _made(Of("estimator").validate, estimator, "estimator")
    named, fewest = f"estimator '{spec.kind}'", spec.fewest_samples()
    if len(record) < fewest:
        raise ConfigError(
            f"{named} needs at least {counted(fewest, 'sample')}, and the record has {len(record)}"
        )
    try:
        spec.check(len(record), record.dt)
    except ValueError as error:
        raise ConfigError(f"{named}: {error}") from None
    _require(named, "truth", spec.needs_of_truth(), _truth(record))
    spec.require_experiments(record)
    rng = NumpyStreams().generator("estimator", seed, Job(spec, ()).key, trial) if spec.draws() else None
    with _as_in_a_run():
        return spec.fit(record, rng)


def score(
    estimate: Estimate,
    record: Record,
    estimator: EstimatorSpec | Written | None = None,
    **metrics: MetricSpec | Written,
) -> dict[str, float]:
    """The numbers that metrics give an estimate, by their labels.

    Parameters
    ----------
    estimate : Estimate
        From :func:`fit`.
    record : Record
        What it was estimated from, with the truth if a metric compares with it.
    estimator : optional
        What made the estimate. No data determine the factor between the blocks: with the estimator the truth
        is brought to the form that its rule asks for, as a run does it; without, absolute values are compared
        as they stand, unless a metric's ``up_to`` says otherwise.
    **metrics
        Metrics, by the names that the labels begin with.

    Raises
    ------
    ConfigError
        If a metric is not sound, or the record or the estimate lacks what it needs.
    EstimationError
        If the estimate cannot be scored.

    Examples
    --------
    >>> import hident as hi
    >>> record = hi.simulate(
    ...     hi.Hammerstein(nonlinearity="abs", linear=hi.Ar(a=[0.5])),
    ...     hi.Iid(distribution="uniform", low=-3, high=3),
    ...     500,
    ... )
    >>> estimate = hi.fit(hi.KnownDynamics(a=[0.75]), record)
    >>> hi.score(estimate, record, a=hi.Error(of=["a_1"]), gain={"kind": "value", "of": ["b_0"]})
    {'a a_1': 0.25, 'gain b_0': 1.0}
    >>> system = hi.Hammerstein(nonlinearity="identity", linear=hi.Fir(b=[0, 6, 8]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-3, high=3), 500)
    >>> two_stage = hi.TwoStage(lags=2, degree=1)
    >>> error = hi.NonlinearityPercentError(interval=[-1, 1])
    >>> round(hi.score(hi.fit(two_stage, record), record, two_stage, error=error)["error"], 6)
    0.0
    """
    spec: EstimatorSpec | None = (
        None if estimator is None else _made(Of("estimator").validate, estimator, "estimator")
    )
    scores: dict[str, float] = {}
    for name, written in metrics.items():
        metric: MetricSpec = _made(Of("metric").validate, written, name)
        named = f"{name}: the metric '{metric.kind}'"
        _require(named, "truth", metric.needs_of_truth(), _truth(record))
        _require(named, "estimate", metric.needs_of_estimate(), estimate.provides())
        seen = record
        if spec is not None and record.truth is not None:
            try:
                metric, as_seen = scoring_of(metric, spec, record.truth, record.dt)
            except ValueError as error:
                raise ConfigError(f"{named} cannot compare with this system: {error}") from None
            seen = as_seen(record, estimate)
        with _as_in_a_run():
            values = metric.evaluate(estimate, seen)
        scores |= zip(metric.labels(name), map(float, values), strict=True)
    return scores


def _truth(record: Record) -> frozenset[str]:
    return frozenset() if record.truth is None else record.truth.provides()


def _require(named: str, what: str, needs: frozenset[str], given: frozenset[str]) -> None:
    for need in not_given(needs, given):
        has = f"it has: {one_of(sorted(given))}" if given else "it has none"
        raise ConfigError(f"{named} needs the {need} of the {what}, which is not there ({has})")


def validate(
    experiment: Source,
    *,
    trials: int | None = None,
    seed: int | None = None,
    overrides: Mapping[str, Any] = _NONE,
) -> Plan:
    """Check an experiment without running it.

    Parameters
    ----------
    experiment
        A file, or the name of one under configs/; a mapping as such a file holds; or an Experiment.
    trials, seed : int, optional
        In place of those of the experiment.
    overrides
        Further values by key path, as ``--set`` takes them: ``{"excitation.high": "2*pi"}``.

    Returns
    -------
    Plan
        The experiment with its cases expanded: ``plan.units`` holds each estimator on each case.

    Raises
    ------
    ConfigError
        With all that is wrong, one line for each problem.

    Examples
    --------
    >>> import hident as hi
    >>> hi.validate({"version": 1, "title": "Nothing", "trials": 0})
    Traceback (most recent call last):
        ...
    hident.errors.ConfigError: experiment: samples: is required: Length N of the record
    experiment: system: is required: The true system
    experiment: excitation: is required: The input signal
    experiment: trials: must be greater than or equal to 1 (got 0)
    experiment: estimators: is required: The estimators by the name that tables show
    experiment: metrics: is required: The metrics by the name that tables show
    """
    if isinstance(experiment, str | Path):
        document = read_leniently(file_of(Path(experiment)))
    else:
        document = Document("experiment", plain(canonical(experiment)))
    for key, value in {**overrides, "trials": trials, "seed": seed}.items():
        if value is not None or key in overrides:
            document = document.assigned(key, plain(canonical(value)), Place(0, f"{key}={value!r}"))
    [plan] = load_plans([document])
    return plan


def run(
    experiment: Source,
    *,
    trials: int | None = None,
    seed: int | None = None,
    store: str | Path | TrialStore | None = None,
    executor: Executor | Client | int | None = None,
    trial_timeout: float | None = None,
    overrides: Mapping[str, Any] = _NONE,
) -> Results:
    """Run an experiment, and return all its trials; nothing is written but the store, if one is named.

    Parameters
    ----------
    experiment, trials, seed, overrides
        As in :func:`validate`.
    store : str, Path or TrialStore, optional
        Folder of a trials store, such as ``.hident``, or any object that keeps trials: what it holds is not
        computed again. By default nothing is kept.
    executor : Executor, Client or int, optional
        Where trials run: a number of worker processes, any ``concurrent.futures.Executor``, or a
        ``distributed.Client``, whose workers are compared with this process first. By default here. The
        numbers do not depend on it. A script that starts processes needs the usual
        ``if __name__ == "__main__":``.
    trial_timeout : float, optional
        Seconds after which the simulation, an estimate or a metric of a trial is ended: the trial counts as
        failed, and is not stored. A single call into a library that does not return ends its worker process;
        without workers, it is waited for. By default there is no limit.

    Raises
    ------
    ConfigError
        With all that is wrong, one line for each problem.
    TrialsCrashed
        If a trial ended in an error that is not a result, or three worker processes with it; the tracebacks
        are among its notes. Or if there are no workers, as in a script without the line above.
    StoreError, StoreBusy
        If the store cannot be used, or another run holds it.

    Examples
    --------
    >>> import hident as hi
    >>> results = hi.run(
    ...     {
    ...         "version": 1,
    ...         "title": "Kernel estimates of a dead zone",
    ...         "trials": 5,
    ...         "system": hi.Hammerstein(nonlinearity=hi.DeadZone(low=-1, high=1), linear=hi.Ar(a=[0.5])),
    ...         "excitation": hi.Iid(distribution="uniform", low=-3, high=3),
    ...         "noise": hi.White(nsr=0.1),
    ...         "cases": {"samples": [200, 2000]},
    ...         "estimators": {"kernel": hi.Kernel(kernel="gaussian", bandwidth={"h0": 0.5, "alpha": 0.2})},
    ...         "metrics": {"mise": hi.IntegratedSquaredError(interval=[-3, 3])},
    ...     },
    ...     seed=7,
    ... )
    >>> results.frame()[["samples", "estimator", "metric", "trials", "failed"]]
       samples estimator metric  trials  failed
    0      200    kernel   mise       5       0
    1     2000    kernel   mise       5       0
    >>> results.trials_frame().shape
    (10, 5)
    """
    plan = validate(experiment, trials=trials, seed=seed, overrides=overrides)
    if said := arithmetic.shortfall(arithmetic.in_use()):
        warnings.warn(said, stacklevel=2)
    return _ran(plan.changed(trial_timeout=trial_timeout), store, executor)


def _ran(
    plan: Plan, store: str | Path | TrialStore | None, executor: Executor | Client | int | None
) -> Results:
    if store is not None or executor is not None:
        _require_source(plan)
    seconds: dict[str, float] = {}
    with phase(seconds, "records checked"):
        check_records(plan)
    with ExitStack() as stack, _as_in_a_run():
        if isinstance(store, str | Path):
            store = stack.enter_context(Store(Path(store)).writing())
            if said := runner.mended(plan, store):
                warnings.warn(said, stacklevel=3)
        elif not isinstance(store, TrialStore | None) or isinstance(store, type):
            raise ConfigError(
                f"store: must be a folder, or an object with the methods trials and add, not {store!r}"
            )
        try:
            workers = _workers(executor, plan)
            stack.push(partial(_ended, workers))
            with phase(seconds, "trials"):
                results = runner.run(plan, store=store, executor=workers)
            return replace(results, how={**results.how, "seconds": seconds})
        except runner.CrashReport as crash:
            crash.add_note(crash.tracebacks)
            raise
        except runner.WorkerEnded as ended:
            raise runner.WorkerEnded(kept=ended.kept, in_python=True) from None


def power(
    experiment: Source,
    *,
    trials: int | None = None,
    store: str | Path | TrialStore | None = None,
    executor: Executor | Client | int | None = None,
    overrides: Mapping[str, Any] = _NONE,
) -> VerdictPower:
    """Run the alternatives of an experiment: which of them each printed number excludes, each table rejects.

    Parameters
    ----------
    experiment, overrides
        As in :func:`validate`.
    trials : int, optional
        Trials of each alternative: at most those of the experiment, by default at most 40.
    store, executor
        As in :func:`run`.

    Raises
    ------
    ConfigError
        If there are no alternatives, or one of them cannot be run; and what :func:`run` raises.
    """
    from hident.engine.alternatives import alternative_plans
    from hident.ledger.mutation import measured, trials_of

    plan = validate(experiment, overrides=overrides)
    if not plan.experiment.alternatives:
        raise ConfigError(f"{plan.name}: has no 'alternatives'")
    alternatives = alternative_plans(plan, trials_of(plan, trials))
    return measured(plan, alternatives, lambda name, alternative: _ran(alternative, store, executor))


def _ended(workers: Workers, kind: type[BaseException] | None, *_: object) -> None:
    """Let the workers that were made here end; at once where Ctrl-C left them at work, perhaps for ever."""
    if kind is None:
        workers.shutdown()
    else:
        workers.kill()


def _workers(executor: Executor | Client | int | None, plan: Plan) -> Workers:
    """An executor as a run uses it; to shut it down ends what was made here only."""
    if executor is None:
        return SerialExecutor()
    if isinstance(executor, int) and not isinstance(executor, bool):
        return make_executor(executor, plan.plugin_files, [plan])
    terms = Terms.anywhere(plan.plugin_files, [plan])
    if dask.is_client(executor):
        if getattr(executor, "asynchronous", False):
            raise ConfigError("executor: must be a Client that waits for its answers (asynchronous=False)")
        return dask.DaskExecutor(lambda: executor, terms, own=False)
    if isinstance(executor, Executor):
        return Given(executor, usable_cores(), terms)
    raise ConfigError(
        "executor: must be a number of worker processes, a concurrent.futures.Executor or a "
        f"distributed.Client, not {executor!r}"
    )


def _require_source(plan: Plan) -> None:
    """Refuse components whose code neither a store nor a worker process can find."""
    for unit in plan.units:
        for spec in without_source((unit.data, unit.estimator, *unit.metrics.values())):
            raise ConfigError(
                f"{type(spec).__name__} was defined at a prompt or in a notebook, where a store or a worker "
                "process cannot find its code: import it from a file, or leave out 'store' and 'executor'"
            )


def write(results: Results, folder: str | Path) -> tuple[str, ...]:
    """Write what ``hident run`` writes to a folder: tables, figures, verdicts, all trials, run.json.

    Returns
    -------
    tuple of str
        A message for each figure that cannot be drawn.

    Raises
    ------
    StoreError
        If the folder cannot be written.
    """
    from hident.reports.output import Outputs

    how = dict(results.how)
    seconds = how.pop("seconds", {})
    return Outputs(results.plan, Path(folder)).write(results, how, seconds)


def status(
    experiment: Source,
    *,
    trials: int | None = None,
    seed: int | None = None,
    store: str | Path = ".hident",
    out: str | Path = "out",
    overrides: Mapping[str, Any] = _NONE,
) -> dict[str, Any]:
    """How many trials a store holds of an experiment, of how many, and the state of its outputs."""
    from hident.reports.output import Outputs

    plan = validate(experiment, trials=trials, seed=seed, overrides=overrides)
    with Store(Path(store)).reading() as reader:
        plan = runner.reached(plan, reader)
    return {
        "stored": sum(runner.stored(plan, Store(Path(store)))),
        "of": plan.trials * len(plan.units),
        "outputs": Outputs(plan, Path(out) / plan.name).state(),
    }


def compare(
    ours: str | Path = "out",
    reference: str | Path = "results",
    *,
    rtol: float = 1e-6,
    complete: bool = False,
    partial: bool = False,
) -> Comparison:
    """Compare two folders of results, trial by trial; without differences, ``differences`` is empty."""
    from hident.ledger.compare import compare as compare_folders

    return compare_folders(Path(ours), Path(reference), rtol=rtol, complete=complete, partial=partial)


def verify(
    folder: str | Path = "out",
    experiments: str | Path = "experiments",
    results: str | Path = "results",
    configs: str | Path | None = None,
) -> Verification:
    """The state of the ledger: how each table's numbers came out, and whether each difference has its reason.

    What is known of alternatives is what is accepted in ``results``. With ``configs`` each run must be that
    of the file of its name there.
    """
    from hident.ledger.verify import verify as verify_folder

    if configs is not None:
        plugins.load()
    return verify_folder(
        Path(folder), Path(experiments), Path(results), None if configs is None else Path(configs)
    )


def report(
    folders: str | Path | Sequence[str | Path] = "out",
    out: str | Path = "site",
    *,
    experiments: str | Path = "experiments",
    configs: str | Path = "configs",
    docs: str | Path | None = None,
) -> Path:
    """Build a site of results, as ``hident report`` does; returns the page to open.

    ``folders`` hold runs, or are those of one run. The site needs no network and no server. What is wrong
    with a run stands on its page, and is warned of.

    Raises
    ------
    NothingToCompare
        If a folder holds no run.
    ConfigError
        If ``out`` holds files that are not those of a site.
    StoreError
        If it cannot be written.
    """
    from hident.reports.site.build import build

    _load_components()
    every = [folders] if isinstance(folders, str | Path) else folders
    built = build(
        [Path(folder) for folder in every],
        Path(out),
        experiments=Path(experiments),
        configs=Path(configs),
        docs=None if docs is None else Path(docs),
    )
    for fault in built.faults:
        warnings.warn(fault, stacklevel=2)
    return built.front


def schema() -> dict[str, Any]:
    """The JSON Schema of experiments, with all known components.

    Examples
    --------
    >>> import hident as hi
    >>> hi.schema()["required"]
    ['version', 'title', 'trials', 'estimators', 'metrics']
    """
    _load_components()
    return json_schema(Experiment, DATA)


def list_components() -> pd.DataFrame:
    """All known components: family, kind, the name of the class, what it is, and its source.

    Examples
    --------
    >>> import hident as hi
    >>> known = hi.list_components().query("family == 'linear'")
    >>> known["name"].to_list()
    ['Ar', 'Arma', 'Continuous', 'ContinuousZpk', 'Fir', 'Sos', 'Zpk']
    """
    import pandas as pd

    _load_components()
    rows = [
        (family, kind, cls.__name__, cls.summary(), cls.source)
        for family in PLURALS.values()
        for kind, cls in components(family).items()
    ]
    return pd.DataFrame(rows, columns=["family", "kind", "name", "summary", "source"])


def examine(store: str | Path = ".hident") -> list[Finding]:
    """What ``hident doctor`` finds about this installation."""
    from hident.doctor import examine as examine_all

    return list(examine_all(Path(store), ()))
