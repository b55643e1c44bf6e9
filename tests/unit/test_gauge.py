"""The ambiguity of the phases, and the gauges that resolve it."""

import functools
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.special import chdtri

from hident.errors import EstimationError
from hident.estimators.frequency.frequency_gain import FrequencyGains
from hident.estimators.frequency.gauge import (
    AMBIGUITY,
    FrequencyGrid,
    bode_weights,
    null_space,
    solve_phases,
    unwrap_along,
)
from hident.estimators.frequency.gauges import DelayFree, KnownPhase, MinimumPhase, Rational
from hident.estimators.frequency.rational_gauge import fit_rational
from tests.unit.steady_sines import exact, g_i, g_o

QUICK = settings(deadline=None, derandomize=True, max_examples=30)
W = 0.01
PAPER = FrequencyGrid.of(W * np.array([1.0, 2.0, 3.0]), [3, 3, 3])


def phase(gain, omega):
    """Continuous from zero at w = 0."""
    fine = np.linspace(0.0, 1.0, 400)
    return np.unwrap(np.angle(gain(np.outer(omega, fine))), axis=1)[:, -1]


def truth(grid):
    return phase(g_i, grid.inputs), phase(g_o, grid.outputs)


def gains(grid, errors=1e-6, shift=0.0):
    """Exact gains and sums of the paper's system, as estimated with small errors."""
    inputs, outputs = truth(grid)
    sums = grid.equations @ np.concatenate((inputs - shift * grid.inputs, outputs + shift * grid.outputs))
    logs = np.log(np.abs(np.concatenate((g_i(grid.inputs), g_o(grid.outputs)))))
    n = len(sums)
    weak = np.zeros((len(grid.inputs), 4), dtype=bool)
    return FrequencyGains(
        grid, logs, errors**2 * np.eye(len(logs)), sums, np.full(n, errors), exact(), weak, 0.0, 0, 0.0, 1
    )


def nothing(size):
    return np.zeros((size, size))


def test_the_equations_of_the_paper_lack_one():
    assert PAPER.equations.shape == (9, 9)
    assert np.linalg.matrix_rank(PAPER.equations) == 8
    np.testing.assert_allclose(PAPER.outputs, W * np.array([1, 2, 3, 4, 6, 9]))
    null = PAPER.freedom[:, 0] / PAPER.freedom[0, 0]
    np.testing.assert_allclose(null, [1, 2, 3, -1, -2, -3, -4, -6, -9], atol=1e-12)


@QUICK
@given(st.sets(st.integers(1, 12), min_size=1, max_size=8), st.integers(1, 5))
def test_more_multiples_never_close_the_set(multiples, order):
    grid = FrequencyGrid.of(W * np.array(sorted(multiples)), [order] * len(multiples))
    delay = np.concatenate((grid.inputs, -grid.outputs)) / W
    np.testing.assert_allclose(grid.equations @ delay, 0.0, atol=1e-12)
    assert len(delay) - np.linalg.matrix_rank(grid.equations) == grid.freedom.shape[1] >= 1
    assert len(grid.tops) == grid.freedom.shape[1]


def test_orders_may_differ_between_frequencies():
    grid = FrequencyGrid.of(np.array([1.0, 2.0]), [3, 1])
    np.testing.assert_array_equal(grid.k, [1, 2, 3, 1])
    np.testing.assert_array_equal(grid.outputs, [1, 2, 3])
    np.testing.assert_array_equal(grid.o, [0, 1, 2, 1])


def test_unrelated_frequencies_have_a_freedom_each():
    grid = FrequencyGrid.of(np.array([1.0, np.sqrt(2.0)]), [3, 3])
    assert grid.freedom.shape[1] == 2
    np.testing.assert_array_equal(grid.tops, [0, 1])


def test_null_space_of_full_rank_is_empty():
    assert null_space(np.eye(3)).shape == (3, 0)


def test_a_known_phase_gives_all_others():
    inputs, outputs = truth(PAPER)
    found = gains(PAPER)
    solved = solve_phases(PAPER, found.sums, found.sum_errors, np.array([1]), inputs[1:2], nothing(1))
    np.testing.assert_allclose(solved.input, inputs, atol=1e-12)
    np.testing.assert_allclose(solved.output, outputs, atol=1e-12)
    assert solved.input_errors[1] == 0.0
    assert np.all(solved.output_errors > 0.0)


