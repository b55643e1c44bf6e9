"""Hashes that say whether a stored trial is still the one that would be computed now."""

from __future__ import annotations

import ast
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Set
from functools import cache
from importlib.machinery import PathFinder
from importlib.metadata import version
from importlib.util import resolve_name
from pathlib import Path
from types import ModuleType
from typing import Any

from hident import arithmetic, loaded_code, plugins
from hident.config.spec import Spec
from hident.engine.trial import digest

_LIBRARIES = ("numpy", "scipy", "finufft")
_PACKAGE = "hident"
_TRIAL = "hident.engine.trial"
# What shows results computes none.
_SHOWS = ("hident.reports", "hident.ledger")
_LIBRARY_FOLDERS = {"site-packages", "dist-packages"}
# The version, the reading of configurations, the wording of messages, signals: once the specs are made, no
# number depends on them.
_WORDS = {
    "hident",
    "hident.config.spec",
    "hident.config.load",
    "hident.config.suggest",
    "hident.errors",
    "hident.stopping",
}


@cache
def libraries() -> dict[str, str]:
    """The versions of the libraries that the results depend on, and the arithmetic that they use here."""
    return {name: version(name) for name in _LIBRARIES} | {"arithmetic": arithmetic.identity()}


def fingerprint(specs: Iterable[Spec]) -> str:
    """Hash of the code that a trial of these specs runs through, docstrings and comments left out.

    It covers the modules of the specs and of all specs inside them, the trial itself, and every module of
    this package, or of a plugin's own package or folder, that these import; so a changed algorithm reruns
    what used it, and nothing else. Tables and figures are left out, in the file of an estimator too, and so
    is what only they mention.
    """
    _forget_hashes(loaded_code.reloads())
    return _of_modules(frozenset(modules(specs)), shown=False)


def modules(specs: Iterable[Spec]) -> tuple[str, ...]:
    """The modules of the specs, of all specs inside them, and of the trial."""
    return tuple(sorted({_TRIAL, *(type(inner).__module__ for spec in specs for inner in _within(spec))}))


def without_source(specs: Iterable[Spec]) -> Iterator[Spec]:
    """Those of the specs, and of all inside them, whose class has no file: a hash cannot know its code."""
    return (inner for spec in specs for inner in _within(spec) if _path(type(inner).__module__) is None)


def code(named: Iterable[str]) -> str:
    """Hash of the code of loaded modules and of what they import, ever, of this package or their own."""
    _forget_hashes(loaded_code.reloads())
    return _of_modules(frozenset(named), shown=True)


@cache
def _forget_hashes(reloads: int) -> None:
    """Hash anew where a module was loaded again, as in a notebook: once for each number of reloads."""
    _of_modules.cache_clear()
    _of_module.cache_clear()


@cache
def _of_modules(modules: frozenset[str], *, shown: bool) -> str:
    packages = {_PACKAGE, *(module.partition(".")[0] for module in modules)}
    folders = {Path(folder).resolve() for package in packages for folder in _folders(package)}
    known: dict[str, str] = {}
    waiting = sorted(modules)
    while waiting:
        module = waiting.pop()
        if module not in known:
            known[module], imports = _of_module(module, shown=shown)
            names = (plugins.name_beside(name, module) for name in imports)
            waiting += [name for name in names if _is_own(name, packages, folders)]
    # Without the names: a plugin's holds its folder, and moving that changes no number.
    return digest(sorted(known.values()))


@cache
def _of_module(module: str, *, shown: bool) -> tuple[str, tuple[str, ...]]:
    """The hash of one module's code, and what it imports; ``shown``: whether tables and figures count."""
    path = _path(module)
    if path is None or (not shown and module.startswith(_SHOWS)):
        return "", ()
    source, loaded = loaded_code.source_of(module, path), sys.modules.get(module)
    try:
        tree = _code(source)
    except (SyntaxError, ValueError):  # Only a module that is not loaded yet can be broken.
        return digest(source.decode("latin-1")), ()
    statements = [single for statement in tree.body for single in _single(statement)]
    kept = statements if shown or loaded is None else _computing(statements, loaded)
    if not shown and len(kept) == len(statements):
        return _of_module(module, shown=True)
    is_package = _file_and_folders(module)[1] is not None
    package = getattr(loaded, "__package__", module if is_package else module.rpartition(".")[0]) or ""
    imports = set()
    for node in _statements(tree if shown else ast.Module(kept, [])):
        if isinstance(node, ast.Import):
            imports |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            try:
                name = resolve_name("." * node.level + (node.module or ""), package)
            except ImportError:
                continue
            imports |= {name, *(f"{name}.{alias.name}" for alias in node.names)}
    return digest([ast.dump(statement) for statement in kept]), tuple(sorted(imports - _WORDS))


@cache
def _code(source: bytes) -> ast.Module:
    """The syntax tree without docstrings."""
    tree = ast.parse(source)
    for node in _statements(tree):
        _strip_docstring(node)
    return tree


