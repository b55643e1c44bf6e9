"""Inputs that cannot work are refused before a trial runs."""

from pathlib import Path

import pytest

from hident import plugins
from hident.engine.experiment import load
from hident.engine.preflight import check_records
from hident.errors import ConfigError

CONFIG = """\
version: 1
title: t
trials: 3
samples: 100
system:
  kind: {system}
  nonlinearity: {{kind: polynomial, coefficients: [0, 1, 2]}}
  linear: {{kind: fir, b: [0, 1, 2]}}
excitation: {excitation}
estimators:
  tsa: {{kind: two_stage, lags: 2, degree: 2}}
  {other}
metrics:
  v: {{kind: value, of: [b_1], estimators: [tsa]}}
  b: {{kind: value, of: [se_b_1], estimators: [other]}}
"""
BOUND = "other: {kind: cramer_rao, lags: 2, degree: 2, variance: 1}"


def plan(folder: Path, excitation: str, *, system: str = "hammerstein", other: str = BOUND):
    plugins.load()
    path = folder / "c.yaml"
    path.write_text(CONFIG.format(excitation=excitation, system=system, other=other))
    return load(path)


def test_an_irregular_input_passes(tmp_path):
    check_records(plan(tmp_path, "{kind: iid, distribution: gaussian, std: 1}"))


@pytest.mark.parametrize(
    ("excitation", "message"),
    [
        (
            "{kind: prbs, order: 7}",
            "the input takes 2 different values, and 2 basis functions over 2 lags need",
        ),
        ("{kind: staircase, levels: [1], hold: 100}", "linearly dependent"),
    ],
)
def test_a_poor_input_is_refused_with_its_line(tmp_path, excitation, message):
    with pytest.raises(ConfigError) as caught:
        check_records(plan(tmp_path, excitation))
    first, second = str(caught.value).splitlines()
    assert first.startswith(
        f"{tmp_path}/c.yaml:11: estimators.tsa: the input cannot tell the parameters apart: "
    )
    assert second.startswith(f"{tmp_path}/c.yaml:12: estimators.other: ")
    assert message in first


def test_a_bound_needs_a_system_with_its_parts(tmp_path):
    with pytest.raises(ConfigError) as caught:
        plan(tmp_path, "{kind: iid, distribution: gaussian, std: 1}", system="wiener_hammerstein")
    assert "input_linear" in str(caught.value)
    wh = CONFIG.replace(
        "  linear: {{kind: fir, b: [0, 1, 2]}}",
        "  input_linear: {{kind: fir, b: [1]}}\n  output_linear: {{kind: fir, b: [1]}}",
    )
    path = tmp_path / "wh.yaml"
    path.write_text(wh.format(excitation="{kind: prbs, order: 3}", system="wiener_hammerstein", other=BOUND))
    with pytest.raises(
        ConfigError,
        match=r"estimators.other: the estimator 'cramer_rao' needs the linear of the system, which "
        r"'wiener_hammerstein' does not have \(it has: ",
    ):
        load(path)
