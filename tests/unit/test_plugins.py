import os
import pickle
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from hident import plugins
from hident.config.spec import Of, canonical, components
from hident.engine.experiment import load
from hident.errors import ConfigError
from hident.estimators.base import EstimatorSpec
from hident.records import Record
from tests.forked import run_forked

PLUGIN = '''
import numpy as np

from hident.config.spec import Real, component
from hident.estimators.base import EstimatorSpec
from hident.records import Estimate


@component("estimator", "{kind}", source="Nobody 2001")
class Mean(EstimatorSpec):
    """The mean of the output, whatever the input."""

    scale: Real = 1.0
    """Factor."""

    def names(self):
        return ["mean"]

    def fit(self, record, rng):
        return Estimate(values={{"mean": self.scale * float(np.mean(record.y))}})
'''
CONFIG = """\
version: 1
title: A plugin's estimator
trials: 2
samples: 20
system: {kind: hammerstein, nonlinearity: identity, linear: {kind: fir, b: [1]}}
excitation: {kind: iid, distribution: uniform, low: 0, high: 1}
estimators: {mean: {kind: plugin_mean, scale: 2}}
metrics: {mean: {kind: value, of: [mean]}}
"""


@pytest.fixture(autouse=True)
def _own_register(monkeypatch):
    """What a test registers is forgotten after it."""
    plugins.load()
    register = {family: dict(components(family)) for family in ("estimator", "metric", "system")}
    from hident.config import spec

    monkeypatch.setattr(spec, "_REGISTER", {**spec._REGISTER, **register})
    before = set(sys.modules)
    yield
    # A library that is loaded meanwhile stays: parts of numpy cannot be loaded twice.
    libraries = {name.partition(".")[0] for name in before} | {"scipy", "pandas"} | sys.stdlib_module_names
    for name in set(sys.modules) - before:
        if name.partition(".")[0] not in libraries:
            del sys.modules[name]


def refused(*files):
    with pytest.raises(ConfigError) as caught:
        plugins.load(files)
    return str(caught.value)


def test_a_file_adds_an_estimator(tmp_path):
    (tmp_path / "mine.py").write_text(PLUGIN.format(kind="plugin_mean"))
    (tmp_path / "a.yaml").write_text(CONFIG)
    plugins.load([tmp_path / "mine.py"])
    plugins.load([tmp_path / "mine.py"])
    plan = load(tmp_path / "a.yaml")
    assert canonical(plan.units[0].estimator) == {"kind": "plugin_mean", "scale": 2.0}
    assert components("estimator")["plugin_mean"].summary() == "The mean of the output, whatever the input."


class TestFilesThatAConfigurationNames:
    def test_are_beside_it(self, tmp_path):
        folder = tmp_path / "study"
        folder.mkdir()
        (folder / "mine.py").write_text(PLUGIN.format(kind="plugin_mean"))
        (folder / "a.yaml").write_text(CONFIG + "plugins: [mine.py]\n")
        plan = load(folder / "a.yaml")
        assert canonical(plan.units[0].estimator) == {"kind": "plugin_mean", "scale": 2.0}
        assert plan.plugin_files == (folder / "mine.py",)

    def test_count_for_the_keys_as_files_of_the_command_line_do(self, tmp_path):
        (tmp_path / "mine.py").write_text(PLUGIN.format(kind="plugin_mean"))
        (tmp_path / "a.yaml").write_text(CONFIG + "plugins: [mine.py]\n")
        (tmp_path / "b.yaml").write_text(CONFIG)
        ours = [unit.keys(1) for unit in load(tmp_path / "a.yaml").units]
        assert ours == [unit.keys(1) for unit in load(tmp_path / "b.yaml").units]

    @pytest.mark.parametrize(
        ("written", "message"),
        [
            ("[mien.py]", "plugins[0]: there is no file {folder}/mien.py; did you mean 'mine.py'?"),
            (
                "[mine.py]",
                "plugins[0]: plugin {folder}/mine.py cannot be loaded: ZeroDivisionError: division by zero",
            ),
            ("mine.py", "plugins: must be a list (got 'mine.py')"),
            ("[3]", "plugins[0]: must be text (got 3)"),
        ],
    )
    def test_messages(self, tmp_path, written, message):
        (tmp_path / "mine.py").write_text("1 / 0\n")
        config = CONFIG.replace("plugin_mean, scale: 2", "instrumental_variables, order: 1, instrument: abs")
        (tmp_path / "a.yaml").write_text(config.replace("[mean]", "[a_1]") + f"plugins: {written}\n")
        with pytest.raises(ConfigError) as caught:
            load(tmp_path / "a.yaml")
        assert str(caught.value) == f"{tmp_path}/a.yaml:9: {message.format(folder=tmp_path)}"


