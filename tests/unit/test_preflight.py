"""Inputs that cannot work are refused before a trial runs."""

import re
from pathlib import Path

import pytest

from hident.engine.preflight import check_records
from hident.errors import ConfigError
from tests.unit.plans import planned, refusals

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
    return planned(folder, CONFIG.format(excitation=excitation, system=system, other=other))


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
        f"{tmp_path}/a.yaml:11: estimators.tsa: the input cannot tell the parameters apart: "
    )
    assert second.startswith(f"{tmp_path}/a.yaml:12: estimators.other: ")
    assert message in first


def test_a_bound_needs_a_system_with_its_parts(tmp_path):
    with pytest.raises(ConfigError) as caught:
        plan(tmp_path, "{kind: iid, distribution: gaussian, std: 1}", system="wiener_hammerstein")
    assert "input_linear" in str(caught.value)
    wh = CONFIG.replace(
        "  linear: {{kind: fir, b: [0, 1, 2]}}",
        "  input_linear: {{kind: fir, b: [1]}}\n  output_linear: {{kind: fir, b: [1]}}",
    )
    text = wh.format(excitation="{kind: prbs, order: 3}", system="wiener_hammerstein", other=BOUND)
    (line,) = refusals(tmp_path, text)
    assert (
        "estimators.other: the estimator 'cramer_rao' needs the linear of the system, which "
        "'wiener_hammerstein' does not have (it has: "
    ) in line


HAMMERSTEIN = """\
version: 1
title: t
trials: 2
samples: {samples}
dt: {dt}
system:
  kind: hammerstein
  nonlinearity: chen_type_1
  linear: {{kind: continuous, a: [4, 4, 3], b: [1, -1], delay: 2}}
excitation: {{kind: multistep, switching_time: 1, {levels}}}
estimators:
  two stage:
    kind: iterative_hammerstein
    nonlinearity: {{kind: three_segment, partition: {partition}}}
    first: {{n: 3, m: 1, {horizon}}}
    second: {{{second}}}
    delay: {delay}
    start: 2.5
metrics: {{a: {{kind: error, of: [a_1]}}}}
"""
SUITABLE = {
    "samples": 1001,
    "dt": 0.1,
    "levels": "std: 1.25, limits: [-2.5, 2.5]",
    "partition": "[-0.5, 0.5]",
    "second": "n: 3, m: 1",
    "delay": 2,
    "horizon": "horizon: 15",
}
HOPELESS = [
    (
        {"partition": "[-0.5, 4]", "levels": "distribution: uniform, limits: [-2, 2]"},
        # The input's range follows from the seed.
        r"the partition points \[-0\.5, 4\] must lie inside the input's range \[-1\.9\d*, 1\.9\d*\]: "
        r"move them, or let 'partition: search' find them",
    ),
    (
        {"partition": "search", "levels": "distribution: uniform, limits: [1, 2]"},
        r"the input ranges from 1\.\d* to [12]\.?\d*: "
        r"partition points need values on both sides of zero; subtract the steady state",
    ),
]
UNSUITABLE = [
    (
        {"horizon": "horizon: 1"},
        "the horizon 1 holds 10 sampling intervals of 0.1, and order 3 needs 16: "
        "take a horizon of at least 1.6 or a sampling interval of at most 0.0625",
    ),
    (
        {"dt": 1, "samples": 101},
        "the horizon 15 holds 15 sampling intervals of 1, and order 3 needs 16: "
        "take a horizon of at least 16 or a sampling interval of at most 0.9375",
    ),
    (
        {"horizon": "horizon: 150"},
        "the horizon 150 is too long for the record: it spans 97.5 from the start 2.5, "
        "and 165 is the least that holds one horizon",
    ),
    (
        {"horizon": "horizon: 40, overlap: 0.5"},
        "2 horizons are fewer than the 9 parameters: take a shorter horizon, "
        "a smaller overlap step or a longer record",
    ),
]


def continuous_plan(folder: Path, **changes):
    return planned(folder, HAMMERSTEIN.format(**{**SUITABLE, **changes}))


def test_partition_points_inside_the_inputs_pass(tmp_path):
    check_records(continuous_plan(tmp_path))
    check_records(continuous_plan(tmp_path, partition="search"))


@pytest.mark.parametrize(("changes", "message"), HOPELESS)
def test_inputs_without_room_for_partition_points_are_refused(tmp_path, changes, message):
    with pytest.raises(ConfigError, match=rf"^{tmp_path}/a\.yaml:12: estimators\.two stage: {message}$"):
        check_records(continuous_plan(tmp_path, **changes))


