"""The fingerprint changes with the code that a trial runs through, and with nothing else."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hident import loaded_code, plugins
from hident.arithmetic import identity
from hident.config.spec import Component, Of, components
from hident.engine import fingerprint as module
from hident.engine.fingerprint import code, fingerprint, libraries

plugins.load()

_KERNEL = {"kind": "kernel", "kernel": "triangular", "bandwidth": {"h0": 1, "alpha": 0.2}}
_CORE = '''"""Core."""


def double(x):
    """Twice x."""
    # A comment.
    return 2 * x
'''


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A plugin of several modules: ``sample`` imports ``.core`` in three ways, and ``stranger``."""
    folder = tmp_path / "fp_plugin"
    folder.mkdir()
    (folder / "__init__.py").write_text("from fp_plugin.core import double\n")
    (folder / "sample.py").write_text("from . import core\nimport fp_stranger\n\nVALUE = core.double(2)\n")
    (folder / "core.py").write_text(_CORE)
    (folder / "unused.py").write_text("VALUE = 1\n")
    (tmp_path / "fp_stranger.py").write_text("VALUE = 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    importlib.import_module("fp_plugin.sample")
    importlib.import_module("fp_plugin.unused")
    yield folder
    for name in [name for name in sys.modules if name.startswith("fp_")]:
        del sys.modules[name]
    _read_again()


@pytest.fixture(autouse=True)
def _only_plugins_change(monkeypatch: pytest.MonkeyPatch) -> None:
    """The package's own modules, which no test edits, are read once."""
    remembered, anew = module._of_module, module._of_module.__wrapped__

    def of_module(name: str, *, shown: bool) -> tuple[str, tuple[str, ...]]:
        return (remembered if name.startswith("hident.") else anew)(name, shown=shown)

    of_module.cache_clear = lambda: None  # type: ignore[attr-defined]
    monkeypatch.setattr(module, "_of_module", of_module)


def _read_again() -> None:
    """As a process that is started anew."""
    for name in loaded_code.known():
        loaded_code._forget(name)
    module._of_modules.cache_clear()


def _changed(file: Path, old: str, new: str) -> bool:
    before = code(["fp_plugin.sample"])
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    _read_again()
    return code(["fp_plugin.sample"]) != before


def test_numbers_count_in_every_module_that_is_imported(package: Path) -> None:
    assert _changed(package / "core.py", "2 * x", "3 * x")
    assert _changed(package / "sample.py", "double(2)", "double(3)")


def test_code_in_the_file_of_a_package_counts(package: Path) -> None:
    before = code(["fp_plugin"])
    (package / "__init__.py").write_text("from fp_plugin.core import double\nVALUE = 1\n")
    _read_again()
    assert code(["fp_plugin"]) != before


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("# A comment.", "# Another comment."),
        ('"""Twice x."""', '"""Two times x."""'),
        ('"""Core."""', ""),
        ("2 * x", "2*x"),
        ("\n\n\n", "\n\n"),
    ],
)
def test_comments_docstrings_and_layout_do_not_count(package: Path, old: str, new: str) -> None:
    assert not _changed(package / "core.py", old, new)


def test_modules_that_are_not_imported_and_other_packages_do_not_count(package: Path) -> None:
    assert not _changed(package / "unused.py", "1", "2")
    assert not _changed(package.parent / "fp_stranger.py", "1", "2")


def test_place_of_a_plugin_does_not_count(tmp_path: Path) -> None:
    before = set(sys.modules)
    files = [tmp_path / name / "fp_file.py" for name in ("one", "two", "three")]
    for file, value in zip(files, (1, 1, 2), strict=True):
        file.parent.mkdir()
        file.write_text(f"VALUE = {value}\n")
    plugins.load(files)
    names = [name for name in sys.modules if name not in before and "fp_file" in name]
    one, two, three = (code([name]) for name in names)
    for name in names:
        del sys.modules[name]
    assert one == two != three


def _estimator(**fields: Any) -> Component:
    return Of("estimator").validate(fields)


