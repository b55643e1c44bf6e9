"""What a report of a fault needs to say about this installation, and what in it is unsound."""

from __future__ import annotations

import os
import platform
import sys
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, entry_points, version
from pathlib import Path
from typing import Literal

import hident
from hident import arithmetic, plugins
from hident.engine.cores import cpu_quota, usable_cores
from hident.engine.store import Store
from hident.errors import ConfigError, StoreBusy, StoreError

_LIBRARIES = (
    *("numpy", "scipy", "finufft", "pandas", "matplotlib", "pydantic", "pyyaml", "threadpoolctl"),
    *("filelock", "typer", "rich"),
)
# The beginnings of the names of variables that change what hident or its libraries do.
_VARIABLES = ("HIDENT_", "OPENBLAS_", "NPY_", "OMP_", "MKL_", "GLIBC_", "MPLCONFIG", "MATPLOTLIB", "TMPDIR")


@dataclass(frozen=True)
class Finding:
    """One line on one topic: a fact, a warning, or what is unsound."""

    topic: str
    text: str
    state: Literal["", "warning", "unsound"] = ""


def examine(store: Path, plugin_files: Iterable[Path]) -> Iterator[Finding]:
    """Everything that is found, topic by topic; ``store`` is the folder of the trials store."""
    yield Finding("hident", f"{hident.__version__} in {Path(hident.__file__).parent}")
    yield Finding("python", f"{platform.python_version()} in {sys.executable}")
    yield Finding("platform", platform.platform())
    yield from _libraries()
    yield from _arithmetic()
    yield from _cores()
    yield from _environment()
    yield from _plugins(plugin_files)
    yield from _store(store)
    yield from _matplotlib()


def _libraries() -> Iterator[Finding]:
    found = []
    for name in _LIBRARIES:
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            yield Finding("libraries", f"{name} is not installed", "unsound")
    yield Finding("libraries", ", ".join(found))


def _arithmetic() -> Iterator[Finding]:
    use = arithmetic.in_use()
    yield Finding("arithmetic", f"asked for: {use['asked']}; in use: {arithmetic.identity()}")
    if said := arithmetic.shortfall(use):
        yield Finding("arithmetic", said, "warning")
    threads = ", ".join(str(library["threads"]) for library in use["blas"]) or "unknown"
    yield Finding("threads", f"of BLAS: {threads}; one each while trials are computed")


def _cores() -> Iterator[Finding]:
    quota = cpu_quota()
    limit = "" if quota is None else f", limited to the time of {quota:g} by a control group"
    yield Finding("cores", f"{usable_cores()} usable of {os.cpu_count()}{limit}")


def _environment() -> Iterator[Finding]:
    found = [f"{name}={value}" for name, value in sorted(os.environ.items()) if name.startswith(_VARIABLES)]
    yield Finding("environment", ", ".join(found) or "nothing that counts is set")
    try:
        with tempfile.TemporaryFile():
            yield Finding("temporary files", tempfile.gettempdir())
    except OSError as error:
        yield Finding("temporary files", f"cannot be written: {error}", "unsound")


def _plugins(files: Iterable[Path]) -> Iterator[Finding]:
    installed = [f"{entry.name} ({entry.value})" for entry in entry_points(group=plugins.GROUP)]
    yield Finding("plugins", ", ".join([*installed, *map(str, files)]) or "none")
    try:
        plugins.load(files)
    except ConfigError as error:
        for line in str(error).splitlines():
            yield Finding("plugins", line, "unsound")


def _store(folder: Path) -> Iterator[Finding]:
    store = Store(folder)
    if not store.path.exists():
        yield Finding("store", f"none yet at {store.path}")
        return
    try:
        size = store.path.stat().st_size
        store.check()
        with store.reading() as reader:
            found = f"{store.path}: {reader.count()} scores, {size / 1e6:.1f} MB, sound"
        yield Finding("store", found)
    except StoreBusy:
        yield Finding("store", f"{store.path}: in use by another run, so not examined", "warning")
    except StoreError as error:
        yield Finding("store", str(error), "unsound")


def _matplotlib() -> Iterator[Finding]:
    try:
        import matplotlib as mpl

        yield Finding("matplotlib", f"settings in {mpl.matplotlib_fname()}, which no figure uses")
        yield Finding("matplotlib", f"cache in {mpl.get_cachedir()}")
    except Exception as error:
        # Such as a file of settings that is no text.
        yield Finding("matplotlib", f"cannot be loaded: {type(error).__name__}: {error}", "unsound")
