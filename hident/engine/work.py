"""What a worker is sent, and what it must have in common with the process that stores its trials."""

from __future__ import annotations

import gc
import importlib
import os
import pickle
import platform
import socket
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import hident
from hident import loaded_code, plugins
from hident.engine.chunks import timed
from hident.engine.experiment import Plan
from hident.engine.fingerprint import code, libraries, modules
from hident.engine.trial import Outcome
from hident.errors import ConfigError


class Done(NamedTuple):
    """What a chunk gave, the seconds that it took, and where it was computed."""

    outcomes: list[Outcome]
    seconds: float
    worker: str
    arithmetic: str


def compute(*chunk: Any) -> Done:
    """Run the trials of a chunk: see :func:`timed`."""
    return Done(*timed(*chunk), this_process(), libraries()["arithmetic"])


@cache
def this_process() -> str:
    """The name of this process among those of all machines."""
    return f"{socket.gethostname()}, process {os.getpid()}"


@cache
def pin_blas() -> None:
    """Hold all BLAS libraries of this process to one thread."""
    import scipy.linalg  # noqa: F401  (its BLAS must be loaded to be held)
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)


@dataclass(frozen=True)
class Terms:
    """What a worker must have, be it there from the start or join later: each of its processes looks once."""

    plugins: tuple[Path, ...]
    arithmetic: str
    modules: tuple[str, ...] = ()
    """Those whose code is compared, with what they import."""
    has: tuple[tuple[str, str], ...] = ()
    """What this process has; empty for processes on this machine, which have the same files."""
    sources: tuple[tuple[str, str], ...] = ()
    """Which sources of plugins this process has loaded: their files may change before a worker reads them."""

    @classmethod
    def here(cls, plugin_files: Iterable[Path]) -> Terms:
        """Of processes on this machine."""
        sources = tuple(sorted(loaded_code.known().items()))
        return cls(tuple(plugin_files), libraries()["arithmetic"], sources=sources)

    @classmethod
    def anywhere(cls, plugin_files: Iterable[Path], plans: Iterable[Plan]) -> Terms:
        """Of processes on any machines, which compute trials of the plans."""
        units = [unit for plan in plans for unit in plan.units]
        named = modules(spec for u in units for spec in (u.data, u.estimator, *u.metrics.values()))
        files = tuple(path.resolve() for path in plugin_files)
        return cls(files, libraries()["arithmetic"], named, _has(named, files))

    def met(self) -> str:
        """The arithmetic of this process, if it has what it must.

        Raises
        ------
        ConfigError
            With what it has otherwise.
        """
        return _met(self)


class Call:
    """A call that may be pickled: then it is unpickled within the call, where the terms are met.

    An error in unpickling is an exception of the call, where a pool would lose its workers; and plugins are
    loaded before a class of theirs is looked for.
    """

    def __init__(self, terms: Terms, fn: Callable[..., Any], *args: Any, **kwargs: Any) -> None:
        self._terms, self._call = terms, (fn, args, kwargs)

    def __call__(self) -> Any:
        fn, args, kwargs = self._call
        return fn(*args, **kwargs)

    def __reduce__(self) -> tuple[Any, ...]:
        return _Pickled, (self._terms, _pickled(self._call))


@dataclass(frozen=True)
class _Pickled:
    terms: Terms
    call: bytes

    def __call__(self) -> Any:
        self.terms.met()
        fn, args, kwargs = pickle.loads(self.call)
        return fn(*args, **kwargs)


def _pickled(call: object) -> bytes:
    try:
        return pickle.dumps(call)
    except Exception as error:
        raise ConfigError(
            f"a component cannot be sent to worker processes ({error}): define its class at the top "
            "level of its module, or run with --jobs 1"
        ) from None


@cache
def _met(terms: Terms) -> str:
    loaded_code.expect(dict(terms.sources))
    if terms.has:
        _meet(terms)
    else:
        plugins.load(terms.plugins)
    pin_blas()
    own = libraries()["arithmetic"]
    if own != terms.arithmetic and not terms.has:
        raise ConfigError(
            "worker processes compute with another arithmetic than this process, so that last digits would "
            f"differ within one result: '{own}' there, '{terms.arithmetic}' here. Import hident before "
            "numpy, or run with --jobs 1"
        )
    # What is loaded stays: the garbage collector need not look through it again and again beside the trials.
    gc.collect()
    gc.freeze()
    return own


def _meet(terms: Terms) -> None:
    name = f"the worker on {this_process()}"
    try:
        plugins.load(terms.plugins)
    except ConfigError as error:
        raise ConfigError(
            f"{name} cannot load what this process has loaded: {error}. A plugin must stand at the same path "
            "on every machine, or be installed there"
        ) from None
    own = dict(_has(terms.modules, terms.plugins))
    differing = [f"{what}: {own[what]} there, {here} here" for what, here in terms.has if own[what] != here]
    if differing:
        raise ConfigError(
            f"{name} differs from this process: {'; '.join(differing)}. Install the same there, and start it "
            "anew"
        )


def _has(named: Iterable[str], plugin_files: Iterable[Path]) -> tuple[tuple[str, str], ...]:
    """What numbers and their keys depend on here, besides the arithmetic."""
    versions = {name: version for name, version in libraries().items() if name != "arithmetic"}
    packages: dict[str, list[str]] = {}
    for module in named:
        packages.setdefault(module.partition(".")[0], []).append(module)
    folders = {plugins.package_of(path.parent): path.parent for path in plugin_files}
    return (
        ("hident", hident.__version__),
        # Its syntax trees are those of the minor version.
        ("Python", ".".join(platform.python_version_tuple()[:2])),
        *versions.items(),
        *((f"code of {folders.get(name, name)}", _code(those)) for name, those in packages.items()),
    )


def _code(named: Iterable[str]) -> str:
    try:
        return code(module.__name__ for module in map(importlib.import_module, named))[:12]
    except ImportError as error:
        return f"none ({error})"
