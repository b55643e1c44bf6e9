"""Imports run downwards only, those for type checking included."""

import ast
import pkgutil
from pathlib import Path

import pytest

import hident

ROOT = Path(hident.__file__).parent
# From the top. A room may import from its own line and from those below it; rooms on one line stand side
# by side and do not know each other.
LAYERS = (
    ("__main__", "pinned"),
    ("cli", "api", "testing"),
    ("commands",),
    ("doctor",),
    ("progress",),
    ("console",),
    ("reports",),
    ("ledger",),
    ("run_folder",),
    ("engine",),
    ("identification",),
    ("estimators", "metrics"),
    ("signals", "models"),
    ("systems", "measurements", "fitted_model", "model_output"),
    ("records", "plugins"),
    ("initial_states",),
    ("block_chain", "second_order_sections"),
    ("sampled_blocks",),
    ("linear_blocks", "static_functions"),
    ("numerics",),
    ("arrays",),
    ("config",),
    ("__init__",),
    ("arithmetic",),
    ("loaded_code", "new_files"),
    ("errors", "stopping"),
)
HEIGHT = {room: -level for level, rooms in enumerate(LAYERS) for room in rooms}
# Those under starters/ are copied, not imported.
MODULES = sorted(path for path in ROOT.rglob("*.py") if "starters" not in path.relative_to(ROOT).parts)


def room_of(module):
    return module.split(".")[0] or "__init__"


def imports(path):
    """The modules of hident that a file imports anywhere, relative to hident."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: relative imports hide their room"
            if node.module == "hident":
                for alias in node.names:
                    known = (ROOT / f"{alias.name}.py").exists() or (ROOT / alias.name).is_dir()
                    yield alias.name if known else ""
            elif node.module and node.module.startswith("hident."):
                yield node.module.removeprefix("hident.")
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] == "hident":
                    yield alias.name.partition(".")[2]


def test_every_room_has_its_place():
    rooms = {room_of(".".join(path.relative_to(ROOT).with_suffix("").parts)) for path in MODULES}
    assert rooms == set(HEIGHT)


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_imports_run_downwards(path):
    module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
    here = room_of(module)
    wrong = [
        imported
        for imported in imports(path)
        if room_of(imported) != here and HEIGHT[room_of(imported)] >= HEIGHT[here]
    ]
    assert not wrong, f"{module} imports {wrong}"


def family_of(module):
    """The family of estimators that a module belongs to; empty for what all families share."""
    room, _, rest = module.partition(".")
    family = rest.partition(".")[0]
    return family if room == "estimators" and (ROOT / "estimators" / family).is_dir() else ""


FAMILIES = [path for path in MODULES if family_of(".".join(path.relative_to(ROOT).with_suffix("").parts))]


@pytest.mark.parametrize("path", FAMILIES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_no_family_of_estimators_imports_another(path):
    module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
    wrong = [other for other in imports(path) if family_of(other) not in ("", family_of(module))]
    assert not wrong, f"{module} imports {wrong}"


def numerical(name):
    return name.split(".")[0] in {"estimators", "metrics", "signals", "systems", "numerics"}


NUMERICAL = [path for path in MODULES if numerical(path.relative_to(ROOT).parts[0])]


@pytest.mark.parametrize("path", NUMERICAL, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_numerical_rooms_do_not_write_or_print(path):
    called = {
        node.func.id
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    }
    assert not called & {"open", "print", "input", "exec", "eval"}


def test_no_folder_is_left_out():
    """What is checked is every module that can be imported, those in folders of folders included."""
    every = {
        module.name.removeprefix("hident.") for module in pkgutil.walk_packages(hident.__path__, "hident.")
    }

    def names(paths):
        parts = (path.relative_to(ROOT).with_suffix("").parts for path in paths)
        return {".".join(part for part in one if part != "__init__") for one in parts}

    assert names(MODULES) == every | {""}
    assert names(NUMERICAL) == {name for name in every if numerical(name)}
