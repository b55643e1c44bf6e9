"""Loading components: the built-in ones, installed plugins, and files named on the command line.

The folder of a plugin file serves as a package of its own name, whose modules import their neighbours as if
the folder were importable: ``import helper`` there gives ``hident_plugin_<hash>.helper``. So two plugins may
each have a ``helper.py``, worker processes find the classes in it, and no other import sees the folder.
"""

from __future__ import annotations

import builtins
import hashlib
import importlib
import importlib.util
import pkgutil
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from importlib.metadata import entry_points
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

from hident import loaded_code
from hident.errors import ConfigError

GROUP = "hident.plugins"
_PACKAGE = "hident_plugin_"
ROOMS = ("signals", "systems", "estimators", "metrics", "reports")


def load(files: Iterable[Path] = ()) -> None:
    """Import every built-in component, every installed plugin and the given plugin files.

    ConfigError if plugins cannot be imported; the message names each and its reason.
    """
    load_built_in()
    problems = [
        *(_tried(f"plugin '{e.name}' ({e.value})", e.load) for e in entry_points(group=GROUP)),
        *(_tried(f"plugin {path}", partial(_load_file, path)) for path in files),
    ]
    if any(problems):
        raise ConfigError("\n".join(filter(None, problems)))


def load_built_in() -> None:
    """Import every built-in component, so that each can be named by its kind."""
    for module in built_in():
        importlib.import_module(module)
    loaded_code.note_loaded("hident")


def built_in() -> Iterator[str]:
    """The names of the modules that hold the built-in components."""
    for room in ROOMS:
        package = importlib.import_module(f"hident.{room}")
        yield from (module.name for module in pkgutil.walk_packages(package.__path__, f"hident.{room}."))


def _tried(name: str, action: Callable[[], object]) -> str:
    """What went wrong, or an empty string."""
    try:
        action()
    except ConfigError as error:
        return f"{name}: {error}"
    except (Exception, SystemExit) as error:
        return f"{name} cannot be loaded: {type(error).__name__}: {error}"
    return ""


def name_beside(name: str, importer: str) -> str:
    """The full name of what the module ``importer`` imports as ``name``, now or when it is called."""
    package = importer.partition(".")[0]
    if package.startswith(_PACKAGE) and _is_beside(name.partition(".")[0], package):
        return f"{package}.{name}"
    return name


def _load_file(path: Path) -> None:
    path = path.resolve()
    if not path.is_file():
        raise ConfigError("no such file")
    package = package_of(path.parent)
    name = f"{package}.{path.stem}"
    if name in sys.modules:
        return
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None:
        raise ConfigError("is not a Python file")
    before = set(sys.modules)
    try:
        _executed(_with_neighbours(spec))
    except BaseException:
        # It is tried again, and so is what it imported.
        for new in {*sys.modules} - before:
            if new.startswith(f"{package}."):
                del sys.modules[new]
        raise


def is_from_file(module: str) -> bool:
    """Whether a module is that of a plugin file, by its name, and no installed one."""
    return module.startswith(_PACKAGE)


def package_of(folder: Path) -> str:
    """The name of the package that a folder of plugin files serves as."""
    name = f"{_PACKAGE}{hashlib.sha256(str(folder).encode()).hexdigest()[:8]}"
    if name not in sys.modules:
        package = ModuleType(name, "The folder of plugin files.")
        package.__path__ = [str(folder)]
        sys.modules[name] = package
        if not any(isinstance(finder, _Neighbours) for finder in sys.meta_path):
            sys.meta_path.insert(0, _Neighbours())
    return name


def _executed(spec: ModuleSpec) -> None:
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    assert spec.loader is not None
    spec.loader.exec_module(module)


class _Neighbours(MetaPathFinder):
    """Finds the modules in the folders of plugin files."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if not fullname.startswith(_PACKAGE):
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        return spec and _with_neighbours(spec)


class _Loader(SourceFileLoader):
    """Loads a module whose import statements look beside its plugin first."""

    def get_code(self, fullname: str) -> CodeType:
        """The code of the source as it is now.

        Stored bytecode is told from stale by the time and the size of the source, which a quick edit may
        keep; and results are stored under a hash of the source.
        """
        path = self.get_filename(fullname)
        source = self.get_data(path)
        loaded_code.note(fullname, source)
        return self.source_to_code(source, path)

    def exec_module(self, module: ModuleType) -> None:
        package = module.__name__.partition(".")[0]
        module.__dict__["__builtins__"] = {**vars(builtins), "__import__": partial(_import, package)}
        super().exec_module(module)


def _with_neighbours(spec: ModuleSpec) -> ModuleSpec:
    if isinstance(spec.loader, SourceFileLoader):
        spec.loader = _Loader(spec.loader.name, spec.loader.path)
    return spec


def _import(
    package: str,
    name: str,
    globals: Mapping[str, Any] | None = None,  # noqa: A002
    locals: Mapping[str, Any] | None = None,  # noqa: A002
    fromlist: Sequence[str] | None = (),
    level: int = 0,
) -> ModuleType:
    """``__import__`` in a module of a plugin's folder."""
    top = name.partition(".")[0]
    if level or not _is_beside(top, package):
        return builtins.__import__(name, globals, locals, fromlist, level)
    beside = builtins.__import__(f"{package}.{name}", globals, locals, fromlist, 0)
    return beside if fromlist else sys.modules[f"{package}.{top}"]


def _is_beside(top: str, package: str) -> bool:
    """Whether a plugin means the module in its folder; not if everybody imports that very file."""
    if f"{package}.{top}" in sys.modules:
        return True
    if top == "hident" or top in sys.stdlib_module_names:
        return False
    here = PathFinder.find_spec(top, list(sys.modules[package].__path__))
    there = getattr(sys.modules[top], "__spec__", None) if top in sys.modules else PathFinder.find_spec(top)
    if here is None or there is None:
        return here is not None
    # A folder without __init__.py gives way to any module, as ever.
    return here.origin is not None and _file(here) != _file(there)


def _file(spec: ModuleSpec) -> Path:
    return Path(spec.origin or "").resolve()