def test_the_command_line_lists_and_validates_with_it(tmp_path):
    # No test registers it in this process.
    (tmp_path / "mine.py").write_text(PLUGIN.format(kind="plugin_listed"))
    (tmp_path / "a.yaml").write_text(CONFIG.replace("plugin_mean", "plugin_listed"))

    def hident(*arguments):
        return run_forked(arguments, tmp_path)

    shown = hident("list", "estimators", "plugin_listed", "--plugin", "mine.py")
    assert shown.stdout.splitlines() == [
        "plugin_listed: The mean of the output, whatever the input.",
        "source: Nobody 2001",
        "",
        "key    holds   default  meaning",
        "scale  number  1.0      Factor.",
    ]
    assert hident("validate", "a.yaml", "--plugin", "mine.py").stdout == (
        "a.yaml: fine: 1 case, 1 estimate of 2 trials\n"
    )
    without = hident("validate", "a.yaml")
    assert without.returncode == 2
    assert without.stderr.startswith("error: a.yaml:7: estimators.mean.kind: unknown estimator (allowed: ")


def test_files_of_one_name_in_two_folders(tmp_path):
    for kind in ("one", "two"):
        (tmp_path / kind).mkdir()
        (tmp_path / kind / "mine.py").write_text(PLUGIN.format(kind=f"plugin_{kind}"))
    plugins.load([tmp_path / "one" / "mine.py", tmp_path / "two" / "mine.py"])
    assert {"plugin_one", "plugin_two"} <= set(components("estimator"))


def test_an_installed_plugin_is_found_by_its_entry_point(tmp_path, monkeypatch):
    (tmp_path / "some_installed_plugin.py").write_text(PLUGIN.format(kind="plugin_installed"))
    monkeypatch.syspath_prepend(tmp_path)
    point = EntryPoint("mine", "some_installed_plugin", plugins.GROUP)
    monkeypatch.setattr(plugins, "entry_points", lambda group: [point] if group == "hident.plugins" else [])
    plugins.load()
    assert "plugin_installed" in components("estimator")


def test_a_broken_installed_plugin_is_named(monkeypatch):
    point = EntryPoint("mine", "no_such_module:thing", plugins.GROUP)
    monkeypatch.setattr(plugins, "entry_points", lambda group: [point])
    assert refused() == (
        "plugin 'mine' (no_such_module:thing) cannot be loaded: "
        "ModuleNotFoundError: No module named 'no_such_module'"
    )


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("missing.py", None, ": no such file"),
        ("mine.txt", "", ": is not a Python file"),
        ("mine.py", "1/0", " cannot be loaded: ZeroDivisionError: division by zero"),
        ("mine.py", "import sys; sys.exit('enough')", " cannot be loaded: SystemExit: enough"),
        ("mine.py", "def f(:", " cannot be loaded: SyntaxError: invalid syntax (mine.py, line 1)"),
        (
            "mine.py",
            PLUGIN.format(kind="kernel"),
            " cannot be loaded: ValueError: estimator 'kernel' is already defined in "
            "hident.estimators.nonparametric.kernel",
        ),
    ],
)
def test_a_file_that_cannot_be_loaded(tmp_path, name, text, message):
    path = tmp_path / name
    if text is not None:
        path.write_text(text)
    assert refused(path) == f"plugin {path}{message}"


