"""Planted changes: what a comparison finds of one constant in the code that is off by 0.1 %.

Each plant replaces one expression in one function, computes a few trials of a small configuration, and
compares them with the accepted ones, trial by trial, as ``hident compare --partial`` does. The data have the
random numbers of the accepted trials, since seeds hash the configuration and not the code.

``python -m tests.planted_changes [--foreign]`` prints what is found, a line each.
"""

from __future__ import annotations

import argparse
import functools
import importlib
import inspect
import subprocess
import sys
import textwrap
import types
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.accepted import RESULTS, ROOT, differences
from tests.arithmetics import ARITHMETICS, Arithmetic

TRIALS_RUN = 3
FOREIGN = Arithmetic(
    "foreign", {**ARITHMETICS["nehalem"].settings, **ARITHMETICS["no-avx2"].settings}, frozenset()
)
"""No kernel and no loop of the accepted results."""


@dataclass(frozen=True)
class Plant:
    """A change of code: ``old``, which stands once in the function ``target``, becomes ``new``."""

    config: str
    target: str
    """``module:attribute.path`` below ``hident.``"""
    old: str
    new: str

    def __str__(self) -> str:
        return f"{self.config}: {self.target}: {self.old} -> {self.new}"

    @contextmanager
    def planted(self) -> Iterator[None]:
        """The change, while the context lasts; nothing remembers what was computed before or in it."""
        function = _function(self.target)
        sound = function.__code__
        function.__code__ = _changed(function, self.old, self.new)
        try:
            _forget()
            yield
        finally:
            function.__code__ = sound
            _forget()


_HORIZONS = "estimators.moving_horizon"
_BILINEAR = "estimators.bilinear_models"
_FREQUENCY = "estimators.frequency"
_NONPARAMETRIC = "estimators.nonparametric"

PLANTS = (
    # Mzyk: system, noise, input, kernel, series, prefilter, metric
    Plant("mzyk_table1", "systems.nonlinearity:Mzyk2009.__call__", "2.0 * np.sin", "2.002 * np.sin"),
    Plant("mzyk_table1", "systems.nonlinearity:Mzyk2009.__call__", "- np.pi", "- 1.001 * np.pi"),
    Plant("mzyk_table1", "systems.linear:Ar.transfer_function", "a=self.a", "a=(1.001 * self.a[0],)"),
    Plant("mzyk_table1", "signals.noise:White._std", "self.half_width /", "1.001 * self.half_width /"),
    Plant("mzyk_table1", f"{_NONPARAMETRIC}.kernel:Bandwidth.width", "self.h0 *", "1.001 * self.h0 *"),
    Plant(
        "mzyk_table1",
        f"{_NONPARAMETRIC}.instrumental_variables:instrumental_variables",
        "a, constant = theta[:p]",
        "a, constant = 1.001 * theta[:p]",
    ),
    # Wang: system, noises, normalisation, weighting, loss
    Plant(
        "wang_table1",
        "systems.nonlinearity:Polynomial.__call__",
        "polyval(u, self",
        "polyval(1.001 * u, self",
    ),
    Plant("wang_table1", "signals.noise:_Additive._std", "return self.std", "return 1.001 * self.std"),
    Plant("wang_table1", f"{_BILINEAR}.bilinear:normalised", "sign * length *", "sign * 1.001 * length *"),
    Plant("wang_table1", f"{_BILINEAR}.bilinear:loss", "weighted**2", "1.001 * weighted**2"),
    Plant("wang_table2", "numerics.autoregression:ArModel._whitened", "-= a *", "-= 1.001 * a *"),
    Plant("wang_table2", "signals.noise:Autoregressive._unit", "a=self.a", "a=(1.001 * self.a[0],)"),
    # Chen, Hammerstein: systems, input, noise, transforms, iteration, errors; and Voros
    Plant("chen_fig5", "systems.nonlinearity:_wigren", "0.9 *", "0.9009 *"),
    Plant("chen_fig4", "systems.nonlinearity:_soft_dead_zone", "0.7 *", "0.7007 *"),
    Plant("chen_fig5", "signals.noise:_Additive._std", "return self.nsr *", "return 1.001 * self.nsr *"),
    Plant("chen_fig5", "linear_blocks:ContinuousTransferFunction._held", "(dt /", "(1.001 * dt /"),
    Plant("chen_fig5", "signals.excitation:Multistep._levels", "levels = self", "levels = 1.001 * self"),
    Plant(
        "chen_fig5", f"{_HORIZONS}.transform.time_weighted:_weight_derivative", "0.0, -1.0]", "0.0, -1.001]"
    ),
    Plant("chen_fig5", f"{_HORIZONS}.hammerstein.iteration:iterate", "z - np.ein", "z - 1.001 * np.ein"),
    Plant("chen_fig5", "estimators.voros.voros_hammerstein:iterate", "+ rule.relax", "+ 1.001 * rule.relax"),
    Plant(
        "chen_coverage",
        f"{_HORIZONS}.transform.sandwich:standard_errors",
        "derivative *",
        "1.001 * derivative *",
    ),
    Plant(
        "chen_vif",
        f"{_HORIZONS}.iterative:IterativeSpec._second_horizon",
        "self.share *",
        "1.001 * self.share *",
    ),
    Plant("chen_example5", "systems.processes:VanDeVusse._advance", "- k_3 *", "- 1.001 * k_3 *"),
    # Chen, Wiener: the weight of (29), slopes, the process of the pH, Voros
    Plant(
        "chen_fig8",
        f"{_HORIZONS}.wiener.iteration:FourSegments.updated",
        "weight * forward",
        "1.001 * weight * forward",
    ),
    Plant("chen_fig8", f"{_HORIZONS}.wiener.four_segment:forward", "/ e[2]", "/ (1.001 * e[2])"),
    Plant("chen_example3", "systems.processes:PhNeutralisation._balance", "2.0 * sec", "2.002 * sec"),
    Plant("chen_example3", "systems.processes:PhNeutralisation._advance", "valve *", "1.001 * valve *"),
    # Brouri: system, inputs, averages, harmonic map, levels, phases, variances
    Plant("brouri_gains", "systems.nonlinearity:Exponential.__call__", "self.rate *", "1.001 * self.rate *"),
    Plant(
        "brouri_gains",
        "linear_blocks:ContinuousTransferFunction.frequency_response",
        "s = 1j *",
        "s = 1.001j *",
    ),
    Plant("brouri_gains", "signals.excitation:Sine.waveform", "-1j *", "-1.001j *"),
    Plant("brouri_gains", f"{_FREQUENCY}.harmonics:_by_averaging", "2.0 / n *", "2.002 / n *"),
    Plant("brouri_gains", f"{_FREQUENCY}.harmonic_map:powers_in_chebyshev", "= comb(", "= 1.001 * comb("),
    Plant(
        "brouri_nonlinearity",
        f"{_FREQUENCY}.staircase_levels:settled_levels",
        "for part in (discard,",
        "for part in (0.999 * discard,",
    ),
    Plant(
        "brouri_nonlinearity",
        "systems.continuous_wiener_hammerstein:_state_space",
        "into[-1] = -a[:n] / a[n], 1.0",
        "into[-1] = -a[:n] / a[n], 1.001",
    ),
    Plant(
        "brouri_bla",
        f"{_FREQUENCY}.best_linear_approximation:best_linear_approximation",
        "/ (periods *",
        "/ (1.001 * periods *",
    ),
)
CONFIGS = tuple(dict.fromkeys(plant.config for plant in PLANTS))


