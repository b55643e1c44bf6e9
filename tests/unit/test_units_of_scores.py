"""Scores in units of forms that are not the same: a table says so, and no test compares them."""

from functools import partial

import numpy as np
import pytest

import hident as hi
from hident.reports.output import check
from hident.reports.scoring import scoring
from tests.unit import plans

TEXT = """\
version: 1
title: The same error in several units
trials: 8
samples: 400
system:
  kind: hammerstein
  nonlinearity: {kind: polynomial, coefficients: [0, 1, 0.5]}
  linear: {kind: fir, b: [0, 2, 1]}
excitation: {kind: iid, distribution: uniform, low: -2, high: 2}
noise: {kind: white, nsr: 0.02}
estimators:
  two-stage: {kind: two_stage, lags: 2, degree: 2}
  least squares: {kind: bilinear_least_squares, lags: 2, degree: 2}
  Voros: {kind: voros_hammerstein, n: 1, m: 2, degree: 2}
metrics:
  m: {kind: mise, interval: [-2, 2]}
tables:
  t: {kind: comparison, title: Pairs, metric: m}
"""
APART = (
    "in several units, as each method fixes the factor between the blocks by its own rule{} (two-stage, "
    "least squares; Voros): 'up_to: [gain, sign]' under the metric brings all to the system's own units"
)
NOTE = f"Metric m: {APART.format(', and not to be compared across them')}."
REFUSED = f"'m' is {APART.format('')}"


@pytest.fixture
def plan_of(tmp_path):
    return partial(plans.planned, tmp_path)


def units_said(plan):
    return [line for line in scoring(plan) if "several units" in line]


def without_table(text=TEXT):
    return text.split("tables:", maxsplit=1)[0]


def test_a_row_of_several_units_has_a_note_and_no_comparison(plan_of):
    plan = plan_of(without_table())
    assert units_said(plan) == [NOTE]
    first, _, last = (unit.truth().nonlinearity(np.array([2.0])) for unit in plan.units)
    # What is 4 in the system: |b| = 1 multiplies it by 2.236, b_1 = 1 by 2.
    assert [float(first[0]), float(last[0])] == pytest.approx([4 * 5**0.5, 8.0])
    with pytest.raises(hi.ConfigError) as refused:
        check(plan_of(TEXT))
    assert str(refused.value).endswith(f"tables.t.metric: {REFUSED}")


@pytest.mark.parametrize(
    "change",
    [
        "metrics.m.up_to=[gain,sign]",
        "metrics.m.up_to=[gain]",
        "metrics.m={kind: nonlinearity_percent_error, interval: [-2, 2]}",
        "metrics.m={kind: impulse_response_error}",
        "tables.t.estimators=[two-stage, least squares]",
        "system.linear.b=[0, 1]",
    ],
)
def test_what_is_in_one_unit_is_compared(plan_of, change):
    check(plan_of(TEXT, change))
    if "estimators" not in change:
        assert units_said(plan_of(without_table(), *([] if "tables" in change else [change]))) == []


def test_errors_of_values_have_the_units_of_these(plan_of):
    """b_1 and b_2 are scaled, and no factor is chosen in them; a hit of an interval has no unit."""
    text = TEXT.replace("m: {kind: mise, interval: [-2, 2]}", "m: {kind: error, of: [b_1, b_2]}")
    (said,) = units_said(plan_of(without_table(text)))
    assert said.startswith("Metric m b_1, m b_2: in several units")
    assert said.endswith("least squares; Voros): score what does not depend on the factor instead.")
    with pytest.raises(hi.ConfigError, match=r"tables\.t\.metric: 'm b_2' is in several units"):
        check(plan_of(text.replace("metric: m}", "metric: m b_2}")))
    # One factor in all of them cancels in a relative error; of what a factor leaves alone, nothing changes.
    relative = text.replace("{kind: error,", "{kind: percent_error,")
    check(plan_of(relative))
    assert units_said(plan_of(relative)) == []


def test_the_axis_of_a_wiener_system_s_nonlinearity_is_a_unit_too(plan_of):
    """A factor of the argument: the same interval is another part of the curve."""
    system = """\
system:
  kind: wiener
  linear: {kind: fir, b: [0, 2, 1]}
  nonlinearity: {kind: polynomial, coefficients: [0, 1, 0.1]}
"""
    head, tail = (
        TEXT.split("system:\n", maxsplit=1)[0],
        TEXT[TEXT.index("excitation:") : TEXT.index("estimators:")],
    )
    slope = "{kind: voros_wiener, n: 1, m: 2, degree: 2}"
    linear, curve = "{kind: linear, nb: 2, nf: 0, nk: 1}", "{kind: polynomial, degree: 2}"
    gain = f"{{kind: prediction_error, blocks: [{linear}, {curve}]}}"
    metric = "{kind: nonlinearity_percent_error, interval: [-2, 2]}"
    text = f"{head}{system}{tail}estimators:\n  e: {slope}\n  f: {gain}\nmetrics:\n  m: {metric}\n"
    assert len(units_said(plan_of(text))) == 1
    assert units_said(plan_of(text, "metrics.m.up_to=[gain,sign]")) == []
    assert units_said(plan_of(text, "system.linear.b=[0,0.5,0.5]")) == []


def test_a_constant_that_is_open_stays_so_in_one_unit(plan_of):
    kernel = "{kind: kernel, kernel: gaussian, bandwidth: {h0: 0.4, alpha: 1/5}, delay: 1}"
    text = without_table().replace("{kind: voros_hammerstein, n: 1, m: 2, degree: 2}", kernel)
    (said,) = units_said(plan_of(text))
    assert "'up_to: [gain, sign, constant]' under the metric" in said
