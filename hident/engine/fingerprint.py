"""Hashes that say whether a stored trial is still the one that would be computed now."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterable, Iterator, Mapping, Set
from functools import cache
from importlib.metadata import version
from importlib.util import resolve_name
from pathlib import Path
from typing import Any

from hident import arithmetic
from hident.config.spec import Spec
from hident.engine.trial import digest

_LIBRARIES = ("numpy", "scipy", "finufft")
_PACKAGE = "hident"
_TRIAL = "hident.engine.trial"
_LIBRARY_FOLDERS = {"site-packages", "dist-packages"}
# The version, the reading of configurations, the wording of messages: once the specs are made, no number
# depends on them.
_WORDS = {"hident", "hident.config.spec", "hident.config.load", "hident.config.suggest", "hident.errors"}


@cache
def libraries() -> dict[str, str]:
    """The versions of the libraries that the results depend on, and the arithmetic that they use here."""
    return {name: version(name) for name in _LIBRARIES} | {"arithmetic": arithmetic.identity()}


def fingerprint(specs: Iterable[Spec]) -> str:
    """Hash of the code that a trial of these specs runs through, docstrings and comments left out.

    It covers the modules of the specs and of all specs inside them, the trial itself, and every module of
    this package, or of a plugin's own package or folder, that these import; so a changed algorithm reruns
    what used it, and nothing else.
    """
    return code({_TRIAL, *(type(inner).__module__ for spec in specs for inner in _within(spec))})


def code(modules: Iterable[str]) -> str:
    """Hash of the code of loaded modules and of what they import of this package or their own."""
    return _of_modules(frozenset(modules))


@cache
def _of_modules(modules: frozenset[str]) -> str:
    packages = {_PACKAGE, *(module.partition(".")[0] for module in modules)}
    folders = {path.parent for path in map(_path, packages) if path}
    known: dict[str, str] = {}
    waiting = sorted(modules)
    while waiting:
        module = waiting.pop()
        if module not in known:
            known[module], imports = _of_module(module)
            waiting += [name for name in imports if _is_own(name, packages, folders)]
    # Without the names: a plugin's holds its folder, and moving that changes no number.
    return digest(sorted(known.values()))


@cache
def _of_module(module: str) -> tuple[str, tuple[str, ...]]:
    """The hash of one module's code, and what it imports."""
    path = _path(module)
    if path is None:
        return "", ()
    tree = ast.parse(path.read_bytes())
    package = sys.modules[module].__package__ or ""
    imports = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            imports |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            name = resolve_name("." * node.level + (node.module or ""), package)
            imports |= {name, *(f"{name}.{alias.name}" for alias in node.names)}
        _strip_docstring(node)
    return digest(ast.dump(tree)), tuple(sorted(imports - _WORDS))


def _is_own(module: str, packages: Set[str], folders: Set[Path]) -> bool:
    """Whether a module belongs to the packages, or lies in the folders and is no library."""
    path, package = _path(module), module.partition(".")[0]
    if path is None or package in packages:
        return path is not None
    # A folder may hold a whole Python installation.
    if package in sys.stdlib_module_names or not _LIBRARY_FOLDERS.isdisjoint(path.parts):
        return False
    return not folders.isdisjoint(path.parents)


def _strip_docstring(node: ast.AST) -> None:
    body = getattr(node, "body", None)
    if isinstance(body, list):
        # A bare string states a meaning and computes nothing: docstrings, and those under fields.
        node.body = [  # type: ignore[attr-defined]
            statement
            for statement in body
            if not (
                isinstance(statement, ast.Expr)
                and isinstance(statement.value, ast.Constant)
                and isinstance(statement.value.value, str)
            )
        ]


def _path(module: str) -> Path | None:
    """The source file of a loaded module, if it has one."""
    file = getattr(sys.modules.get(module), "__file__", None)
    return Path(file).resolve() if file is not None and file.endswith(".py") else None


def _within(value: Any) -> Iterator[Spec]:
    if isinstance(value, Spec):
        yield value
        value = [getattr(value, name) for name in type(value).model_fields]
    if isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, list | tuple):
        for item in value:
            yield from _within(item)
