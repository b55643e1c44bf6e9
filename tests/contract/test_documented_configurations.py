"""The examples of docs/configuration.md and docs/publication.md run, and give what the pages say."""

import re
import shlex
import shutil

import numpy as np
import pytest

import hident as hi
from hident import plugins
from hident.commands.plans import load_plans
from hident.config import spec
from hident.config.spec import components
from hident.engine.runner import run
from hident.reports.output import Outputs
from tests.documented import blocks
from tests.forked import run_forked
from tests.typesetting import typeset

PAGES = ("docs/configuration.md", "docs/publication.md")
EXAMPLES = {
    title: text
    for page in PAGES
    for text in blocks(page, "yaml")
    for title in re.findall(r"^title: (.*)$", text, re.M)
}
PLUGIN = '''
from hident.config.spec import component
from hident.estimators.base import EstimatorSpec
from hident.records import Estimate


@component("estimator", "mean_of_output")
class MeanOfOutput(EstimatorSpec):
    """The mean of the output."""

    def names(self):
        return ["mean"]

    def fit(self, record, rng):
        return Estimate(values={"mean": float(record.y.mean())})
'''


def _write_record(path):
    """Samples of a pump and of the levels in two tanks."""
    pump = np.random.default_rng(1).uniform(0.0, 2.0, 600)
    upper = np.convolve(pump**2, [0.0, 0.5, 0.3, 0.1])[:600]
    lower = np.convolve(upper, [0.0, 0.4, 0.2])[:600]
    np.savetxt(path, np.c_[pump, upper, lower], delimiter=",", header="pump,upper,lower", comments="")


@pytest.fixture
def plan(tmp_path, monkeypatch):
    plugins.load()
    monkeypatch.setattr(spec, "_REGISTER", {**spec._REGISTER, "estimator": dict(components("estimator"))})

    def plan(title):
        (tmp_path / "mine.py").write_text(PLUGIN)
        _write_record(tmp_path / "tanks.csv")
        (tmp_path / "a.yaml").write_text(EXAMPLES[title], encoding="utf-8")
        [plan] = load_plans([tmp_path / "a.yaml"], None, {}, ())
        return plan

    return plan


@pytest.mark.parametrize("title", EXAMPLES)
def test_an_example_runs(plan, title, tmp_path):
    whole = plan(title)
    # A measured record is a trial alone.
    few = whole.changed(trials=min(2, whole.trials))
    assert few.units
    assert Outputs(few, tmp_path / "out").write(run(few), {}) == ()


def test_every_block_is_an_example():
    assert len(EXAMPLES) == sum(len(blocks(page, "yaml")) for page in PAGES)


@pytest.mark.filterwarnings("ignore:the arithmetic in use")
def test_a_paper_is_written_as_the_page_says(tmp_path, monkeypatch):
    """The commands of docs/publication.md, of the example on it."""
    page = "docs/publication.md"
    [text], [command], [code] = (blocks(page, language) for language in ("yaml", "console", "python"))
    (tmp_path / "configs").mkdir()
    (tmp_path / "configs" / "kernels.yaml").write_text(text, encoding="utf-8")
    _, *words = shlex.split(command.replace("CONFIG", "kernels"))
    ended = run_forked([*words, "--jobs", "1"], tmp_path)
    assert ended.returncode == 0, ended.stderr
    out = tmp_path / "out" / "kernels"
    written = {path.name: path.read_bytes() for path in out.iterdir()}
    assert {"errors.pdf", "errors.svg", "errors.tex", "table.tex"} <= written.keys()
    monkeypatch.chdir(tmp_path)
    shutil.rmtree(out)
    exec(code.replace("CONFIG", "kernels"), {"hi": hi})
    assert (out / "errors.pdf").read_bytes() == written["errors.pdf"]
    assert (out / "errors.tex").read_bytes() == written["errors.tex"]
    figure, table = (block.replace("CONFIG", "kernels") for block in blocks(page, "tex"))
    preamble, _, body = table.partition("...\n")
    assert typeset(f"{preamble}\\usepackage{{graphicx}}", f"{figure}\n{body}", tmp_path) == []


def test_axes(plan):
    units = plan("Weighted and plain least squares against the colour of the noise").units
    assert [unit.data.samples for unit in units[::6]] == [100, 200]
    assert [unit.labels["pole"] for unit in units[:6:2]] == [0.1, 0.5, 0.9]
    assert units[5].estimator.weight.a == (0.9,) == units[5].data.noise[0].a


def test_labels(plan):
    units = plan("Labels with values, and labels that set several").units
    assert [
        (u.labels["type"], u.labels["setting"], u.data.system.nonlinearity.kind, u.estimator.first.n)
        for u in units
    ] == [
        ("I", "quick", "chen_type_1", 2),
        ("I", "slow", "chen_type_1", 3),
        ("II", "quick", "chen_type_2", 2),
        ("II", "slow", "chen_type_2", 3),
    ]


def test_skip(plan):
    units = plan("No wide kernel for short records").units
    assert [(unit.name, *unit.labels.values()) for unit in units] == [
        ("kernel", 100, 0.1),
        ("series", 100),
        ("kernel", 1000, 0.1),
        ("series", 1000),
        ("kernel", 10000, 0.1),
        ("kernel", 10000, 1),
    ]


def test_repeated_entries(plan):
    experiment = plan("Two orders, two values, three tables").experiment
    assert [column.header for column in experiment.tables["columns"].columns] == [
        "order 1, mean",
        "order 1, std",
        "order 2, mean",
        "order 2, std",
    ]
    assert [(c.metric, c.header) for c in experiment.tables["together"].columns] == [
        ("value a_1", "pole by order 1"),
        ("value c", "gain by order 2"),
    ]
    assert list(experiment.tables)[2:] == ["rate_of_a_1", "rate_of_c"]
    panels = experiment.figures["scatter"].panels
    assert [(panel.title, panel.x.label) for panel in panels] == [
        (r"$\sigma$ = 0.1", "$a_1$"),
        (r"$\sigma$ = 0.2", "$a_1$"),
    ]


def test_every_value(plan):
    experiment = plan("All coefficients").experiment
    assert experiment.metrics["error"].of == experiment.tables["errors"].of == ("a_1", "a_2", "b_1", "b_2")


def test_plugins(plan):
    assert plan("A method of my own").units[0].metric_labels == ("mean mean",)
