"""The source of modules as this process has loaded them, which their files may hold no more.

Trials are stored under a hash of the code that computes them. A run goes on for hours, a notebook for days,
and meanwhile files are edited: the hash must be that of what is loaded, in this process and in every worker.
"""

from __future__ import annotations

import hashlib
import sys
from importlib.machinery import ModuleSpec
from pathlib import Path
from typing import Any

from hident.errors import ConfigError

_PACKAGE = "hident"
_LIBRARY_FOLDERS = {"site-packages", "dist-packages"}
# With each source the spec of its module: to load it again makes another one.
_SOURCES: dict[str, tuple[bytes, ModuleSpec | None]] = {}
_EXPECTED: dict[str, str] = {}
_RELOADED: list[str] = []


def note(module: str, source: bytes) -> None:
    """Remember with which source a module is being loaded.

    Raises
    ------
    ConfigError
        If that is not the expected one.
    """
    # Whoever loads a module again means the new one.
    if module in _SOURCES and _SOURCES[module][1] is not None:
        _forget(module)
    _check(module, source)
    _SOURCES[module] = source, _spec(module)


def note_loaded(package: str) -> None:
    """Remember the sources of a package's modules that are new here; of a plain module, also its neighbours'.

    ConfigError as in :func:`note`.
    """
    folder = _neighbourhood(package)
    for name in [*sys.modules]:
        own = name.partition(".")[0] == package
        if (own or folder) and not _is_known(name):
            file = _file(name)
            if file.endswith(".py") and (own or _is_in(Path(file), folder)):
                source_of(name, Path(file))


def source_of(module: str, path: Path) -> bytes:
    """The source of a module as it was loaded; of one that is not, its file's, which is expected then."""
    if not _is_known(module):
        note(module, path.read_bytes())
        if module not in sys.modules:
            expect({module: _digest(_SOURCES[module][0])})
    return _SOURCES[module][0]


def reloads() -> int:
    """How often it was met that a module which is not of this package was loaded again."""
    for name in [name for name in _SOURCES if name.partition(".")[0] != _PACKAGE and not _is_known(name)]:
        _forget(name)
    return len(_RELOADED)


def _forget(module: str) -> None:
    _RELOADED.append(module)
    del _SOURCES[module]
    _EXPECTED.pop(module, None)


def known() -> dict[str, str]:
    """Hashes of the sources of modules that are not of this package: what workers are told to expect."""
    return {name: _digest(of) for name, (of, _) in _SOURCES.items() if name.partition(".")[0] != _PACKAGE}


def expect(sources: dict[str, str]) -> None:
    """Let modules have no other sources than those with these hashes, now or when they are loaded.

    ConfigError if one has already.
    """
    _EXPECTED.update(sources)
    for name in sources.keys() & _SOURCES.keys():
        _check(name, _SOURCES[name][0])


def _check(module: str, source: bytes) -> None:
    of = _digest(source)
    if _EXPECTED.get(module, of) != of:
        raise ConfigError(
            f"{_file(module)} is not what the run began with: it was changed meanwhile. Run again; workers "
            "that stand and notebooks must be started anew"
        )


def _digest(source: bytes) -> str:
    return hashlib.sha256(source).hexdigest()[:16]


def _spec(module: str) -> ModuleSpec | None:
    return getattr(sys.modules.get(module), "__spec__", None)


def _is_known(module: str) -> bool:
    """Whether the source is known of the module that is loaded now."""
    return module in _SOURCES and (_SOURCES[module][1] is None or _SOURCES[module][1] is _spec(module))


def _file(module: str) -> str:
    file: Any = getattr(sys.modules.get(module), "__file__", None)
    return file if isinstance(file, str) else module


def _neighbourhood(package: str) -> Path | None:
    """The folder whose modules a plain module may import as its own; None for a package and a library."""
    found = sys.modules.get(package)
    if found is None or hasattr(found, "__path__") or not _file(package).endswith(".py"):
        return None
    folder = Path(_file(package)).parent
    return None if _LIBRARY_FOLDERS & {*folder.parts} or package in sys.stdlib_module_names else folder


def _is_in(file: Path, folder: Path | None) -> bool:
    return folder is not None and folder in file.parents and _LIBRARY_FOLDERS.isdisjoint(file.parts)