def test_all_that_cannot_be_loaded_is_told_and_the_rest_is_loaded(tmp_path):
    (tmp_path / "good.py").write_text(PLUGIN.format(kind="plugin_good"))
    (tmp_path / "bad.py").write_text("x")
    files = [tmp_path / "none.py", tmp_path / "good.py", tmp_path / "bad.py"]
    assert refused(*files).splitlines() == [
        f"plugin {tmp_path}/none.py: no such file",
        f"plugin {tmp_path}/bad.py cannot be loaded: NameError: name 'x' is not defined",
    ]
    assert "plugin_good" in components("estimator")


def test_a_file_that_failed_is_tried_again(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text("1/0")
    assert "ZeroDivisionError" in refused(path)
    path.write_text(PLUGIN.format(kind="plugin_again"))
    plugins.load([path])
    assert "plugin_again" in components("estimator")


@pytest.mark.parametrize("edited", ["mine.py", "helper.py"])
def test_an_edit_that_keeps_the_size_and_the_time_of_a_file_is_seen(tmp_path, monkeypatch, edited):
    def write(text):
        (tmp_path / edited).write_text(text)
        # The clock may stand for longer than an edit takes.
        os.utime(tmp_path / edited, (0, 0))

    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    (tmp_path / "mine.py").write_text("import helper")
    write("1/0")
    assert "ZeroDivisionError" in refused(tmp_path / "mine.py")
    write("1/1")
    plugins.load([tmp_path / "mine.py"])


HELPED = PLUGIN.replace(
    "import numpy as np", "import numpy as np\nimport {helper}\nfrom helpers.inner import FACTOR"
)
HELPED = HELPED.replace("self.scale *", "FACTOR * {helper}.SCALE * self.scale *")


def helped(folder, kind, scale, helper="helper"):
    """A plugin with neighbours: a file, and a file in a folder, which imports the first in turn."""
    (folder / "helpers").mkdir(parents=True)
    (folder / f"{helper}.py").write_text(f"SCALE = {scale}\n")
    (folder / "helpers" / "inner.py").write_text(f"from {helper} import SCALE\n\nFACTOR = 10 * SCALE\n")
    (folder / "mine.py").write_text(HELPED.format(kind=kind, helper=helper))
    return folder / "mine.py"


def estimated(kind):
    spec = Of("estimator").validate(kind)
    assert isinstance(spec, EstimatorSpec)
    found = spec.fit(Record(np.zeros(2), np.ones(2)), np.random.default_rng(0))
    return found.values["mean"]


def test_a_file_may_import_its_neighbours(tmp_path):
    path = list(sys.path)
    plugins.load([helped(tmp_path, "plugin_helped", 2)])
    assert estimated("plugin_helped") == 10 * 2 * 2
    assert sys.path == path
    assert "helper" not in sys.modules


def test_neighbours_of_one_name_do_not_mix(tmp_path):
    files = [helped(tmp_path / kind, kind, scale) for kind, scale in (("plugin_a", 2), ("plugin_b", 3))]
    plugins.load(files)
    assert (estimated("plugin_a"), estimated("plugin_b")) == (40, 90)


@pytest.mark.parametrize("helper", ["numpy_helper", "yaml", "scipy"])
def test_a_neighbour_may_have_the_name_of_an_installed_library(tmp_path, helper):
    plugins.load([helped(tmp_path, "plugin_named", 2, helper)])
    assert estimated("plugin_named") == 40
    assert not hasattr(sys.modules.get(helper), "SCALE")


def test_the_standard_library_and_hident_itself_are_no_neighbours(tmp_path):
    (tmp_path / "signal.py").write_text("1/0")
    (tmp_path / "hident").symlink_to(Path(plugins.__file__).parent)
    (tmp_path / "mine.py").write_text("import signal\n" + PLUGIN.format(kind="plugin_beside"))
    plugins.load([tmp_path / "mine.py"])
    assert issubclass(components("estimator")["plugin_beside"], EstimatorSpec)


def test_a_neighbour_that_everybody_can_import_is_one_module(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "plugin_shared.py").write_text("SEEN = []\n")
    (tmp_path / "mine.py").write_text("import plugin_shared\nplugin_shared.SEEN.append(1)\n")
    plugins.load([tmp_path / "mine.py"])
    assert sys.modules["plugin_shared"].SEEN == [1]


def test_a_broken_neighbour_is_named_and_tried_again(tmp_path):
    file = helped(tmp_path, "plugin_mended", 2)
    (tmp_path / "helper.py").write_text("1/0")
    assert refused(file) == f"plugin {file} cannot be loaded: ZeroDivisionError: division by zero"
    (tmp_path / "helper.py").write_text("SCALE = 4\n")
    plugins.load([file])
    assert estimated("plugin_mended") == 160


def test_classes_of_neighbours_can_be_sent_to_workers(tmp_path):
    (tmp_path / "other.py").write_text(PLUGIN.format(kind="plugin_other"))
    (tmp_path / "mine.py").write_text("import other\n")
    plugins.load([tmp_path / "mine.py"])
    spec = Of("estimator").validate({"kind": "plugin_other", "scale": 3})
    assert pickle.loads(pickle.dumps(spec)) == spec


def test_workers_find_the_neighbours_and_an_edit_of_one_is_computed_anew(lab):
    lab.probe("value *= neighbour.FACTOR")
    folder = lab.folder / "plugins"
    folder.mkdir()
    text = (lab.folder / "probe.py").read_text()
    (lab.folder / "probe.py").unlink()
    (folder / "probe.py").write_text("import neighbour\n" + text)
    (folder / "neighbour.py").write_text("FACTOR = 1.0\n")
    lab.run("--jobs", "2", "--plugin", "plugins/probe.py")
    before = lab.table
    (folder / "neighbour.py").write_text("FACTOR = 2.0\n")
    lab.run("--jobs", "2", "--plugin", "plugins/probe.py")
    assert lab.table != before


COMPONENT = "from hident.config.spec import component\n"
SHOWN = '''
from hident.reports.base import FigureSpec, Table, TableSpec
from hident.reports.style import subplots

WIDTH = 3.0


@component("table", "{name}")
class Shown(TableSpec):
    """The first value."""

    def build(self, results, verdicts):
        return Table(self.title, ("value",), ((f"{{results.series[0].values[0]:.3f}}",),))


@component("figure", "{name}")
class Drawn(FigureSpec):
    """The first values."""

    def draw(self, results, verdicts):
        figure, axes = subplots(figsize=(WIDTH, WIDTH))
        axes.plot(results.series[0].values)
        return figure
'''


@pytest.mark.parametrize("file", ["probe.py", "shown.py"])
def test_an_edited_table_or_figure_of_a_plugin_computes_no_trial(lab, file):
    lab.probe()
    name = file.removesuffix(".py")
    text = SHOWN.format(name=name)
    before = (lab.folder / "probe.py").read_text() if file == "probe.py" else COMPONENT
    (lab.folder / file).write_text(before + text)
    lab.configure(
        tables={"shown": {"kind": name, "title": "First"}},
        figures={"drawn": name},
        plugins=["shown.py"] if file == "shown.py" else [],
    )
    assert "tiny: 24 trials\n" in lab.run()
    kept = lab.trials()
    for old, new in {":.3f": ":.1f", "WIDTH = 3.0": "WIDTH = 2.0", "axes.plot(": "axes.semilogy("}.items():
        assert old in text
        text = text.replace(old, new)
    (lab.folder / file).write_text(before + text)
    said = lab.run()
    assert "tiny: all 24 trials are stored\n" in said
    assert "tiny: wrote " in said
    assert lab.trials() == kept
    # What else stands there counts: the system of all trials.
    edited = (lab.folder / "probe.py").read_text().replace("u**2", "u**3")
    (lab.folder / "probe.py").write_text(edited)
    assert "tiny: 24 trials\n" in lab.run()