def _statements(tree: ast.AST) -> Iterator[ast.AST]:
    """The tree and what is in it down to single statements, of which no expression holds one."""
    waiting = [tree]
    while waiting:
        yield (node := waiting.pop())
        for part in ("body", "orelse", "finalbody", "handlers", "cases"):
            inner = getattr(node, part, None)
            # That of a lambda or a conditional expression is one.
            if isinstance(inner, list):
                waiting += inner


def _computing(statements: list[ast.stmt], loaded: ModuleType) -> list[ast.stmt]:
    """Top-level statements without tables and figures, and without what only these mention.

    A name that is imported and not mentioned counts as one that they mention, as it may have been theirs.
    """
    mentions = {s: _mentioned(s) for s in statements}
    left_out: list[ast.stmt] = [
        s for s in statements if isinstance(s, ast.ClassDef) and _shows(getattr(loaded, s.name, None))
    ]
    while True:
        kept = [statement for statement in statements if statement not in left_out]
        counts = Counter(name for statement in kept for name in mentions[statement])
        theirs = set[str]().union(*(mentions[statement] for statement in left_out))
        idle = {
            statement: names
            for statement in kept
            if (names := _bound(statement))
            and (isinstance(statement, ast.ImportFrom) or names & theirs)
            and all(counts[name] == (name in mentions[statement]) for name in names)
        }
        elsewhere = _mentioned_beside(loaded.__name__) if idle else set()
        idle_everywhere = [statement for statement, names in idle.items() if names.isdisjoint(elsewhere)]
        if not idle_everywhere:
            return kept
        left_out += idle_everywhere


def _single(statement: ast.stmt) -> list[ast.stmt]:
    """An import of several names as several imports; any other statement as it is."""
    match statement:
        case ast.Import(names=names):
            return [ast.Import([name]) for name in names]
        case ast.ImportFrom(module=module, names=names, level=level):
            return [ast.ImportFrom(module, [name], level) for name in names]
        case _:
            return [statement]


def _shows(value: Any) -> bool:
    """Whether it is the class of a table or a figure, or a base of such."""
    return isinstance(value, type) and any(base.__module__.startswith(_SHOWS) for base in value.__mro__)


def _bound(statement: ast.stmt) -> set[str]:
    """The names that a statement binds, if it may do nothing else: what is decorated may be registered."""
    match statement:
        case ast.FunctionDef(decorator_list=[], name=name) | ast.ClassDef(decorator_list=[], name=name):
            return {name}
        case ast.ImportFrom(module="__future__") | ast.ImportFrom(names=[ast.alias(name="*")]):
            return set()
        case ast.Import(names=[alias]) | ast.ImportFrom(names=[alias]):
            return {alias.asname or alias.name.partition(".")[0]}
        case ast.Assign(targets=[ast.Name(id=name)]) | ast.AnnAssign(target=ast.Name(id=name)):
            return {name}
        case _:
            return set()


def _mentioned(tree: ast.AST) -> set[str]:
    """Every name, attribute and text in the code."""
    found: set[str] = set()
    for node in ast.walk(tree):
        match node:
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.Constant(value=str(name)):
                found.add(name)
            case ast.alias(name=name):
                found |= {name, *name.split(".")}
    return found


def _mentioned_beside(module: str) -> set[str]:
    """What the other loaded modules of the same package mention."""
    package = module.partition(".")[0]
    others = [name for name in sys.modules if name.partition(".")[0] == package and name != module]
    found = ((name, path) for name in others if (path := _path(name)))
    return set().union(*(_mentioned_in(loaded_code.source_of(*of)) for of in found))


@cache
def _mentioned_in(source: bytes) -> set[str]:
    return _mentioned(_code(source))


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


def _folders(package: str) -> list[str]:
    """The folder of a package, or that of a module that is none."""
    path = _path(package)
    return list(_file_and_folders(package)[1] or ([str(path.parent)] if path else []))


def _path(module: str) -> Path | None:
    """The source file of a module, if it has one."""
    file = _file_and_folders(module)[0]
    return _resolved(file) if file is not None and file.endswith(".py") else None


@cache
def _resolved(file: str) -> Path:
    return Path(file).resolve()


def _file_and_folders(module: str) -> tuple[str | None, Iterable[str] | None]:
    """The file of a module, and where a package's own modules stand; it need not be loaded, and is not here.

    What a function imports is loaded when it is called, after the keys are made.
    """
    if (loaded := sys.modules.get(module)) is not None:
        return getattr(loaded, "__file__", None), getattr(loaded, "__path__", None)
    parent = module.rpartition(".")[0]
    folders = _file_and_folders(parent)[1] if parent else None
    if parent and folders is None:
        return None, None
    spec = PathFinder.find_spec(module, None if folders is None else list(folders))
    return (spec.origin, spec.submodule_search_locations) if spec else (None, None)


def _within(value: Any) -> Iterator[Spec]:
    if isinstance(value, Spec):
        yield value
        value = [getattr(value, name) for name in type(value).model_fields]
    if isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, list | tuple):
        for item in value:
            yield from _within(item)