def test_only_what_a_spec_uses_counts() -> None:
    known, other = (_estimator(kind="known_dynamics", a=[a]) for a in (0.8, 0.5))
    kernel = _estimator(**_KERNEL)
    assert fingerprint([known]) == fingerprint([other]) != fingerprint([kernel])


def test_specs_inside_specs_count() -> None:
    filtered = _estimator(**_KERNEL, prefilter={"kind": "known_dynamics", "a": [0.8]})
    assert fingerprint([filtered]) != fingerprint([_estimator(**_KERNEL)])


def test_modules_without_a_source_have_no_code() -> None:
    assert code(["math"]) == code(["no such module"])


def test_libraries_are_those_of_the_arithmetic() -> None:
    import numpy as np

    assert libraries()["numpy"] == np.__version__
    assert set(libraries()) == {"numpy", "scipy", "finufft", "arithmetic"}
    assert libraries()["arithmetic"] == identity()


def test_modules_beside_a_plugin_count_and_libraries_below_it_do_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    library = tmp_path / ".venv/lib/site-packages"
    library.mkdir(parents=True)
    (tmp_path / "fp_parts").mkdir()
    for folder in (tmp_path, library):
        monkeypatch.syspath_prepend(folder)
    files = [tmp_path / "fp_helper.py", tmp_path / "fp_parts/inner.py", library / "fp_library.py"]
    for file in files:
        file.write_text("VALUE = 1\n")
    plugin = tmp_path / "fp_alone.py"
    plugin.write_text("import fp_library\nfrom fp_helper import VALUE\nimport fp_parts.inner\n")
    before = set(sys.modules)
    plugins.load([plugin])
    new = set(sys.modules) - before
    (name,) = (name for name in new if "fp_alone" in name)
    hashes = [code([name])]
    for file in files:
        file.write_text("VALUE = 2\n")
        _read_again()
        hashes.append(code([name]))
    for module_name in new:
        del sys.modules[module_name]
    _read_again()
    assert len(set(hashes[:3])) == 3
    assert hashes[3] == hashes[2]


_FILE = '''
import math
import helper
from hident.config.spec import Count, Real, component
from hident.estimators.base import EstimatorSpec
from hident.records import Estimate
from hident.reports.base import FigureSpec, TableSpec

WIDTH = 3
SCALE = 2.0


def drawn(x):
    return WIDTH * x


def scaled(x):
    return SCALE * x + helper.VALUE


@component("estimator", "fp_estimator")
class Own(EstimatorSpec):
    """An estimator."""

    def names(self):
        return ["a"]

    def fit(self, record, rng):
        return Estimate(values={"a": scaled(1.0)})


class Base(FigureSpec):
    """What figures share."""

    size: Real = 1.0
    """Size."""


@component("figure", "fp_figure")
class Figure(Base):
    """A figure."""

    def draw(self, results, verdicts):
        assert isinstance(results, Own)
        return drawn(math.pi)


@component("table", "fp_table")
class OwnTable(TableSpec):
    """A table."""

    def build(self, results, verdicts):
        return scaled(2.0)
'''


