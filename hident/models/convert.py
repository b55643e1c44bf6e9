"""A model as source code of other programs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from hident.config.suggest import there_is_no
from hident.errors import ConfigError
from hident.fitted_model import FittedModel
from hident.models.control_export import control_source
from hident.models.matlab_source import matlab_source
from hident.models.python_source import python_source, scipy_source
from hident.models.simulink_source import simulink_source


@dataclass(frozen=True)
class Target:
    """What a model is converted to: in words, the ending of its files, and how."""

    meaning: str
    suffix: str
    source: Callable[[FittedModel, str], str]


TARGETS: Mapping[str, Target] = {
    "python": Target("a Python function that needs numpy alone", ".py", lambda m, name: python_source(m)),
    "scipy": Target("systems and filters of scipy.signal", ".py", lambda m, name: scipy_source(m)),
    "control": Target("a system of python-control", ".py", lambda m, name: control_source(m)),
    "matlab": Target("a MATLAB function, which Octave runs too", ".m", matlab_source),
    "simulink": Target("a MATLAB function that builds a Simulink model", ".m", simulink_source),
}


def target(to: str) -> Target:
    """The target of this name; ConfigError with the nearest one if there is none."""
    if to not in TARGETS:
        raise ConfigError(there_is_no("target", to, TARGETS))
    return TARGETS[to]


def convert(model: FittedModel, to: str, name: str = "response") -> str:
    """The source of a program that gives the same response as the model.

    Parameters
    ----------
    model : FittedModel
        A model of :func:`load_model` or a fit.
    to : {"python", "scipy", "control", "matlab", "simulink"}
        What the source is for.
    name : str
        The name of the MATLAB function, which is that of its file.

    Raises
    ------
    ConfigError
        If there is no such target, or MATLAB allows no such name.

    Examples
    --------
    >>> import hident as hi
    >>> from hident.block_chain import BlockChain
    >>> model = hi.FittedModel(BlockChain((hi.TransferFunction(b=(0.5,), a=(0.5,)),)), start="rest")
    >>> print(hi.convert(model, "matlab", name="tank").splitlines()[0])
    function y = tank(u)
    """
    return target(to).source(model, name)