@pytest.mark.parametrize(("changes", "message"), UNSUITABLE)
def test_horizons_that_do_not_suit_the_record_are_refused_at_load(tmp_path, changes, message):
    with pytest.raises(ConfigError) as caught:
        continuous_plan(tmp_path, **changes)
    assert str(caught.value) == f"{tmp_path}/a.yaml:12: estimators.two stage: {message} (under 'first')"


def test_the_program_ends_with_code_2_before_any_trial(lab):
    changes, message = HOPELESS[0]
    (lab.folder / "tiny.yaml").write_text(HAMMERSTEIN.format(**{**SUITABLE, **changes}))
    said = lab.run(code=2)
    assert re.search(rf"tiny\.yaml:12: estimators\.two stage: {message}", said)
    assert not (lab.folder / "out").exists()


STALLING = '''
import numpy as np

from hident.config.spec import component
from hident.errors import SimulationError
from hident.records import Truth
from hident.systems.base import SystemSpec


@component("system", "stalling")
class Stalling(SystemSpec):
    """A process whose simulation fails for most inputs, that of trial 0 among them."""

    def simulate(self, u, dt=1.0):
        if u[0] < 1.0:
            {fails}
        return np.convolve(u, np.exp(-dt * np.arange(100.0)))[: len(u)]

    def truth(self):
        return Truth()
'''


@pytest.mark.parametrize(
    ("fails", "why"),
    [
        (
            'raise SimulationError(f"the integration stopped at t = {dt:g}")',
            r"the integration stopped at t = 0\.1",
        ),
        ("dt / 0.0", "ZeroDivisionError: float division by zero"),
    ],
)
def test_simulations_that_fail_are_failed_trials_and_no_reason_to_refuse(lab, fails, why):
    (lab.folder / "probe.py").write_text(STALLING.replace("{fails}", fails))
    lab.configure(
        system="stalling",
        cases={"samples": [600]},
        dt=0.1,
        trials=12,
        excitation={"kind": "multistep", "switching_time": 1, "std": 1.25},
        noise=[],
        estimators={
            "two stage": {
                "kind": "iterative_hammerstein",
                "nonlinearity": {"kind": "three_segment", "partition": [-0.5, 0.5]},
                "first": {"n": 1, "horizon": 5},
            }
        },
        metrics={"a": {"kind": "value", "of": ["a_1"]}},
        tables={
            "a": {
                "kind": "grid",
                "title": "A",
                "rows": "samples",
                "columns": [{"estimator": "two stage", "metric": "a a_1"}],
            }
        },
    )
    lab.run()
    text = (lab.folder / "out/tiny/table.md").read_text()
    said = re.search(
        rf"(\d+) of 12 trials of estimator 'two stage' at samples 600 failed \({why}\)",
        text,
    )
    assert said is not None, text
    assert 2 <= int(said[1]) < 12


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"second": "structure: search, delays: [1, 7000]"},
            "the delay 7000 of second.delays is no shorter than the record, 100: "
            "take a shorter delay or a longer record",
        ),
        (
            {"delay": 100},
            "the delay 100 is no shorter than the record, 100: take a shorter delay or a longer record",
        ),
        (
            {"second": "n: 3, m: 1, horizon: 150"},
            "the horizon 150 is too long for the record: it spans 97.5 from the start 2.5, "
            "and 165 is the least that holds one horizon (under 'second')",
        ),
    ],
)
def test_delays_and_horizons_of_every_stage_are_held_against_the_record(tmp_path, changes, message):
    with pytest.raises(ConfigError) as caught:
        continuous_plan(tmp_path, **changes)
    assert str(caught.value) == f"{tmp_path}/a.yaml:12: estimators.two stage: {message}"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"delay": "search"},
            "17: estimators.two stage.delay: must be a number >= 0, or a formula such as '2*pi' or '1/5'; "
            "'second: {structure: search, delays: [...]}' searches among several (got 'search')",
        ),
        (
            {"horizon": "horizon: auto"},
            "15: estimators.two stage.first.horizon: must be a number > 0, "
            "or a formula such as '2*pi' or '1/5'; "
            "there is no automatic choice: take one to two settling times (got 'auto')",
        ),
        (
            {"second": "n: search"},
            "16: estimators.two stage.second.n: must be a whole number >= 1, <= 8; "
            "'structure: search' finds n and m (got 'search')",
        ),
    ],
)
def test_words_for_numbers_are_told_where_a_search_is(tmp_path, changes, message):
    with pytest.raises(ConfigError) as caught:
        continuous_plan(tmp_path, **changes)
    assert str(caught.value) == f"{tmp_path}/a.yaml:{message}"
