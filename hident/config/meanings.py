"""The documentation of fields: the text that stands under each in the source."""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from itertools import pairwise

from pydantic import BaseModel


@cache
def meanings(spec: type[BaseModel]) -> Mapping[str, str]:
    """What each field means: the text under it in the source, read when it is first asked for."""
    found: dict[str, str] = {}
    for cls in reversed(spec.__mro__[: spec.__mro__.index(BaseModel)]):
        found |= _texts_by_class(cls.__module__).get(cls.__qualname__, {})
    return {name: found[name] for name in spec.model_fields if name in found}


@cache
def _texts_by_class(module: str) -> Mapping[str, Mapping[str, str]]:
    """The texts under the annotated names of each class of a module, by the class's qualified name."""
    try:
        tree = ast.parse(inspect.getsource(sys.modules[module]))
    except (KeyError, OSError, TypeError):
        # A class typed in at a prompt has no source.
        return {}
    found: dict[str, dict[str, str]] = {}

    def visit(node: ast.AST, prefix: str) -> None:
        for child in ast.iter_child_nodes(node):
            match child:
                case ast.ClassDef(name=name):
                    found[f"{prefix}{name}"] = dict(_texts(child.body))
                    visit(child, f"{prefix}{name}.")
                case ast.FunctionDef(name=name):
                    visit(child, f"{prefix}{name}.<locals>.")

    visit(tree, "")
    return found


def _texts(body: list[ast.stmt]) -> Iterator[tuple[str, str]]:
    for field, below in pairwise(body):
        match field, below:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                yield name, inspect.cleandoc(text)