def test_an_error_of_the_known_phase_is_a_delay():
    inputs, _ = truth(PAPER)
    found = gains(PAPER)
    solved = solve_phases(PAPER, found.sums, found.sum_errors, np.array([2]), inputs[2:] + 0.3, nothing(1))
    np.testing.assert_allclose(solved.input - inputs, [0.1, 0.2, 0.3], atol=1e-12)


def test_standard_errors_of_solved_phases_are_those_of_many_trials():
    rng = np.random.default_rng(0)
    found = gains(PAPER)
    errors = np.linspace(0.01, 0.05, 9)
    known, phases, covariance = np.array([2]), np.array([-0.35]), np.array([[0.02**2]])
    trials = [
        solve_phases(
            PAPER,
            found.sums + errors * rng.normal(size=9),
            errors,
            known,
            phases + 0.02 * rng.normal(),
            covariance,
        )
        for _ in range(1500)
    ]
    for side in ("input", "output"):
        spread = np.std([getattr(trial, side) for trial in trials], axis=0)
        np.testing.assert_allclose(spread, getattr(trials[0], f"{side}_errors"), rtol=0.08)


def test_phases_that_stay_open_are_nan():
    found = gains(PAPER)
    sums = np.where(PAPER.k == 3, np.nan, found.sums)
    solved = solve_phases(PAPER, sums, found.sum_errors, np.array([0]), np.array([-0.1]), nothing(1))
    np.testing.assert_array_equal(np.isnan(solved.input), [False, False, True])
    # arg Go at w, 2w, 4w follow, and 3w, 6w, 9w do not.
    np.testing.assert_array_equal(np.isnan(solved.output), [False, False, True, False, True, True])


def test_the_ladder_is_that_of_the_formula():
    octaves = 12
    grid = FrequencyGrid.of(W * 2.0 ** np.arange(float(octaves)), [2] * octaves)
    found = gains(grid)
    first, second = found.sums[0::2], found.sums[1::2]
    d = first[1:] - second[:-1]
    ladder = -np.sum(d / 2.0 ** np.arange(1, octaves))
    phases, fit = DelayFree(kind="delay_free").phases(found)
    assert fit is None
    assert phases.input[0] == pytest.approx(ladder, abs=1e-12)
    assert phases.input[0] == pytest.approx(truth(grid)[0][0], abs=np.pi / 2 ** (octaves - 1))


def test_the_final_phase_makes_the_ladder_converge():
    grid = FrequencyGrid.of(W * 2.0 ** np.arange(10.0), [2] * 10)
    inputs, outputs = truth(grid)
    phases, _ = DelayFree(kind="delay_free", final_phase=-np.pi).phases(gains(grid))
    away = abs(inputs[-1] + np.pi)
    np.testing.assert_array_less(
        np.abs(phases.input - inputs), 1.01 * away * grid.inputs / grid.inputs[-1] + 1e-9
    )
    np.testing.assert_array_less(np.abs(phases.output - outputs)[:-1], 1.01 * 2 * away)


def test_a_ladder_ends_below_a_lost_rung():
    grid = FrequencyGrid.of(W * 2.0 ** np.arange(10.0), [2] * 10)
    found = gains(grid)
    lost = (grid.m == 7) | ((grid.m == 6) & (grid.k == 2))
    phases, _ = DelayFree(kind="delay_free").phases(replace(found, sums=np.where(lost, np.nan, found.sums)))
    shorter = FrequencyGrid.of(grid.inputs[:7], [2] * 7)
    expected, _ = DelayFree(kind="delay_free").phases(gains(shorter))
    np.testing.assert_allclose(phases.input[:7], expected.input, atol=1e-12)
    assert phases.input[9] == 0.0
    np.testing.assert_array_equal(np.isnan(phases.input), np.arange(10) == 7)


