"""The contracts of components, for the tests of those who write one.

:func:`check` tries everything that a component owes in one line of any test; :func:`checks` gives each as a
check of its own, by name, for pytest's ``parametrize`` or a loop. hident's own components pass the same.
Nothing here needs pytest.
"""

from __future__ import annotations

import sys
from collections.abc import Collection, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from hident import plugins
from hident.config.spec import Component, canonical
from hident.engine.trial import Data, Job, estimate
from hident.estimators.base import EstimatorSpec
from hident.metrics.base import MetricSpec
from hident.signals.base import ExcitationSpec, NoiseSpec
from hident.signals.experiments import Experiments
from hident.systems.base import MemorySpec, NonlinearitySpec, SystemSpec
from hident.testing.base import Check, Contract, made_data, record_of
from hident.testing.components import ClassContract, ExampleContract, SettingContract
from hident.testing.estimators import Dull, EstimatorContract, Invariance
from hident.testing.metrics import MetricContract, of_truth
from hident.testing.systems import (
    ExcitationContract,
    MemoryContract,
    NoiseContract,
    NonlinearityContract,
    SystemContract,
    WaveformContract,
)

__all__ = ["Check", "check", "checks", "plugin"]


def plugin(path: str | Path) -> ModuleType:
    """The module of a plugin file, loaded as a run loads it.

    So a test can use its classes, and run configurations that name the file under ``plugins``.

    Raises
    ------
    ConfigError
        If the file cannot be loaded.

    Examples
    --------
    >>> Path("valve.py").write_text("STEEPNESS = 0.5")
    15
    >>> plugin("valve.py").STEEPNESS
    0.5
    """
    path = Path(path).resolve()
    plugins.load([path])
    return sys.modules[f"{plugins.package_of(path.parent)}.{path.stem}"]


def checks(
    component: Component,
    *,
    data: Mapping[str, Any] | None = None,
    several: ExcitationSpec | Mapping[str, Any] | None = None,
    invariances: Collection[Invariance] = (),
    learns_from: Collection[Dull] = (),
    estimator: EstimatorSpec | None = None,
) -> list[Check]:
    """Everything that a component owes, each as a check that raises AssertionError when it is called.

    Parameters
    ----------
    component : Component
        The component to check, with settings of your choice. What it owes may depend on them: check an
        estimator at several, each by a call of its own.
    data : mapping, optional
        The data of a case, by the keys of a configuration: ``system``, ``excitation``, ``noise``,
        ``samples``, ``dt``. By default 300 samples of a Hammerstein system with a cubic and a pole at 0.5.
        An excitation, a noise or a system that is checked takes the place of theirs.
    several : ExcitationSpec or mapping, optional
        For an estimator, an excitation with several experiments; by default that of the data twice.
    invariances : {"scale", "order"}
        What else an estimator promises: its nonlinearity scales with the output and its feedback stays; the
        order of the samples does not matter.
    learns_from : {"constant input", "constant output", "period of two"}
        What excites nothing, and is nevertheless enough for the estimator.
    estimator : EstimatorSpec, optional
        For a metric, what makes the estimate that it scores; by default that is the truth itself.

    Raises
    ------
    ConfigError
        If the data cannot be made.

    Examples
    --------
    >>> import hident as hi
    >>> found = checks(hi.DeadZone(low=-1, high=1))
    >>> str(found[-1])
    'dead_zone has the slope of its values'
    >>> for check in found:
    ...     check()

    With pytest, each is a test::

        @pytest.mark.parametrize("check", checks(Mine(lags=2)), ids=str)
        def test_what_it_owes(check):
            check()
    """
    cls = type(component)
    contracts: list[Contract] = [ClassContract(cls), ExampleContract(cls), SettingContract(component)]
    match component:
        case EstimatorSpec():
            own = made_data(data)
            contracts.append(
                EstimatorContract(component, own, _several(own, several), invariances, learns_from)
            )
        case MetricSpec():
            own = made_data(data)
            record = record_of(own)
            made = estimate(own, Job(estimator, ()), record, 1, 0) if estimator else of_truth(record.truth)
            contracts.append(MetricContract(component, made, record))
        case MemorySpec():
            contracts.append(MemoryContract(component))
        case NonlinearitySpec():
            contracts.append(NonlinearityContract(component))
        case SystemSpec():
            own = made_data({**(data or {}), "system": component})
            dt, n, rng = own.dt or 1.0, own.samples, np.random.default_rng(1)
            if component.follows_waveforms():
                contracts.append(WaveformContract(component, own.excitation.waveform(n, dt, rng), n, dt))
            else:
                contracts.append(SystemContract(component, own.excitation.sample(n, dt, rng), dt))
        case ExcitationSpec():
            own = made_data({**(data or {}), "excitation": component})
            contracts.append(ExcitationContract(component, own.samples, own.dt or 1.0))
        case NoiseSpec():
            own = made_data({**(data or {}), "noise": component})
            contracts.append(NoiseContract(component, own.before_noise(1, 0).y))
    return [check for contract in contracts for check in contract.checks()]


def check(component: Component, **options: Any) -> None:
    """Try everything that a component owes; the options are those of :func:`checks`.

    Raises
    ------
    AssertionError
        With a line for each check that fails.

    Examples
    --------
    >>> import hident as hi
    >>> check(hi.Power(exponent=2))
    """
    failed = []
    for one in checks(component, **options):
        try:
            one()
        except AssertionError as error:
            failed.append(f"{one}: {error}")
    if failed:
        raise AssertionError("\n".join(failed))


def _several(data: Data, excitation: ExcitationSpec | Mapping[str, Any] | None) -> Data:
    """Data with several experiments: of the given excitation, else that of the data, twice if it is one."""
    if excitation is None:
        own = data.excitation
        if len(own.stretches(data.samples, data.dt or 1.0)) == 1:
            written = canonical(own)
            names = ("first", "second")
            own = Experiments(
                parts=[{"name": name, "samples": data.samples, "excitation": written} for name in names]
            )
        excitation = own
    changed = made_data({**canonical(data), "excitation": excitation})
    stretches = changed.excitation.stretches(data.samples, data.dt or 1.0)
    return changed.model_copy(update={"samples": sum(stretch.samples for stretch in stretches)})