def found(config: str, results: Path = RESULTS) -> list[str]:
    """What a few trials of a configuration, run now, differ in, a text each."""
    return differences(config, TRIALS_RUN, results)


def _function(target: str) -> types.FunctionType:
    module, _, path = target.partition(":")
    value: Any = importlib.import_module(f"hident.{module}")
    for name in path.split("."):
        value = inspect.getattr_static(value, name)
    if isinstance(value, classmethod | staticmethod):
        value = value.__func__
    elif isinstance(value, property):
        value = value.fget
    elif isinstance(value, functools.cached_property):
        value = value.func
    function = inspect.unwrap(value)
    assert isinstance(function, types.FunctionType)
    return function


def _changed(function: types.FunctionType, old: str, new: str) -> types.CodeType:
    source = textwrap.dedent(inspect.getsource(function))
    assert source.count(old) == 1, f"'{old}' stands {source.count(old)} times in {function.__qualname__}"
    source = source.replace(old, new)
    # A function that names super() closes over its class.
    free = function.__code__.co_freevars
    if free:
        inner = textwrap.indent(source, "    ")
        source = f"def around({', '.join(free)}):\n{inner}"
    file, flags = inspect.getfile(function), annotations.compiler_flag
    code: types.CodeType = compile(source, file, "exec", flags, dont_inherit=True)
    for name in (["around"] if free else []) + [function.__name__]:
        code = next(c for c in code.co_consts if isinstance(c, types.CodeType) and c.co_name == name)
    return code


def _forget() -> None:
    """Empty the caches of hident's functions, but for what tells its code and its libraries."""
    for name, module in [*sys.modules.items()]:
        if name.startswith("hident.") and not name.startswith(("hident.engine", "hident.config")):
            for value in vars(module).values():
                if callable(getattr(value, "cache_clear", None)):
                    value.cache_clear()


def main(arguments: Sequence[str] | None = None) -> int:
    """Print what is found of each plant, and of none; 1 if a plant is not found or something else is."""
    parser = argparse.ArgumentParser(prog="python -m tests.planted_changes", description=__doc__)
    parser.add_argument("configs", nargs="*", metavar="CONFIG", help="these (default: all)")
    parser.add_argument("--foreign", action="store_true", help="compute with other kernels than the accepted")
    parser.add_argument("--results", type=Path, default=RESULTS, help="the accepted results")
    given = parser.parse_args(arguments)
    configs = given.configs or CONFIGS
    if unknown := {*configs} - {*CONFIGS}:
        parser.error(f"no change is planted in {', '.join(sorted(unknown))}")
    if given.foreign:
        return _again_elsewhere([*configs, "--results", str(given.results)])
    wrong = 0
    for config in configs:
        lines = found(config, given.results)
        print(f"{'differs' if lines else 'equal'}: {config} as it is", *lines, sep="\n    ", flush=True)
        wrong += bool(lines)
    for plant in PLANTS:
        if plant.config in configs:
            with plant.planted():
                lines = found(plant.config, given.results)
            print(f"{'found' if lines else 'missed'}: {plant}: {len(lines)} estimates", flush=True)
            wrong += not lines
    return 1 if wrong else 0


def _again_elsewhere(arguments: list[str]) -> int:
    """The same in a process of another arithmetic."""
    if why := FOREIGN.hindrance():
        print(f"the other arithmetic cannot be had here: {why}", flush=True)
        return 0
    command = [sys.executable, "-m", "tests.planted_changes", *arguments]
    return subprocess.run(command, cwd=ROOT, env=FOREIGN.environment, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
