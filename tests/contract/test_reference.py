"""docs/reference.md is what hident schema --markdown prints, and that is everything."""

import re
import subprocess
import sys

import pytest

from hident import plugins
from hident.config.describe import fields
from hident.config.spec import PLURALS, components
from tests.documented import ROOT

plugins.load()
KINDS = [
    (plural, cls)
    for plural, family in PLURALS.items()
    for cls in components(family).values()
    if cls.__module__.startswith("hident.")
]


@pytest.fixture(scope="module")
def page():
    """What is printed in a process where no test has registered components."""
    command = [sys.executable, "-m", "hident", "schema", "--markdown"]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout


@pytest.fixture(scope="module")
def sections(page):
    """The text under each kind, by its family and name."""
    found = {}
    for family in re.split(r"^## ", page, flags=re.MULTILINE)[1:]:
        name, _, text = family.partition("\n")
        for kind in re.split(r"^### ", text, flags=re.MULTILINE)[1:]:
            title, _, body = kind.partition("\n")
            found[name, title] = body
    return found


def test_the_stored_page_is_current(page):
    stored = (ROOT / "docs/reference.md").read_text(encoding="utf-8")
    assert stored == page, "run: hident schema --markdown > docs/reference.md"


def test_every_component_is_there_with_all_its_keys(sections):
    for plural, cls in KINDS:
        text = sections[plural, cls.kind]
        assert cls.summary().replace("``", "`") in text.replace("\\*", "*")
        for path, holds, default, _ in fields(cls):
            row = f"| `{path}` | {holds} | {default} |"
            assert row in text.replace(r"\|", "|"), (cls.kind, path)
