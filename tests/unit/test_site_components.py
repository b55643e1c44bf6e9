"""The site's pages of components: each has one, on which every key stands."""

import doctest
import json
from html.parser import HTMLParser
from pathlib import Path
from typing import Annotated

import pytest
import yaml

from hident import plugins
from hident.config import spec
from hident.config.describe import fields
from hident.config.spec import PLURALS, Of, Real, component, components, own_docstring
from hident.engine.experiment import Experiment
from hident.estimators.base import EstimatorSpec
from hident.reports.site import components as pages_of
from hident.reports.site.examples import as_yaml, in_python, written
from hident.reports.site.pages import (
    FILE_PAGE,
    Run,
    Sources,
    component_page,
    family_page,
    file_name,
    key_anchor,
    run_page,
)
from hident.reports.site.rendering import rendered
from hident.reports.site.uses import named
from hident.run_folder import RunFolder
from hident.systems.base import SystemSpec

plugins.load()
ROOT = Path(__file__).parents[2]
KINDS = [
    (family, kind)
    for family in PLURALS.values()
    for kind, cls in components(family).items()
    if cls.__module__.startswith("hident.")
]


class Read(HTMLParser):
    """What a page holds: its words, and by their anchors those of its rows."""

    def __init__(self, html):
        super().__init__()
        self.words, self.ids, self.links, self.rows, self.tags = "", [], [], {}, []
        self._row = None
        self.feed(html)

    def handle_starttag(self, tag, attributes):
        found = dict(attributes)
        self.tags.append(tag)
        self.ids += [found["id"]] if "id" in found else []
        self.links += [found["href"]] if tag == "a" and "href" in found else []
        self.words += found.get("alt", "")
        if tag == "tr":
            self._row = found.get("id")

    def handle_endtag(self, tag):
        self._row = None if tag == "tr" else self._row

    def handle_data(self, data):
        self.words += data
        if self._row:
            self.rows[self._row] = self.rows.get(self._row, "") + data


def run_of(folder, resolved, name="a_run"):
    """A run whose folder holds nothing but its configuration."""
    (folder / name).mkdir(parents=True)
    run = {"experiment": {"config": name, "resolved": resolved}, "files": [], "provenance": {}}
    (folder / name / "run.json").write_text(json.dumps(run), encoding="utf-8")
    return Run(name, RunFolder(folder / name), folder)


def sources_of(*runs, experiments=ROOT / "experiments"):
    return Sources(runs, experiments, ROOT / "configs", ROOT / "docs")


def made(sources):
    """The pages of all components by their paths."""
    pages = [page for part in pages_of.parts(sources) for page in part.make()]
    return {page.path: rendered(page) for page in pages}


@pytest.fixture(scope="module")
def pages():
    return made(sources_of())


@pytest.mark.parametrize(("family", "kind"), KINDS)
def test_every_component_has_a_page_with_all_its_keys(pages, family, kind):
    cls = components(family)[kind]
    page = Read(pages[component_page(family, kind)].html)
    for word in own_docstring(cls).partition("\n")[0].split():
        if word.isalpha():
            assert word in page.words
    assert cls.source in page.words
    for key, holds, default, _ in fields(cls):
        assert key.rpartition(", ")[0] in page.words if not holds else key in page.words
        if holds:
            assert key_anchor(key) in page.ids
            assert default in page.words
    assert len(page.ids) == len({*page.ids}), "an anchor stands twice"


@pytest.mark.parametrize(("family", "kind"), KINDS)
def test_every_component_stands_on_the_page_of_its_family(pages, family, kind):
    listed = Read(pages[family_page(family)].html)
    assert f"{kind}.html" in listed.links


def test_the_keys_of_the_file_stand_on_a_page_of_their_own(pages):
    rows = Read(pages[FILE_PAGE].html).rows
    for key, holds, default, _ in fields(Experiment):
        if holds:
            assert rows[key_anchor(key)].split()[0] == key
            assert default in rows[key_anchor(key)]


def test_a_row_says_what_a_key_holds_and_links_the_family(pages):
    page = Read(pages[component_page("estimator", "kernel")].html)
    assert "number ≥\N{NO-BREAK SPACE}0, <\N{NO-BREAK SPACE}1" in page.rows["key-bandwidth.alpha"]
    assert "required" in page.rows["key-bandwidth.alpha"]
    assert (
        "Exponent of the number of samples; 0 keeps the bandwidth fixed." in page.rows["key-bandwidth.alpha"]
    )
    assert "index.html" in page.links


