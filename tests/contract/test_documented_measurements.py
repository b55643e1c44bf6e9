"""docs/measurements.md: its commands run in their order, and its code; what it says of fields is so."""

from __future__ import annotations

import json
import re
import shlex
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml

import hident as hi
from hident import plugins
from hident.config.spec import components
from hident.engine.runner import run
from hident.errors import EstimationError
from hident.identification.candidates import STRUCTURES
from hident.metrics.residuals import ResidualTest
from hident.reports.output import Outputs, check
from tests.documented import ROOT, blocks
from tests.forked import run_forked
from tests.octave import needs_octave
from tests.unit.plans import planned
from tests.unit.test_simulink import octave

if TYPE_CHECKING:
    from pathlib import Path

PAGE = "docs/measurements.md"
TEXT = (ROOT / PAGE).read_text(encoding="utf-8")
COMMANDS = [line for block in blocks(PAGE, "sh") for line in block.splitlines()]
# What the test adds: one structure, which this record has, as all of them take too long.
ADDED = {"identify": ("--structure", "hammerstein")}
TANK = hi.Hammerstein(
    nonlinearity=hi.Polynomial(coefficients=[0, 1, 0.3]), linear=hi.Arma(a=[0.8], b=[0, 0.2])
)


def _write_records(folder: Path) -> None:
    """Two records of a tank, in the columns of the benchmark, and one with a column of times."""
    rng = np.random.default_rng(11)
    u = np.repeat(rng.uniform(0.5, 3, (80, 2)), 5, axis=0)
    y = np.column_stack([TANK.simulate(one) for one in u.T]) + 0.01 * rng.standard_normal((400, 2))
    columns = np.column_stack([u, y])
    np.savetxt(folder / "tanks.csv", columns, delimiter=",", header="uEst,uVal,yEst,yVal", comments="")
    np.savetxt(folder / "heating.dat", np.column_stack([2.0 * np.arange(400), u[:, 0], y[:, 0]]))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder after all commands of the page, each of which ends well."""
    folder = tmp_path_factory.mktemp("measurements")
    _write_records(folder)
    for command in COMMANDS:
        _, verb, *options = shlex.split(command)
        ended = run_forked((verb, *options, *ADDED.get(verb, ())), folder)
        assert ended.returncode == 0, (command, ended.stdout, ended.stderr)
        (folder / f"{verb}.txt").write_text(ended.stdout, encoding="utf-8")
    return folder


def test_the_commands_lead_from_a_file_to_a_model_elsewhere(folder: Path) -> None:
    verbs = [command.split()[1] for command in COMMANDS[:5]]
    assert verbs == ["show", "identify", "simulate", "convert", "convert"]
    assert json.loads((folder / "tanks/model.json").read_text(encoding="utf-8"))
    assert "fit" in (folder / "simulate.txt").read_text(encoding="utf-8")
    table = (folder / "identify.txt").read_text(encoding="utf-8")
    names = (
        "structure",
        "blocks",
        "parameters",
        "fitted",
        "kept apart",
        "fit %",
        "AIC",
        "BIC",
        "agreeing",
        "chosen",
    )
    assert all(name in table for name in names)
    written = {path.name for path in (folder / "tanks").iterdir()}
    assert {"model.json", "table.md", "kept_apart.png", "experiment.yaml"} <= written


@needs_octave
def test_the_matlab_function_gives_the_response_of_the_model(folder: Path) -> None:
    program = "u = linspace(0, 3, 50)'; y = tank_response(u); printf('%.17g\\n', y);"
    found = octave(folder, program)
    expected = hi.load_model(folder / "tanks/model.json").simulate(np.linspace(0, 3, 50))
    np.testing.assert_allclose(list(map(float, found)), expected, rtol=0, atol=1e-12)


@needs_octave
def test_the_function_for_simulink_builds_the_model(folder: Path) -> None:
    [line] = octave(folder, "tank(0.5); printf('%.17g ', simulated(linspace(0.5, 3, 50)));")
    expected = hi.load_model(folder / "tanks/model.json").simulate(np.linspace(0.5, 3, 50))
    np.testing.assert_allclose(np.fromstring(line, sep=" "), expected, rtol=0, atol=1e-9)


def test_offsets_stay_with_the_model(folder: Path) -> None:
    model = hi.load_model(folder / "level/model.json")
    assert all(model.offsets)
    space: dict[str, Any] = {}
    exec((folder / "level_response.py").read_text(encoding="utf-8"), space)
    u = np.linspace(0.5, 3, 50)
    np.testing.assert_allclose(space["response"](u), model.simulate(u), rtol=0, atol=1e-9)


def test_the_code_runs(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("control")
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(folder)
    space: dict[str, Any] = {}
    first, *others = blocks(PAGE, "python")
    exec(first, space)
    expected = hi.load_model("tanks/model.json").simulate(space["u"])
    np.testing.assert_allclose(space["y"], expected, rtol=0, atol=1e-9)
    for code in others:
        exec(code, space)
    assert space["blocks"][0].dt == 4.0
    np.testing.assert_allclose(space["y"], space["model"].simulate(space["record"]), rtol=0, atol=1e-9)


def test_the_chain_of_blocks_is_a_configuration(folder: Path) -> None:
    whole, *_ = [text for text in blocks(PAGE, "yaml") if text.startswith("version")]
    plan = planned(folder, whole)
    values = {series.metric: series.values[0] for series in run(plan).series}
    assert values["linear a_1"] == pytest.approx(0.8, abs=5 * values["linear se_a_1"])
    assert values["fit"] > 95
    assert Outputs(plan, folder / "out").write(run(plan), {}) == ()
    [bootstrap] = [text for text in blocks(PAGE, "yaml") if "bootstrap" in text]
    resampled = {**yaml.safe_load(whole), **yaml.safe_load(bootstrap)}
    resampled["metrics"]["fit"] = {"kind": "fit_index", "n_init": 20}
    plan = planned(folder, yaml.safe_dump(resampled), trials=2)
    assert all(np.isfinite(series.values).all() for series in run(plan).series)


@pytest.mark.parametrize("part", ["kind: candidates", "kind: bands"])
def test_what_is_added_to_the_configuration_is_drawn(folder: Path, part: str) -> None:
    whole, *_ = [text for text in blocks(PAGE, "yaml") if text.startswith("version")]
    [added] = [text for text in blocks(PAGE, "yaml") if part in text]
    # PyYAML reads on as true.
    sections = [yaml.safe_load(re.sub(r"\bon: ", '"on": ', text)) for text in (whole, added)]
    plan = planned(folder, yaml.safe_dump({**sections[0], **sections[1]}))
    check(plan)
    out = folder / part.removeprefix("kind: ")
    assert Outputs(plan, out).write(run(plan), {}) == ()
    [page] = out.rglob("table.md")
    assert ("chosen |" in page.read_text(encoding="utf-8")) == (part == "kind: candidates")
    assert bool([*out.rglob("bands.png")]) == (part == "kind: bands")


def test_other_blocks_are_found_as_the_page_says(folder: Path) -> None:
    _, continuous, own = [text for text in blocks(PAGE, "yaml") if text.startswith("version")]
    found = {
        series.metric: np.asarray(series.values)
        for series in run(planned(folder, continuous, trials=3)).series
    }
    assert np.all(np.abs(found["error a_1"]) < 0.1)
    assert set(found) >= {"covered a_3", "covered b_1"}
    own_plan = planned(folder, own, trials=3)
    responses = {series.unit.name: np.asarray(series.values) for series in run(own_plan).series}
    # Who knows the form needs four numbers, and else it takes twelve that cannot quite be it.
    assert np.all(responses["form"] < 1.5)
    assert np.all(responses["Hermite functions"] < 10.0)


def test_what_stands_in_the_tables_is_there() -> None:
    plugins.load()
    rows = dict(re.findall(r"^\| `(\w+)` \| (L|N-L|L-N|L-N-L|N-L-N) \|", TEXT, re.MULTILINE))
    assert rows == dict(STRUCTURES)
    named = re.search(r"Static ones\s+are (.*?); beyond.*?lines\. (.*?) are sums", TEXT, re.DOTALL)
    assert named
    static = {*re.findall(r"`(\w+)`", f"{named[1]} {named[2]}")}
    assert static | {"linear", "continuous"} == {*components("block")}
    assert {"rmse", "nrmse", "r_squared", "mae", "fit_index"} < {*components("metric")}
    assert len(ResidualTest.model_fields["of"].annotation.__args__) == 5  # type: ignore[union-attr]


def test_two_static_blocks_side_by_side_are_refused() -> None:
    square = hi.PolynomialBlock(degree=2)
    with pytest.raises(hi.ConfigError, match="blocks 1 and 2 are both static"):
        hi.PredictionError(blocks=[square, square, hi.LinearBlock(nb=1)])


def test_an_input_of_three_levels_tells_three_values() -> None:
    u = np.random.default_rng(1).choice([-1.0, 0.5, 2.0], 300)
    record = hi.Record(u, TANK.simulate(u))
    blocks_of = [hi.PolynomialBlock(degree=4), hi.LinearBlock(nb=1, nf=1, nk=1)]
    with pytest.raises(EstimationError, match="it has 3 levels"):
        hi.fit(hi.PredictionError(blocks=blocks_of), record)


def test_every_configuration_that_is_named_is_there() -> None:
    named = re.findall(r"`(?:configs/)?((?:data|pem|judged)_\w+?)(?:\.yaml)?`", TEXT)
    assert named
    assert all((ROOT / "configs" / f"{name}.yaml").is_file() for name in named)
    anchors = {
        re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-")
        for title in re.findall(r"^##+ (.*)$", TEXT, re.M)
    }
    assert {*re.findall(r"\]\(#([\w-]+)\)", TEXT)} <= anchors