@pytest.mark.parametrize(
    ("gain", "limit"),
    [(g_i, 2e-3), (g_o, 2e-3), (lambda w: 1.0 / (1.0 + 5j * np.asarray(w)), 2e-3)],
)
def test_bodes_relation_on_minimum_phase_blocks(gain, limit):
    omega = np.geomspace(1e-4, 100.0, 200)
    found = bode_weights(omega) @ np.log(np.abs(gain(omega)))
    np.testing.assert_allclose(found, phase(gain, omega), atol=limit)


def test_bodes_relation_of_a_power_law_is_a_constant_phase():
    # |G| = 1 below 1e-3 / 10, then nearly w^-1 over many decades: -pi/2 in the middle.
    omega = np.geomspace(1e-3, 1e9, 13)
    found = bode_weights(omega) @ -np.log(omega / 1e-4)
    assert found[6] == pytest.approx(-np.pi / 2, abs=1e-5)


def test_minimum_phase_gauge():
    grid = FrequencyGrid.of(np.geomspace(1e-3, 20.0, 40), [2] * 40)
    phases, _ = MinimumPhase(kind="minimum_phase").phases(gains(grid))
    inputs, outputs = truth(grid)
    np.testing.assert_allclose(phases.input, inputs, atol=0.02)
    np.testing.assert_allclose(phases.output, outputs, atol=0.04)
    assert np.all(phases.input_errors > 0.0)


def test_one_gain_has_no_minimum_phase():
    with pytest.raises(
        EstimationError, match=r"^the minimum-phase gauge needs gains at two frequencies or more$"
    ):
        bode_weights(np.array([1.0]))


def test_the_rational_gauge_recovers_both_blocks():
    gauge = Rational(kind="rational", input=(0, 2), output=(0, 2))
    phases, fit = gauge.phases(gains(PAPER))
    inputs, outputs = truth(PAPER)
    np.testing.assert_allclose(phases.input, inputs, atol=1e-9)
    np.testing.assert_allclose(phases.output, outputs, atol=1e-9)
    expected = {"input_a_1": 12.0, "input_a_2": 20.0, "output_a_1": 105.0, "output_a_2": 500.0}
    assert fit is not None
    assert dict(zip(gauge.names(), fit.coefficients, strict=True)) == pytest.approx(expected, rel=1e-6)
    assert np.all(fit.errors > 0.0)


def test_the_rational_gauge_finds_a_zero():
    grid = FrequencyGrid.of(np.geomspace(0.01, 10.0, 12), [2] * 12)

    def first(w):
        return (1.0 - 0.5j * np.asarray(w)) / (1.0 + 2j * np.asarray(w)) ** 2

    complex_gains = np.concatenate((first(grid.inputs), g_o(grid.outputs)))
    angles = np.concatenate((phase(first, grid.inputs), phase(g_o, grid.outputs)))
    errors = np.full(len(grid.m), 1e-5)
    logs = np.log(np.abs(complex_gains))
    found = fit_rational(
        grid, logs, 1e-10 * np.eye(len(logs)), grid.equations @ angles, errors, ((1, 2), (0, 2))
    )
    np.testing.assert_allclose(found.input.b, [-0.5], rtol=1e-6)
    np.testing.assert_allclose(found.input.a, [4.0, 4.0], rtol=1e-6)
    np.testing.assert_allclose(found.output.a, [105.0, 500.0], rtol=1e-6)
    np.testing.assert_allclose(found.phases.input, phase(first, grid.inputs), atol=1e-6)


@pytest.fixture(scope="module")
def trials():
    """Fits of blocks of the right orders to gains and phase sums with errors of 1e-4."""
    rng = np.random.default_rng(4)
    clean = gains(PAPER, 1e-4)
    fits = []
    for _ in range(100):
        logs = clean.log_gains + 1e-4 * rng.normal(size=9)
        sums = clean.sums + 1e-4 * rng.normal(size=9)
        fits.append(fit_rational(PAPER, logs, clean.covariance, sums, clean.sum_errors, ((0, 2), (0, 2))))
    return fits


def test_standard_errors_of_the_rational_gauge_are_those_of_many_trials(trials):
    spread = np.std([trial.phases.input for trial in trials], axis=0)
    np.testing.assert_allclose(spread, trials[0].phases.input_errors, rtol=0.15)


