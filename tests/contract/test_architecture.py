"""docs/architecture.md says where everything is: every module is named in the row of its folder."""

from pathlib import Path

import pytest

import hident

ROOT = Path(hident.__file__).parent
DOCUMENT = ROOT.parent / "docs" / "architecture.md"
MODULES = sorted(
    path
    for path in (path.relative_to(ROOT) for path in ROOT.rglob("*.py"))
    # Those under starters/ are copied, not imported.
    if not path.stem.startswith("__") and path.parts[0] != "starters"
)


def rows():
    """The rows of the tables: the first cell, and the others."""
    for line in DOCUMENT.read_text(encoding="utf-8").splitlines():
        if line.startswith("| `"):
            first, _, rest = line.strip("| ").partition(" | ")
            yield first, rest


def row_of(module):
    """What the document says where the module should be named."""
    match module.parts:
        case (_,) | ("estimators", _):
            return " ".join(first for first, _ in rows()).replace("`hident/", "`")
        case ("estimators" | "reports", folder, _) | ("estimators", folder, _, _):
            start = f"`{folder}/`"
        case (room, _):
            start = f"`hident/{room}/`"
    return " ".join(rest for first, rest in rows() if first.startswith(start))


@pytest.mark.parametrize("module", MODULES, ids=str)
def test_every_module_is_named_in_the_row_of_its_folder(module):
    assert f"`{module.name}`" in row_of(module)


def test_every_name_in_a_row_is_that_of_a_module():
    named = {word for first, rest in rows() for word in f"{first} {rest}".split("`") if word.endswith(".py")}
    assert {word.rpartition("/")[2] for word in named} <= {path.name for path in MODULES}