def test_an_equation_is_set_with_its_indices(pages):
    assert (
        '<div class="formula"><var>R</var>(<var>u</var>) = ∑<sub>k</sub> <var>y</var><sub>k</sub>'
        in pages[component_page("estimator", "kernel")].html
    )


def test_the_symbols_that_another_module_explains_are_shown(pages):
    page = Read(pages[component_page("estimator", "two_stage")].html)
    assert "the n x m matrix of the coefficients of Phi" in page.words
    assert "====" not in page.words


def test_a_source_has_its_bibtex(pages):
    assert "@article{mzyk2009," in Read(pages[component_page("estimator", "kernel")].html).words
    assert "@book{golomb1967," in Read(pages[component_page("excitation", "prbs")].html).words
    assert "To cite" not in Read(pages[component_page("metric", "rmse")].html).words


def test_what_a_component_needs_and_gives_is_said(pages):
    kernel = Read(pages[component_page("estimator", "kernel")].html).words
    assert (
        "A record of one experiment, or of several at one sampling interval, of at least 2 samples." in kernel
    )
    assert "Fixed by: b0 = 1." in kernel
    error = Read(pages[component_page("metric", "error")].html).words
    assert "NAME a_1, where NAME is its name in the configuration." in error
    assert "Best is zero." in error
    assert "Wiener-Hammerstein" in Read(pages[component_page("system", "wiener_hammerstein")].html).words


@pytest.mark.parametrize(("family", "kind"), [pair for pair in KINDS if pair[0] not in ("table", "figure")])
def test_the_example_for_a_file_is_a_component(family, kind):
    cls = components(family)[kind]
    fields_of_example = written(cls)
    assert fields_of_example is not None
    assert cls(**fields_of_example) is not None
    inside = yaml.safe_load(as_yaml(cls, fields_of_example))
    while "kind" not in inside:
        [inside] = inside.values() if isinstance(inside, dict) else inside
    assert inside == {"kind": kind, **fields_of_example}


@pytest.mark.parametrize(("family", "kind"), [pair for pair in KINDS if pair[0] in ("table", "figure")])
def test_tables_and_figures_take_their_example_from_a_configuration(family, kind):
    cls = components(family)[kind]
    in_use = [
        fields_of_use
        for file in sorted((ROOT / "results").glob("*/run.json"))
        for of, its, fields_of_use in named(json.loads(file.read_text())["experiment"]["resolved"])
        if (of, its) == (family, kind)
    ]
    found = written(cls, in_use)
    assert found in in_use
    assert len(str(found)) == min(len(str(one)) for one in in_use)


def test_the_examples_for_python_run_as_they_stand():
    said: list[str] = []
    for family, kind in KINDS:
        if example := in_python(components(family)[kind]):
            test = doctest.DocTestParser().get_doctest(example, {}, f"{family} {kind}", None, 0)
            doctest.DocTestRunner(verbose=False).run(test, out=said.append)
    assert not said, "".join(said)


RESOLVED = {
    "title": "A <b>title</b>",
    "system": {"kind": "hammerstein", "nonlinearity": {"kind": "abs"}, "linear": {"kind": "ar", "a": [0.5]}},
    "noise": [{"kind": "ar", "a": [0.5], "std": 0.1}],
    "cases": {
        "type": {"I": "chen_type_1", "II": "chen_type_2"},
        "input": {"wide": {"excitation": {"kind": "prbs", "order": 4, "levels": [-1, 1]}}},
        "kernel": ["gaussian", "triangular"],
    },
    "estimators": {
        "one": {"kind": "two_stage", "lags": 2, "basis": ["identity", {"kind": "sign"}], "delay": 0}
    },
    "alternatives": {"other": {"streams": {"kind": "matlab5"}}},
}


def test_what_a_configuration_names_is_found_with_its_family():
    found = {(family, kind) for family, kind, _ in named(RESOLVED)}
    assert found == {
        ("system", "hammerstein"),
        ("nonlinearity", "abs"),
        ("linear", "ar"),
        ("noise", "ar"),
        ("nonlinearity", "chen_type_1"),
        ("nonlinearity", "chen_type_2"),
        ("excitation", "prbs"),
        ("estimator", "two_stage"),
        ("nonlinearity", "identity"),
        ("nonlinearity", "sign"),
        ("streams", "matlab5"),
    }