TEN = FrequencyGrid.of(np.geomspace(0.1, 10.0, 10), [2] * 10)


@functools.cache
def fitted(first, second, orders, errors=1e-5, level=0.0, grid=TEN):
    """The fit to exact gains and phase sums of two blocks."""
    logs = np.log(np.abs(np.concatenate((first(grid.inputs), second(grid.outputs)))))
    angles = np.concatenate((phase(first, grid.inputs), phase(second, grid.outputs)))
    count = len(grid.m)
    return fit_rational(
        grid,
        logs,
        errors**2 * np.eye(len(logs)),
        grid.equations @ angles,
        np.full(count, errors),
        orders,
        level,
    )


def lead(w):
    return (1.0 + 3j * np.asarray(w)) / ((1.0 + 0.5j * np.asarray(w)) * (1.0 + 0.1j * np.asarray(w)))


def lag_and_lead(w):
    return (1.0 + 5j * np.asarray(w)) / (1.0 + 2j * np.asarray(w)) ** 2


def late(w):
    return lag_and_lead(w) * np.exp(-0.05j * np.asarray(w))


def test_the_rational_gauge_starts_anew_where_the_first_fits_end_in_local_minima():
    found = fitted(lead, lag_and_lead, ((1, 2), (1, 2)))
    np.testing.assert_allclose(found.input.b, [3.0], rtol=1e-6)
    np.testing.assert_allclose(found.input.a, [0.6, 0.05], rtol=1e-6)
    np.testing.assert_allclose(found.output.b, [5.0], rtol=1e-6)
    np.testing.assert_allclose(found.output.a, [4.0, 4.0], rtol=1e-6)
    assert found.chi2 < 1e-3
    assert found.freedom == 10 + 20 + 20 - 6


@pytest.mark.parametrize(
    ("second", "orders"),
    [(lag_and_lead, ((1, 2), (0, 2))), (late, ((1, 2), (1, 2)))],
    ids=["an order that is too low", "a delay"],
)
def test_rational_blocks_that_do_not_fit(second, orders):
    found = fitted(lead, second, orders)
    limit = chdtri(found.freedom, 0.001)
    assert found.chi2 > limit
    message = (
        f"the rational blocks do not fit the gains and phase sums: chi^2 is {found.chi2:.4g}, {limit:.4g} "
        f"the limit for {found.freedom} degrees of freedom, and the largest misfit is {found.misfit:.2g} of "
        "a gain or radians of a phase sum. The degrees [m, n] of a block are too low, or a block has a "
        "delay: raise the degrees, or declare another gauge; 'fit_level: 0' shows the estimate all the same"
    )
    with pytest.raises(EstimationError, match=f"^{re.escape(message)}$"):
        fitted(lead, second, orders, level=0.001)


def test_other_starts_end_in_the_same_blocks_though_they_do_not_fit():
    """A frequency without data changes the starts and not the problem."""
    found = fitted(lead, late, ((1, 2), (1, 2)))
    omega = np.append(TEN.inputs, 300.0)
    grid = FrequencyGrid.of(omega, [2] * 11)
    at_300 = np.concatenate((omega == 300.0, grid.outputs >= 300.0))
    logs = np.log(np.abs(np.concatenate((lead(omega), late(grid.outputs)))))
    sums = grid.equations @ np.concatenate((phase(lead, omega), phase(late, grid.outputs)))
    other = fit_rational(
        grid,
        np.where(at_300, np.nan, logs),
        1e-10 * np.eye(len(logs)),
        np.where(grid.m == 10, np.nan, sums),
        np.full(22, 1e-5),
        ((1, 2), (1, 2)),
    )
    np.testing.assert_allclose(other.input.a, found.input.a, rtol=1e-7)
    np.testing.assert_allclose(other.output.a, found.output.a, rtol=1e-7)


def test_a_small_misfit_of_rational_blocks_is_tolerated():
    nearly = fitted(lead, lambda w: lag_and_lead(w) * np.exp(-2e-5j * w), ((1, 2), (1, 2)), 1e-6, level=0.001)
    assert nearly.chi2 > 1000.0
    assert nearly.misfit < 1e-3


