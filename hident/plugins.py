"""Loading components: the built-in ones, installed plugins, and files named on the command line."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import pkgutil
import sys
from collections.abc import Iterable
from importlib.metadata import entry_points
from pathlib import Path

from hident.errors import ConfigError

GROUP = "hident.plugins"
_ROOMS = ("signals", "systems", "estimators", "metrics", "reports")


def load(files: Iterable[Path] = ()) -> None:
    """Import every built-in component, every installed plugin and the given plugin files.

    Raises
    ------
    ConfigError
        If a plugin cannot be imported; the message names it and the reason.
    """
    for room in _ROOMS:
        package = importlib.import_module(f"hident.{room}")
        for module in pkgutil.iter_modules(package.__path__):
            importlib.import_module(f"hident.{room}.{module.name}")
    for entry in entry_points(group=GROUP):
        _guarded(f"plugin '{entry.name}' ({entry.value})", entry.load)
    for path in files:
        _guarded(f"plugin {path}", lambda path=path: _load_file(path))


def _guarded(name: str, action: object) -> None:
    try:
        action()  # type: ignore[operator]
    except ConfigError:
        raise
    except Exception as error:
        raise ConfigError(f"{name} cannot be loaded: {type(error).__name__}: {error}") from error


def _load_file(path: Path) -> None:
    path = path.resolve()
    if not path.is_file():
        raise ConfigError(f"plugin {path}: no such file")
    # The folder is part of the name, so that two plugins of one file name can be loaded together.
    name = f"hident_plugin_{path.stem}_{hashlib.sha256(str(path).encode()).hexdigest()[:8]}"
    if name in sys.modules:
        return
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ConfigError(f"plugin {path}: is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
