"""``import hident``: quick, complete, typed, and with examples that run."""

import doctest
import importlib
import inspect
import subprocess
import sys
from pathlib import Path

import pytest
from typer.main import get_command

import hident
from hident import plugins
from hident.cli import app
from hident.config.spec import PLURALS, Component, components
from tests.forked import GUARD_SECONDS

plugins.load()
SLOW = ("numpy", "scipy", "pandas", "pydantic", "matplotlib", "yaml", "typer")
REGISTERED = {
    cls
    for family in PLURALS.values()
    for cls in components(family).values()
    if cls.__module__.startswith("hident.")
}
# What does from Python what a verb does; results/ is changed from the command line alone.
COUNTERPARTS = {
    "list": "list_components",
    "validate": "validate",
    "run": "run",
    "status": "status",
    "compare": "compare",
    "accept": None,
    "verify": "verify",
    "schema": "schema",
    "export": "Results.trials_frame",
    "doctor": "examine",
}


def test_import_hident_loads_nothing_that_is_slow():
    code = f"import sys, hident; print([name for name in {SLOW} if name in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=GUARD_SECONDS, check=True
    )
    assert done.stdout.strip() == "[]"


def test_every_built_in_component_is_public_by_its_class_name():
    public = {value for name in hident.__all__ if inspect.isclass(value := getattr(hident, name))}
    assert {value for value in public if issubclass(value, Component)} == REGISTERED
    assert all(getattr(hident, cls.__name__) is cls for cls in REGISTERED)


def test_public_names_stand_once_and_are_listed():
    assert len(set(hident.__all__)) == len(hident.__all__)
    assert set(hident.__all__) <= set(dir(hident))


def test_the_stub_and_the_marker_are_part_of_the_package():
    package = Path(hident.__file__).parent
    assert (package / "py.typed").is_file()
    settings = (package.parent / "pyproject.toml").read_text(encoding="utf-8")
    assert 'hident = ["py.typed", "*.pyi"]' in settings


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'hident' has no attribute 'Kernal'"):
        hident.Kernal  # type: ignore[attr-defined]  # noqa: B018


def test_a_module_of_the_package_is_no_public_name():
    code = "import hident; print(hasattr(hident, 'engine'), hasattr(hident, '_nothing'))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=GUARD_SECONDS, check=True
    )
    assert done.stdout.split() == ["False", "False"]


@pytest.mark.parametrize("name", hident.__all__)
def test_the_examples_of_public_names_run(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    value = getattr(hident, name)
    assert inspect.getdoc(value)
    space = dict(vars(importlib.import_module(value.__module__)))
    for example in doctest.DocTestFinder(recurse=False).find(value, name, globs=space):
        result = doctest.DocTestRunner().run(example)
        assert not result.failed


@pytest.mark.parametrize(
    "name",
    [
        *("simulate", "fit", "score", "run", "read", "validate", "schema", "list_components"),
        *("Record", "Estimate", "TransferFunction", "ContinuousTransferFunction"),
    ],
)
def test_what_a_notebook_begins_with_has_an_example(name):
    assert doctest.DocTestParser().get_examples(getattr(hident, name).__doc__)


def test_every_verb_has_a_counterpart_or_is_known_to_have_none():
    verbs = set(get_command(app).commands)  # type: ignore[attr-defined]
    assert verbs == set(COUNTERPARTS)
    for path in filter(None, COUNTERPARTS.values()):
        name, _, method = path.partition(".")
        assert callable(getattr(getattr(hident, name), method) if method else getattr(hident, name))