@pytest.mark.parametrize(
    "resolved",
    [
        {},
        {"system": 3},
        {"system": {"kind": ["a"]}},
        {"estimators": [1], "cases": None},
        {"noise": {"kind": "x"}},
    ],
)
def test_a_configuration_that_is_none_names_nothing(resolved):
    assert [*named(resolved)] == []


def test_the_page_of_a_component_lists_the_runs_that_name_it(tmp_path):
    pages = made(sources_of(run_of(tmp_path, RESOLVED)))
    used = pages[component_page("nonlinearity", "chen_type_2")].html
    assert f"../../{run_page('a_run')}" in Read(used).links
    assert "A &lt;b&gt;title&lt;/b&gt;" in used
    assert "None of these runs names it." in pages[component_page("nonlinearity", "chen_type_3")].html
    assert "In every run that names no other." in pages[component_page("streams", "numpy")].html


@pytest.fixture
def strange(monkeypatch):
    """A plugin's components with a name that is no name of a file, and markup in all that they say."""
    register = {family: dict(kinds) for family, kinds in spec._REGISTER.items()}
    monkeypatch.setattr(spec, "_REGISTER", register)

    @component("estimator", "a/b <i>", source="Nobody <s>1999</s>")
    class Strange(EstimatorSpec):
        """Estimates <script>alert(1)</script> of c:\\users & [x](javascript:alert(1)).

        x_k <= <b>y</b>
        """

        level: Real = 0.5
        """A <img src=x onerror=alert(1)> "level"."""
        inner: Annotated[SystemSpec, Of("system")] | None = None
        """A system."""

    @component("system", "unfinished")
    class Unfinished(SystemSpec):
        """A system that answers nothing."""

    @component("system", "broken")
    class Broken(SystemSpec):
        """A system that cannot say what it is."""

        def truth(self):
            raise KeyError("anything")

    return Strange


def test_a_plugin_has_its_page_and_no_markup_of_it_comes_through(strange, tmp_path):
    pages = made(sources_of())
    path = component_page("estimator", strange.kind)
    assert path == "components/estimator/a~2f~b~20~~3c~i~3e~.html"
    page = Read(pages[path].html)
    assert "It comes from a plugin." in page.words
    assert "<script>alert(1)</script>" in page.words
    assert not {"i", "s", "b", "img"} & {*page.tags}
    assert page.tags.count("script") == pages["components/index.html"].html.count("<script")
    assert not [link for link in page.links if "javascript" in link]
    assert "system" in page.rows["key-inner"]
    for kind, said in (("unfinished", "that answers nothing."), ("broken", "that cannot say what it is.")):
        assert f"A system {said}" in Read(pages[component_page("system", kind)].html).words


def test_the_key_changes_with_what_a_plugin_says(strange):
    def key():
        *_, components_part = pages_of.parts(sources_of())
        return components_part.key

    before = key()
    assert key() == before
    strange.__doc__ = "Another sentence."
    assert key() != before


@pytest.mark.parametrize("name", ["two_stage", "a/b", "..", "index", "INDEX~", "é", ""])
def test_the_names_of_files_are_safe_and_differ(name):
    safe = file_name(name)
    assert safe
    assert safe not in (".", "..", "index")
    assert not {*safe} - {*"abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_.-~"}


def test_the_same_pages_come_out_again(pages):
    assert made(sources_of()) == pages


def test_no_page_is_larger_than_300_kb(pages):
    largest = max(pages.values(), key=lambda page: len(page.html))
    assert len(largest.html.encode()) < 300_000, largest.path


def test_the_command_for_a_component_from_a_file_names_the_file(tmp_path, monkeypatch):
    register = {family: dict(kinds) for family, kinds in spec._REGISTER.items()}
    monkeypatch.setattr(spec, "_REGISTER", register)
    (tmp_path / "my_file.py").write_text(
        "from hident.config.spec import component\n"
        "from hident.estimators.base import EstimatorSpec\n\n\n"
        "@component('estimator', 'from_file')\n"
        "class FromFile(EstimatorSpec):\n"
        '    """A method from a file."""\n',
        encoding="utf-8",
    )
    plugins.load([tmp_path / "my_file.py"])
    words = Read(made(sources_of())[component_page("estimator", "from_file")].html).words
    assert "hident list estimators from_file --plugin my_file.py" in words


def test_bibtex_of_our_methods_needs_no_folder_of_papers(tmp_path):
    kernel = made(sources_of(experiments=tmp_path))[component_page("estimator", "kernel")]
    assert "@article{mzyk2009," in Read(kernel.html).words