@pytest.fixture
def plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A plugin file with an estimator, a figure and a table, and its neighbour ``helper.py``."""
    from hident.config import spec

    monkeypatch.setattr(spec, "_REGISTER", {family: dict(kinds) for family, kinds in spec._REGISTER.items()})
    before = set(sys.modules)
    (tmp_path / "helper.py").write_text("VALUE = 1.0\n")
    (tmp_path / "fp_all.py").write_text(_FILE)
    plugins.load([tmp_path / "fp_all.py"])
    yield tmp_path
    for name in set(sys.modules) - before:
        del sys.modules[name]
    _read_again()


def _keys(folder: Path, file: str, old: str, new: str) -> tuple[bool, bool]:
    """Whether an edit of a file changes the key of the estimator's trials, and that of the figure."""

    def both() -> tuple[str, str]:
        _read_again()
        estimator, figure = components("estimator")["fp_estimator"], components("figure")["fp_figure"]
        return fingerprint([estimator()]), code([figure.__module__])

    before = both()
    text = (folder / file).read_text()
    assert old in text
    (folder / file).write_text(text.replace(old, new))
    after = both()
    return before[0] != after[0], before[1] != after[1]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("drawn(math.pi)", "drawn(math.e)"),
        ("return scaled(2.0)", "return scaled(3.0)"),
        ("size: Real = 1.0", "size: Real = 2.0"),
        ("return WIDTH * x", "return WIDTH + x"),
        ("WIDTH = 3", "WIDTH = 4"),
        ("import math\n", "import math\nfrom random import choice\n"),
        ("import Count, Real", "import Count, Flag, Real"),
        ("    size: Real = 1.0", "    size: Count = 1"),
    ],
)
def test_tables_and_figures_beside_an_estimator_do_not_count_for_its_trials(
    plugin: Path, old: str, new: str
) -> None:
    assert _keys(plugin, "fp_all.py", old, new) == (False, True)


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("fp_all.py", "SCALE * x +", "SCALE * x -"),
        ("fp_all.py", "SCALE = 2.0", "SCALE = 3.0"),
        ("fp_all.py", '{"a": scaled(1.0)}', '{"a": scaled(1.5)}'),
        ("fp_all.py", "import helper\n", "import helper\n\nprint()\n"),
        ("helper.py", "1.0", "2.0"),
    ],
)
def test_what_an_estimator_uses_counts_in_its_file_and_beside_it(
    plugin: Path, file: str, old: str, new: str
) -> None:
    assert _keys(plugin, file, old, new) == (True, True)


def test_what_only_a_figure_mentions_counts_where_a_neighbour_uses_it(plugin: Path) -> None:
    (plugin / "fp_user.py").write_text("from fp_all import drawn\n")
    plugins.load([plugin / "fp_user.py"])
    assert _keys(plugin, "fp_all.py", "return WIDTH * x", "return WIDTH + x") == (True, True)


_LAZY = {
    "__init__.py": "",
    "fp_lazy.py": "from DOTfp_beside import VALUE\n\n\ndef fit():\n    from DOTfp_poly import poly\n",
    "fp_beside.py": "VALUE = 1\n",
    "fp_poly.py": (
        "def poly():\n    from DOTfp_parts import inner\n    from DOTfp_broken import VALUE\n"
        "    from DOTfp_nowhere import VALUE\n    from .... import above\n    import scipy.datasets\n"
    ),
    "fp_parts/inner.py": "VALUE = 1\n",
    "fp_broken.py": "VALUE = (1\n",
    "fp_idle.py": "VALUE = 1\n",
}


@pytest.mark.parametrize("kind", ["plugin file", "plugin file that everybody can import", "package"])
def test_what_is_imported_within_a_function_counts_and_is_not_loaded_for_that(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    folder = tmp_path / "fp_package"
    (folder / "fp_parts").mkdir(parents=True)
    for file, text in _LAZY.items():
        (folder / file).write_text(text.replace("DOT", "." if kind == "package" else ""))
    before = set(sys.modules)
    if kind == "package":
        monkeypatch.syspath_prepend(tmp_path)
        importlib.import_module("fp_package.fp_lazy")
    else:
        if kind != "plugin file":
            monkeypatch.syspath_prepend(folder)
        plugins.load([folder / "fp_lazy.py"])
    loaded = set(sys.modules) - before
    (name,) = (name for name in loaded if name.endswith("fp_lazy"))
    counted = set()
    hashed = code([name])
    for file in _LAZY:
        with (folder / file).open("a") as added:
            added.write("\nANOTHER = 2\n")
        _read_again()
        if hashed != (hashed := code([name])):
            counted.add(file)
    assert set(sys.modules) - before == loaded
    for module_name in loaded:
        del sys.modules[module_name]
    _read_again()
    assert counted == {file for file in _LAZY if file not in ("__init__.py", "fp_idle.py")}