def test_as_many_coefficients_as_data_leave_nothing_to_test():
    one = FrequencyGrid.of(np.array([1.0]), [1])
    found = fitted(lambda w: 1.0 / (1.0 + 1j * w), lag_and_lead, ((0, 1), (0, 2)), level=0.001, grid=one)
    assert found.freedom == 0


def test_chi_squared_of_the_rational_gauge_is_that_of_its_degrees_of_freedom(trials):
    assert {trial.freedom for trial in trials} == {14}
    # The mean of 100 has the standard error sqrt(2 * 14 / 100) = 0.53.
    assert np.mean([trial.chi2 for trial in trials]) == pytest.approx(14.0, abs=2.1)


def test_too_few_data_for_the_coefficients():
    found = gains(FrequencyGrid.of(np.array([W]), [1]))
    with pytest.raises(
        EstimationError, match=r"^3 gains and phase sums do not determine the 4 coefficients of both blocks$"
    ):
        Rational(kind="rational", input=(0, 2), output=(0, 2)).phases(found)


def test_an_unstable_fit():
    found = gains(PAPER)
    angles = np.concatenate((-truth(PAPER)[0], truth(PAPER)[1]))
    with pytest.raises(
        EstimationError, match=r"^the rational input block comes out unstable: lower its order$"
    ):
        fit_rational(
            PAPER,
            found.log_gains,
            found.covariance,
            PAPER.equations @ angles,
            found.sum_errors,
            ((0, 2), (0, 2)),
        )


def test_sums_are_unwrapped_along_the_frequency():
    grid = FrequencyGrid.of(np.geomspace(1e-3, 2.0, 30), [3] * 30)
    found = gains(grid)
    wrapped = np.angle(np.exp(1j * found.sums))
    assert np.max(np.abs(wrapped - found.sums)) > 6.0
    np.testing.assert_allclose(unwrap_along(grid, wrapped), found.sums, atol=1e-12)
    wrapped[4] = np.nan
    np.testing.assert_array_equal(np.isnan(unwrap_along(grid, wrapped)), np.isnan(wrapped))


@pytest.mark.parametrize(
    ("gauge", "frequencies", "message"),
    [
        (
            DelayFree(kind="delay_free"),
            [1.0, 1.3, 2.0],
            "the gauge delay_free needs a ladder, and no harmonic of 1.3 meets one of another frequency: "
            "add frequencies such as 2 w, 4 w, 8 w",
        ),
        (
            MinimumPhase(kind="minimum_phase"),
            [1.0],
            "the gauge minimum_phase needs two frequencies or more",
        ),
        (
            Rational(kind="rational", input=(1, 5), output=(1, 5)),
            [1.0],
            "7 gains and phase sums do not determine 12 coefficients",
        ),
        (
            KnownPhase(kind="known_phase", at=((1.5, 0.0),)),
            [1.0, 2.0],
            "a phase is given at 1.5, which is not among the frequencies",
        ),
        (
            KnownPhase(kind="known_phase", at=((1.0, 0.0),)),
            [1.0, 1.3],
            "the known phases leave the phase of G_i at 1.3 open: give it there too",
        ),
    ],
)
def test_a_gauge_that_does_not_suit_the_frequencies(gauge, frequencies, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        gauge.check(FrequencyGrid.of(np.array(frequencies), [3] * len(frequencies)))


def test_known_phases_need_one_pair():
    with pytest.raises(ValidationError, match="must be a list of at least 1"):
        KnownPhase.model_validate({"kind": "known_phase", "at": []})


def test_the_ambiguity_is_explained_in_three_lines():
    assert len(AMBIGUITY.splitlines()) == 3
    assert "a delay moves freely" in AMBIGUITY
    for gauge in ("delay_free", "minimum_phase", "rational", "known_phase"):
        assert gauge in AMBIGUITY


def test_a_rational_gauge_must_be_proper():
    with pytest.raises(ValidationError, match=r"must be \[m, n\] with m <= n, not \[3, 2\]"):
        Rational.model_validate({"kind": "rational", "input": [3, 2], "output": [0, 2]})
