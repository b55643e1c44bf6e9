"""hident: Monte Carlo experiments on the identification of block-oriented nonlinear systems.

``__all__`` is the public face: the functions of :mod:`hident.api`, what they take and return, and every
built-in component by its class name. Each is loaded when it is first used (PEP 562), so that
``import hident`` takes no time; ``__init__.pyi`` says where from, to type checkers and to this module alike.
"""

from functools import cache
from typing import Any

from hident import arithmetic as _arithmetic  # noqa: F401  (it must come before numpy)

__version__ = "0.1.0"


@cache
def _homes() -> dict[str, str]:
    """The module of each public name."""
    import ast
    from pathlib import Path

    stub = ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    return {alias.name: str(node.module) for node in imports for alias in node.names}


def __getattr__(name: str) -> Any:
    if name == "__all__":
        return sorted(_homes())
    home = None if name.startswith("_") else _homes().get(name)
    if home is None:
        raise AttributeError(f"module 'hident' has no attribute {name!r}")
    import importlib

    plugins = importlib.import_module("hident.plugins")
    if home.split(".")[1] in plugins.ROOMS:
        # A component names others by their kinds.
        plugins.load_built_in()
    value = globals()[name] = getattr(importlib.import_module(home), name)
    return value


def __dir__() -> list[str]:
    return [*globals(), *_homes()]
