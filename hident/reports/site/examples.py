"""A component as a configuration writes it, by the example in its docstring or by a configuration."""

from __future__ import annotations

import ast
import doctest
import inspect
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import hident
from hident.config.spec import PLURALS, Component, components
from hident.errors import ConfigError

_PLACES: Mapping[str, tuple[str, ...]] = {
    "estimator": ("estimators", "my estimator"),
    "metric": ("metrics", "my metric"),
    "table": ("tables", "my_table"),
    "figure": ("figures", "my_figure"),
    "system": ("system",),
    "excitation": ("excitation",),
    "noise": ("noise",),
    "streams": ("streams",),
}
"""Where a component of each family stands in a configuration; others stand inside of these."""
_INSIDE = {"block": "blocks"}
_IMPORTS = {"math": "import math", "np": "import numpy as np"}


def in_python(cls: type[Component]) -> str:
    """The example in the docstring of the class, as typed at a prompt; empty if there is none.

    It begins with the imports that the module of the class makes for it.
    """
    example = _example(cls)
    used = {node.id for node in _nodes(example) if isinstance(node, ast.Name)}
    public = sorted(used & {*hident.__all__})
    imports = [line for name, line in _IMPORTS.items() if name in used]
    imports += [f"from hident import {', '.join(public)}"] if public else []
    return "\n".join([*(f">>> {line}" for line in imports), example]).strip("\n")


def _example(cls: type[Component]) -> str:
    _, _, example = inspect.cleandoc(cls.__doc__ or "").partition("\n\nExamples\n")
    return example.partition("\n")[2].strip("\n")


def _nodes(example: str) -> Iterator[ast.AST]:
    for one in doctest.DocTestParser().get_examples(example):
        yield from ast.walk(ast.parse(one.source))


def written(cls: type[Component], in_use: Iterable[Mapping[str, Any]] = ()) -> Mapping[str, Any] | None:
    """The fields of a component that works, as a file holds them.

    Those of the first one in the docstring's example; else the shortest of those that are ``in_use``; else
    none at all, if the component needs none. None if there is no such.
    """
    shortest = sorted(in_use, key=lambda fields: len(str(fields)))
    for fields in (*_in_docstring(cls), *shortest, {}):
        try:
            cls(**fields)
        except ConfigError:
            continue
        return fields
    return None


def as_yaml(cls: type[Component], fields: Mapping[str, Any]) -> str:
    """A component in its place in a configuration.

    Examples
    --------
    >>> from hident.systems.linear import Ar
    >>> print(as_yaml(Ar, {"a": [0.5]}), end="")
    linear:
      kind: ar
      a: [0.5]
    """
    place = _PLACES.get(cls.family, (_INSIDE.get(cls.family, cls.family),))
    lines = [f"{'  ' * depth}{key}:" for depth, key in enumerate(place)]
    is_list = place[-1] in ("noise", "blocks")
    for number, (key, value) in enumerate({"kind": cls.kind, **fields}.items()):
        mark = ("- " if number == 0 else "  ") if is_list else "  " * len(place)
        lines += [
            f"{mark if i == 0 or not is_list else '  '}{line}" for i, line in enumerate(_lines(key, value))
        ]
    return "\n".join(lines) + "\n"


def _lines(key: str, value: Any) -> list[str]:
    """A key with its value; mappings and lists of plain values in one line."""
    import yaml

    style = None if isinstance(value, Mapping | list | tuple) else False
    text = yaml.safe_dump(
        {key: value}, sort_keys=False, allow_unicode=True, default_flow_style=style, width=100
    )
    return str(text).splitlines()


def _in_docstring(cls: type[Component]) -> Iterator[Mapping[str, Any]]:
    """The fields in each call of the class in its example, where they are written out."""
    names: dict[str, ast.expr] = {}
    for node in _nodes(_example(cls)):
        match node:
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                names[name] = value
            case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Tuple(elts=values)):
                names |= {t.id: v for t, v in zip(targets, values, strict=True) if isinstance(t, ast.Name)}
            case ast.Call(func=func) if _name(func) == cls.__name__:
                try:
                    found = _plain(node, names)
                except ValueError:
                    continue
                yield {key: value for key, value in found.items() if key != "kind"}


def _name(func: ast.expr) -> str:
    match func:
        case ast.Name(id=name) | ast.Attribute(value=ast.Name(id="hi"), attr=name):
            return name
    return ""


def _plain(node: ast.expr, names: Mapping[str, ast.expr]) -> Any:
    """A value in Python as a file holds it; ValueError if it is not written out."""
    match node:
        case ast.Call(func=func, args=[], keywords=keywords) if spec := _spec(_name(func)):
            fields: dict[str, Any] = {}
            for keyword in keywords:
                value = _plain(keyword.value, names)
                fields |= {keyword.arg: value} if keyword.arg else value
            return {"kind": spec.kind, **fields}
        case ast.Name(id=name) if name in names:
            return _plain(names[name], {key: value for key, value in names.items() if key != name})
        case ast.List(elts=items) | ast.Tuple(elts=items):
            return [_plain(item, names) for item in items]
        case ast.Dict(keys=keys, values=values):
            return {_plain(k, names): _plain(v, names) for k, v in zip(keys, values, strict=True) if k}
    return ast.literal_eval(node)


def _spec(name: str) -> type[Component] | None:
    known = (cls for family in PLURALS.values() for cls in components(family).values())
    return next((cls for cls in known if cls.__name__ == name), None)
