"""hident show for one trial of a configuration, and the exports of what is made again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.image import imread
from matplotlib.text import Text

import hident as hi
from hident import plugins
from hident.engine.experiment import load
from hident.engine.replay import OneTrial
from hident.reports.trial_figure import trial_figure

if TYPE_CHECKING:
    from tests.conftest import Lab

plugins.load()


@pytest.fixture(scope="module")
def done(make_lab: Callable[[Path], Lab], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    lab = make_lab(tmp_path_factory.mktemp("shown"))
    lab.run("-q")
    lab.hident("export", "tiny.yaml", "values.csv")
    yield lab
    lab.end()


def _show(lab: Lab, *arguments: str, code: int = 0) -> str:
    return lab.hident("show", "tiny.yaml", *arguments, code=code).stdout


def _error(lab: Lab, *arguments: str, code: int = 2) -> str:
    return lab.hident("show", *arguments, code=code).stderr.removeprefix("error: ").strip()


@pytest.fixture(scope="module")
def values(done: Lab) -> pd.DataFrame:
    return pd.read_csv(done.folder / "values.csv")


@pytest.mark.parametrize("trial", [0, 3, 5])
@pytest.mark.parametrize("samples", [50, 80])
def test_a_trial_is_exactly_that_of_the_run(
    done: Lab, values: pd.DataFrame, trial: int, samples: int
) -> None:
    said = _show(done, "--trial", str(trial), "--case", f"samples={samples}").splitlines()
    number = {50: 1, 80: 2}[samples]
    folder = done.folder / f"out/tiny/trial-{trial}/case-{number}_samples_{samples}"
    assert said[0] == f"tiny: trial {trial} at samples {samples}, seed 7"
    assert said[-1] == (
        f"{folder.relative_to(done.folder)}: record.csv, estimates.csv, scores.csv, trial.png"
    )
    assert "not stored" not in "".join(said)
    scores = pd.read_csv(folder / "scores.csv")
    stored = values.query("trial == @trial and samples == @samples")
    assert scores["value"].to_list() == stored["value"].to_list()
    assert scores["estimator"].to_list() == ["known", "iv"]
    plan = load(done.folder / "tiny.yaml")
    realised = OneTrial(plan, trial).of("iv", {"samples": samples})
    assert realised.record is not None
    record = pd.read_csv(folder / "record.csv")
    np.testing.assert_array_equal(record["input"], realised.record.u)
    np.testing.assert_array_equal(record["output"], realised.record.y)
    assert 0.0 < np.abs(record["output"] - record["noise_free"]).max() <= 0.1
    estimates = pd.read_csv(folder / "estimates.csv")
    pole = estimates.query("estimator == 'iv' and name == 'a_1'").iloc[0]
    assert realised.found is not None
    assert (pole["value"], pole["true"], pole["part"]) == (realised.found.values["a_1"], 0.8, "parameter")
    assert set(estimates["part"]) == {"parameter", "step_response", "gain", "phase"}
    assert imread(folder / "trial.png").shape[0] > 500


def test_another_folder_one_estimator_and_parquet(done: Lab) -> None:
    said = _show(done, "--estimator", "iv", "--out", "mine", "--parquet").splitlines()
    assert said[0] == "tiny: trial 0 at samples 50, seed 7"
    assert said[-1] == "mine: record.parquet, estimates.parquet, scores.parquet, trial.png"
    assert set(pd.read_parquet(done.folder / "mine/estimates.parquet")["estimator"]) == {"iv"}
    assert len(pd.read_parquet(done.folder / "mine/record.parquet")) == 50


def test_the_worst_and_the_best_are_found(done: Lab, values: pd.DataFrame) -> None:
    iv = values[values["estimator"] == "iv"]
    for option, of in (("--worst", np.argmax), ("--best", np.argmin)):
        row = iv.iloc[int(of(iv["value"].abs()))]
        said = _show(done, option, "a a_1", "--estimator", "iv").splitlines()
        assert said[0] == (
            f"a a_1 is {option[2:]} in trial {row['trial']} of estimator 'iv' at samples {row['samples']}"
        )
        assert said[1] == f"tiny: trial {row['trial']} at samples {row['samples']}, seed 7"
    iv80 = iv[iv["samples"] == 80]
    worst = iv80.iloc[int(np.argmax(iv80["value"].abs()))]
    found = _show(done, "--worst", "a a_1", "--case", "samples=80", "--estimator", "iv")
    assert f"trial {worst['trial']} of estimator 'iv' at samples 80" in found


def test_of_a_signed_error_the_share_counts_moduli(done: Lab) -> None:
    for option, share in (("--worst", "83 % by modulus"), ("--best", "0 % by modulus")):
        [row] = [
            line for line in _show(done, option, "a a_1", "--estimator", "iv").splitlines() if "iv  " in line
        ]
        assert share in row


def test_of_a_fit_the_least_is_worst(lab: Lab) -> None:
    two_stage = {"kind": "two_stage", "lags": 3, "degree": 3}
    lab.configure(
        estimators={"tsa": two_stage}, metrics={"fit": "fit_index"}, cases={"samples": [50]}, tables={}
    )
    lab.configure(system={**lab.config["system"], "linear": {"kind": "fir", "b": [1, 0.5]}})
    lab.run("-q")
    lab.hident("export", "tiny.yaml", "values.csv")
    found = pd.read_csv(lab.folder / "values.csv").set_index("trial")["value"]
    assert f"in trial {found.idxmin()} of" in _show(lab, "--worst", "fit")
    assert f"in trial {found.idxmax()} of" in _show(lab, "--best", "fit")


def test_what_failed_is_listed_and_shown(lab: Lab) -> None:
    silent = {**lab.config["system"], "nonlinearity": {"kind": "expression", "expression": "0*u"}}
    lab.configure(system=silent, noise=[])
    lab.run("-q")
    lines = _show(lab, "--failed").splitlines()
    assert lines[0].split() == ["estimator", "case", "trial", "reason"]
    # Long reasons go on in the next lines.
    rows = [line for line in lines[1:-1] if line.startswith("iv ")]
    assert len(rows) == 12
    assert rows[0].split(maxsplit=4)[:4] == ["iv", "samples", "50", "0"]
    example = "hident show tiny.yaml --trial 0 --estimator iv --case samples=50"
    assert lines[-1] == f"one of them: {example}"
    assert "iv failed" in lab.hident(*example.split()[1:]).stdout
    assert "none of the 6 stored trials failed" in _show(lab, "--failed", "--estimator", "known")
    for option in ("--worst", "--best"):
        assert _error(lab, "tiny.yaml", option, "a a_1", "--estimator", "iv", code=4) == (
            "a a_1 is a number in none of the 12 stored trials: hident show tiny.yaml --failed says why"
        )
    said = _show(lab, "--trial", "0", "--estimator", "iv")
    assert "iv failed: Psi'Phi is singular" in said
    assert (lab.folder / "out/tiny/trial-0/case-1_samples_50/trial.png").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--estimator", "ivv"], "--estimator: there is no estimator 'ivv'; did you mean 'iv'? "),
        (["--case", "sample=50"], "--case sample=50: there is no axis 'sample'; did you mean 'samples'? "),
        (
            ["--case", "samples=60"],
            "--case samples=60: there is no label of samples '60' (there are: 50, 80)",
        ),
        (["--case", "samples"], "--case samples: must be AXIS=LABEL"),
        (
            ["--case", "samples=50", "--case", "samples=80"],
            "--case samples=80: samples=50 is given already, and one case is shown",
        ),
        (["--worst", "a"], "--worst: there is no metric 'a' (there are: a a_1)"),
        (["--worst", "a a_1", "--trial", "3"], "--trial and --worst cannot stand together: each names what "),
        (["--input", "u"], "tiny.yaml is a configuration, and --input is for measured records"),
    ],
)
def test_what_is_not_there_is_named(done: Lab, arguments: list[str], said: str) -> None:
    assert _error(done, "tiny.yaml", *arguments).startswith(said)


def test_what_is_for_a_configuration_is_refused_for_others(done: Lab) -> None:
    (done.folder / "u.csv").write_text("u,y\n1,2\n")
    assert (
        _error(done, "u.csv", "--trial", "3")
        == "u.csv is no configuration, and --trial is for configurations"
    )
    assert "there is no such file" in _error(done, "tinyy") or "tinyy" in _error(done, "tinyy")


def test_nothing_stored(lab: Lab) -> None:
    assert _error(lab, "tiny.yaml", "--worst", "a a_1", code=4) == (
        "no trial with a a_1 is stored: hident run tiny"
    )
    assert _error(lab, "tiny.yaml", "--failed", code=4) == "no trial is stored: hident run tiny"
    assert _show(lab, "--trial", "2").count("not stored") == 2


def test_a_stored_value_that_is_another_is_said(lab: Lab) -> None:
    lab.probe()
    lab.run("-q")
    # A component whose result depends on what its code does not show.
    source = lab.folder / "probe.py"
    body = source.read_text().replace("value = float(", "value = float(Path('moved').exists() + ")
    source.write_text(body)
    lab.forget()
    lab.run("-q")
    (lab.folder / "moved").touch()
    said = lab.hident("show", "tiny.yaml", "--plugin", "probe.py", code=1).stdout
    assert "the scores differ from those that the run stored, which must not be: hident doctor" in said


def test_a_crash_is_one_line(lab: Lab) -> None:
    lab.probe("raise TypeError('no')")
    said = _error(lab, "tiny.yaml", "--plugin", "probe.py", "--estimator", "probe", code=3)
    assert said == "trial 0 of estimator 'probe' at samples 50 crashed: TypeError: no"


def test_what_is_shown_is_no_output_of_the_run(done: Lab) -> None:
    _show(done, "--trial", "1")
    assert "up to date" in done.hident("status", "tiny.yaml").stdout
    done.hident("accept", "tiny", "-q", "-j1")
    assert "no differences" in done.hident("compare").stdout


def test_records_and_estimates_are_exported(done: Lab) -> None:
    said = done.hident("export", "tiny.yaml", "records.csv", "--what", "records", "--trials", "3").stdout
    assert said == "records.csv: 390 rows of 3 trials, made again from their seeds\n"
    records = pd.read_csv(done.folder / "records.csv")
    plan = load(done.folder / "tiny.yaml")
    for trial, samples in ((0, 80), (2, 50)):
        realised = OneTrial(plan, trial).of("iv", {"samples": samples})
        rows = records.query("trial == @trial and samples == @samples")
        assert realised.record is not None
        np.testing.assert_array_equal(rows["output"], realised.record.y)
    done.hident("export", "tiny.yaml", "estimates.parquet", "--what", "estimates")
    estimates = pd.read_parquet(done.folder / "estimates.parquet")
    poles = estimates.query("estimator == 'iv' and part == 'parameter' and name == 'a_1'")
    values = pd.read_csv(done.folder / "values.csv").query("estimator == 'iv'")
    got = poles.astype({"samples": int}).set_index(["samples", "trial"])["value"] - 0.8
    np.testing.assert_array_equal(
        got.sort_index(), values.set_index(["samples", "trial"])["value"].sort_index()
    )


def test_what_cannot_be_exported(lab: Lab) -> None:
    said = lab.hident("export", "tiny.yaml", "x.csv", "--what", "estimate", code=2).stderr
    assert "'estimate' cannot be exported; did you mean 'estimates'?" in " ".join(said.split())
    noise: dict[str, Any] = {"kind": "white", "std": "$time"}
    cases = {"time": [0.1, 0.2], "case time": {"one": {"samples": 50}}}
    lab.configure(cases=cases, samples=50, noise=noise, tables={})
    said = lab.hident("export", "tiny.yaml", "x.csv", "--what", "records", code=2).stderr
    assert said == (
        "error: tiny.yaml: two columns of an export of records would be 'case time': rename an axis\n"
    )


@pytest.mark.parametrize(("axis", "what"), [("input", "records"), ("x", "estimates")])
def test_an_axis_with_the_name_of_a_column_is_told_from_it(lab: Lab, axis: str, what: str) -> None:
    noise: dict[str, Any] = {"kind": "white", "std": f"${axis}"}
    lab.configure(cases={axis: [0.1, 0.2]}, samples=50, noise=noise, tables={})
    lab.run("-q")
    lab.hident("export", "tiny.yaml", "x.csv", "--what", what)
    rows = pd.read_csv(lab.folder / "x.csv")
    assert set(rows[f"case {axis}"]) == {0.1, 0.2}
    assert rows[axis].nunique() > 2


def test_no_more_estimates_share_a_figure_than_can_be_told_apart(lab: Lab) -> None:
    for count, figures in ((6, "trial.png"), (7, "trial.png, trial-2.png")):
        known = {f"known {i}": {"kind": "known_dynamics", "a": [0.1 * i]} for i in range(count)}
        lab.configure(estimators=known, tables={})
        said = _show(lab, "--trial", "2", "--out", str(count)).splitlines()[-1]
        assert said.endswith(f"scores.csv, {figures}")
        assert sorted(path.name for path in (lab.folder / str(count)).rglob("*.png")) == sorted(
            figures.split(", ")
        )


def test_the_figure_of_a_trial_says_its_number() -> None:
    record = hi.Record(np.arange(3.0), np.arange(3.0))
    texts = [text.get_text() for text in trial_figure(record, None, {}, 17).findobj(Text)]
    assert "trial 17" in texts


def test_each_trial_of_a_bootstrap_has_a_record_of_each_estimator(lab: Lab) -> None:
    rng = np.random.default_rng(3)
    u = rng.normal(size=300)
    y = np.convolve(u, [0.0, 0.5, 0.25])[:300] + 0.1 * rng.normal(size=300)
    pd.DataFrame({"u": u, "y": y}).to_csv(lab.folder / "r.csv", index=False)
    block = {"kind": "linear", "nb": 2, "nf": 0, "nk": 1}
    lab.config = {
        "version": 1,
        "title": "A bootstrap",
        "trials": 3,
        "record": {
            "file": "r.csv",
            "input": "u",
            "output": "y",
            "bootstrap": {"kind": "block", "length": 20},
        },
        "estimators": {
            "linear": {"kind": "prediction_error", "blocks": [block]},
            "cubic": {"kind": "prediction_error", "blocks": [{"kind": "polynomial", "degree": 3}, block]},
        },
        "metrics": {"rmse": "rmse"},
    }
    lab.configure()
    lab.run("-q")
    said = _show(lab, "--trial", "2", "--out", "two").splitlines()
    assert said[-1] == "two: record_linear.csv, record_cubic.csv, estimates.csv, scores.csv, trial.png"
    assert "not stored" not in "".join(said)
    one, other = (pd.read_csv(lab.folder / f"two/record_{name}.csv") for name in ("linear", "cubic"))
    assert (one["input"] == other["input"]).all()
    assert (one["output"] != other["output"]).any()
