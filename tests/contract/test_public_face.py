"""``import hident``: quick, complete, typed, and with examples that run."""

import doctest
import importlib
import inspect
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from typer.main import get_command

import hident
from hident import plugins
from hident.cli import app
from hident.commands.measured import option
from hident.config.spec import PLURALS, Component, components, own_docstring
from hident.measurements.measured_record import MeasuredRecord
from hident.reports.base import ReportSpec
from tests.forked import GUARD_SECONDS, ROOT

plugins.load()
SLOW = ("numpy", "scipy", "pandas", "pydantic", "matplotlib", "yaml", "typer")
REGISTERED = {
    cls
    for family in PLURALS.values()
    for cls in components(family).values()
    if cls.__module__.startswith("hident.")
}
COMPONENTS = sorted(REGISTERED, key=lambda cls: cls.__name__)
PACKAGE = ROOT / "hident"
WITH_EXAMPLES = [
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for path in sorted(PACKAGE.rglob("*.py"))
    if ">>>" in path.read_text(encoding="utf-8")
]
# These are about a whole run and its files: the examples of identify and run show the first three,
# docs/python.md the verbs, and configs/ has every table and figure. Exceptions are raised by hident alone.
NO_EXAMPLE = {
    "Experiment",
    "Identification",
    "Results",
    "compare",
    "examine",
    "power",
    "report",
    "status",
    "verify",
    "write",
}
# What does from Python what a verb does; results/ is changed, and files are begun, by the verbs alone.
COUNTERPARTS = {
    "list": "list_components",
    "validate": "validate",
    "run": "run",
    "power": "power",
    "status": "status",
    "compare": "compare",
    "accept": None,
    "verify": "verify",
    "report": "report",
    "schema": "schema",
    "export": "Results.trials_frame",
    "show": "first_look",
    "identify": "identify",
    "simulate": "FittedModel.simulate",
    "convert": "convert",
    "doctor": "examine",
    "new": None,
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


def test_every_file_that_is_no_module_is_part_of_the_package():
    package = Path(hident.__file__).parent
    settings = tomllib.loads((package.parent / "pyproject.toml").read_text(encoding="utf-8"))
    patterns = settings["tool"]["setuptools"]["package-data"]["hident"]
    packed = {file for pattern in patterns for file in package.glob(pattern)}
    every = {
        file
        for file in package.rglob("*")
        if file.is_file() and file.suffix != ".py" and "__pycache__" not in file.parts
    }
    assert every - packed == set()
    assert {"py.typed", "__init__.pyi", "base.html"} <= {file.name for file in every}


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
def test_a_public_name_has_a_docstring_and_an_example(name):
    value = getattr(hident, name)
    assert inspect.getdoc(value)
    shown = isinstance(value, type) and issubclass(value, ReportSpec | Exception)
    assert bool(doctest.DocTestParser().get_examples(value.__doc__)) != (shown or name in NO_EXAMPLE)


@pytest.mark.filterwarnings("ignore:the arithmetic in use")
@pytest.mark.parametrize("module", WITH_EXAMPLES)
def test_the_examples_run(module, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = doctest.testmod(importlib.import_module(module))
    assert done.attempted
    assert not done.failed


@pytest.mark.parametrize("cls", COMPONENTS, ids=lambda cls: cls.__name__)
def test_what_lists_and_schemas_show_of_a_docstring_ends_before_its_example(cls):
    text = own_docstring(cls)
    assert inspect.cleandoc(cls.__doc__).startswith(text)
    assert ">>>" not in text
    assert cls.model_json_schema()["description"] == text


@pytest.mark.parametrize("family", ["table", "figure"])
def test_every_kind_of_report_is_shown_by_a_configuration(family):
    shown = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "configs").glob("*.yaml"))
    kinds = {cls.kind for cls in REGISTERED if cls.family == family}
    assert {
        kind for kind in kinds if not re.search(rf"\bkind: {kind}\b|: {kind}$", shown, re.MULTILINE)
    } == set()


def test_every_verb_has_a_counterpart_or_is_known_to_have_none():
    verbs = set(get_command(app).commands)  # type: ignore[attr-defined]
    assert verbs == set(COUNTERPARTS)
    for path in filter(None, COUNTERPARTS.values()):
        name, _, method = path.partition(".")
        assert callable(getattr(getattr(hident, name), method) if method else getattr(hident, name))


def test_a_record_is_read_by_the_same_options_everywhere():
    verbs = get_command(app).commands  # type: ignore[attr-defined]
    options = {
        verb: {option for one in verbs[verb].params for option in one.opts if option.startswith("--")}
        for verb in ("show", "identify", "simulate")
    }
    named = {option(name) for name in MeasuredRecord.model_fields} - {"--file", "--units", "--offset"}
    assert named - options["show"] == named - options["identify"] == set()
    assert named - options["simulate"] == {"--output", "--estimate", "--validate"}
