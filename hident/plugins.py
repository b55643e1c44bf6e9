"""Loading components: the built-in ones, installed plugins, and files named on the command line."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import pkgutil
import sys
from collections.abc import Callable, Iterable
from functools import partial
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
        If plugins cannot be imported; the message names each and its reason.
    """
    for room in _ROOMS:
        package = importlib.import_module(f"hident.{room}")
        for module in pkgutil.walk_packages(package.__path__, f"hident.{room}."):
            importlib.import_module(module.name)
    problems = [
        *(_tried(f"plugin '{e.name}' ({e.value})", e.load) for e in entry_points(group=GROUP)),
        *(_tried(f"plugin {path}", partial(_load_file, path)) for path in files),
    ]
    if any(problems):
        raise ConfigError("\n".join(filter(None, problems)))


def _tried(name: str, action: Callable[[], object]) -> str:
    """What went wrong, or an empty string."""
    try:
        action()
    except ConfigError as error:
        return f"{name}: {error}"
    except (Exception, SystemExit) as error:
        return f"{name} cannot be loaded: {type(error).__name__}: {error}"
    return ""


def _load_file(path: Path) -> None:
    path = path.resolve()
    if not path.is_file():
        raise ConfigError("no such file")
    # The folder is part of the name, so that two plugins of one file name can be loaded together.
    name = f"hident_plugin_{path.stem}_{hashlib.sha256(str(path).encode()).hexdigest()[:8]}"
    if name in sys.modules:
        return
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ConfigError("is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
