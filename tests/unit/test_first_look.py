"""A first look at a record: what it finds in simulated ones, and what it says is wrong."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from hident.measurements.excitation import CONDITION
from hident.measurements.first_look import first_look
from hident.records import Held, Part, Record
from hident.reports.first_look import figures
from hident.reports.style import style
from tests.shared_data import measured


def rng(seed=0):
    return np.random.default_rng(seed)


def simulated(seed=0, n=1000, delay=2, f=np.asarray, colour=0.5, noise=0.1, pole=0.7):
    """A first-order system behind (or under) a static function, its input coloured, its noise too."""
    draw = rng(seed)
    u = lfilter([1.0], [1.0, -colour], draw.normal(size=n + 200))
    x = lfilter([0.0] * delay + [1.0], [1.0, -pole], u)
    y = f(x) + noise * lfilter([1.0], [1.0, -0.8], draw.normal(size=n + 200))
    return u[200:], y[200:]


def look(u, y, **fields):
    return first_look(Record(u, y, **fields))


def wrong(u, y):
    return " ".join(look(u, y).wrong)


def of_two(u, y, cut):
    held = Held(np.zeros(1), np.zeros(1))
    return Record(u, y, parts={"a": Part(0, cut, 1.0, held), "b": Part(cut, len(u), 1.0, held)})


# The signals


def test_the_values_of_the_signals():
    u = np.repeat([0.0, 3.0, -1.0, 3.0], 100)
    found = look(u, np.arange(400.0) * 0.25)
    assert (found.samples, found.experiments, found.dt) == (400, 1, None)
    assert (found.input.low, found.input.high, found.input.levels) == (-1, 3, (-1, 0, 3))
    assert (found.input.mean, found.input.std) == pytest.approx((u.mean(), u.std()), rel=1e-12)
    assert (found.output.values, found.output.levels) == (400, ())
    assert found.output.step == pytest.approx(0.25, rel=1e-9)


def test_a_grid_is_found_through_the_rounding_of_written_numbers_and_none_without():
    u, y = simulated()
    assert look(u, np.round(0.0488 * np.round(y / 0.0488), 3)).output.step == pytest.approx(0.0488, rel=1e-3)
    assert look(u, y).output.step is None


# The delay


@pytest.mark.parametrize("colour", [0.0, 0.9])
@pytest.mark.parametrize("delay", [0, 1, 4])
def test_the_delay_is_within_its_interval(delay, colour):
    found = [look(*simulated(seed, delay=delay, colour=colour)).delay for seed in range(40)]
    inside = [one.low <= delay <= one.high for one in found]
    assert sum(inside) >= 39
    assert np.median([one.high - one.low for one in found]) <= 1


def test_more_noise_or_a_slow_response_widen_the_interval():
    def width(**settings):
        found = look(*simulated(**settings)).delay
        return found.high - found.low

    assert width(noise=0.05) <= width(noise=2.0)
    u, y = simulated(noise=0.3)
    slow = look(u, lfilter(np.arange(30.0), 1.0, y)).delay
    assert slow.low <= 3 <= slow.high
    assert slow.high > slow.low


@pytest.mark.parametrize("saturates", ["input", "output"])
@pytest.mark.parametrize("held", [4, 8, 20])
@pytest.mark.parametrize("delay", [0, 5, 15, 40])
def test_the_delay_behind_a_held_input_is_within_its_interval(delay, held, saturates):
    """Both signals jump together at some lags: chance correlations are larger there."""

    def found(seed):
        draw = rng(seed)
        u = np.repeat(draw.uniform(-2, 2, 2000 // held), held)
        x = np.clip(u, -1.0, 1.2) if saturates == "input" else u
        y = lfilter([0.0] * delay + [0.2], [1.0, -1.2, 0.4], x)
        y = np.clip(y, -1.0, 1.2) if saturates == "output" else y
        return look(u, y + 0.02 * draw.normal(size=2000)).delay

    assert all(one.low <= delay <= one.high for one in map(found, range(10)))


def test_the_square_of_the_input_tells_the_delay_of_an_even_function():
    u, y = simulated(f=np.abs, delay=3, pole=0.0, colour=0.3)
    found = look(u, y)
    assert "cross-correlation with the square of the input, prewhitened" in found.delay.method
    assert found.delay.low <= 3 <= found.delay.high
    assert found.wrong == ()


def test_no_correlation_and_one_with_later_inputs_are_said():
    u, y = simulated()
    unrelated = look(u, simulated(seed=1)[1])
    assert unrelated.delay is None
    assert (
        "The output is not correlated with the input or its square: are these the right columns?"
        in " ".join(unrelated.wrong)
    )
    assert "is there feedback, or are the input and the output exchanged? Or is the input late" in wrong(y, u)


def test_experiments_are_not_mixed():
    """The second experiment's beginning answers the first one's end only to who looks across."""
    u, y = simulated(n=600)
    both = of_two(np.concatenate([u, u]), np.concatenate([y, y]), 600)
    one, two = look(u, y), first_look(both)
    assert one.correlation
    assert two.correlation
    assert (two.experiments, two.delay) == (2, one.delay)
    np.testing.assert_allclose(
        two.correlation.values[two.correlation.lags == 2],
        one.correlation.values[one.correlation.lags == 2],
        atol=0.01,
    )
    np.testing.assert_allclose(two.excitation.condition, one.excitation.condition, rtol=1e-6)


def test_a_short_experiment_takes_no_lags_from_a_long_one():
    u, y = simulated(delay=9)
    one, two = look(u, y), first_look(of_two(u, y, 970))
    assert one.correlation
    assert two.correlation
    assert (two.delay, len(two.correlation.lags)) == (one.delay, len(one.correlation.lags))
    with style():
        spectrum = figures(of_two(u, y, 970), two)["spectrum"]()
    assert len(np.asarray(spectrum.axes[0].lines[0].get_xdata())) > 400


# The excitation


@pytest.mark.parametrize("levels", [2, 3, 4])
def test_so_many_levels_excite_so_high_a_degree_at_most(levels):
    u = rng().choice(np.linspace(-1, 2, levels), size=2000)
    found = look(u, lfilter([0, 1], [1, -0.5], u))
    for degree, row in zip(found.excitation.degrees, found.excitation.condition, strict=True):
        assert np.isinf(row).all() == (degree >= levels)
    assert found.wrong == (
        f"The input has {levels} levels: it cannot tell a nonlinearity of degree {levels} or more from one "
        f"of degree {levels - 1}.",
    )


def test_condition_numbers_are_those_of_the_regressors():
    u, y = simulated(n=400)
    found = look(u, y).excitation
    scaled = 2 * (u - u.min()) / (u.max() - u.min()) - 1
    columns = []
    for lag in range(2):
        x = scaled[1 - lag : len(u) - lag]
        columns += [x, (3 * x**2 - 1) / 2]
    matrix = np.column_stack(columns)
    matrix = matrix - matrix.mean(axis=0)
    expected = np.linalg.cond(matrix / np.linalg.norm(matrix, axis=0))
    assert found.condition[found.degrees.index(2), found.lags.index(2)] == pytest.approx(expected, rel=1e-9)


def test_white_noise_is_the_best_input_and_a_sine_excites_two_lags():
    white = look(*simulated(colour=0.0)).excitation
    assert white.condition[0].max() < 2
    u = np.sin(0.3 * np.arange(500))
    found = look(u, np.roll(u, 2) ** 3)
    assert np.isinf(found.excitation.condition[0]).tolist() == [False, False, True, True, True]
    assert "The input cannot excite 5 lags, not even of a linear model." in found.wrong


def test_a_slow_input_excites_badly():
    u = lfilter([1.0], [1, -0.999], rng().normal(size=5000))
    u = lfilter([0.001], [1, -0.999], u)
    found = look(u, u + 0.1 * rng(1).normal(size=5000))
    assert found.excitation.condition[0, 2] > CONDITION
    assert "The input excites a linear model over 2 lags badly" in " ".join(found.wrong)


# What is wrong


@pytest.mark.parametrize("seed", range(30))
def test_nothing_is_wrong_with_a_sound_record(seed):
    f = (np.asarray, np.tanh, np.square)[seed % 3]
    assert look(*simulated(seed, n=(250, 1000, 5000)[seed % 3], f=f)).wrong == ()


@pytest.mark.parametrize("which", [0, 1])
def test_a_constant_signal(which):
    signals = list(simulated())
    signals[which] = np.full(1000, 7.5)
    name = ("input", "output")[which]
    assert look(*signals).wrong == (f"The {name} is constant (7.5): nothing can be identified.",)


def test_a_short_record():
    u, y = simulated(n=150)
    assert "The record has 150 samples only" in wrong(u, y)


def test_a_saturated_sensor_is_found_and_a_settled_process_is_none():
    u, y = simulated(noise=0.01)
    top = np.quantile(y, 0.9)
    said = wrong(u, np.minimum(y, top))
    assert (
        f"The output stands at its highest value ({top:g}) in 10 % of the samples while the input moves"
        in said
    )
    bottom = np.quantile(y, 0.1)
    assert f"its lowest value ({bottom:g}) in 10 % of" in wrong(u, np.maximum(y, bottom))
    held = np.repeat(rng(3).choice([0.0, 1.0], size=40), 50)
    settled = lfilter([0, 0.3], [1, -0.7], held)
    assert "saturated" not in wrong(held, np.round(settled, 6))


def test_coarse_steps_outliers_and_repeated_values():
    u, y = simulated()
    assert "The output moves in steps of 0.5" in wrong(u, 0.5 * np.round(y / 0.5))
    flawed = y.copy()
    flawed[[99, 500]] += 40
    assert "The output is far from the samples around it at sample 100, 501: look for outliers." in wrong(
        u, flawed
    )
    often = np.repeat(y[:250], 4)
    assert "The output repeats each value 4 times, and the input does not" in wrong(u, often)
    assert "keep every 4th sample" in wrong(np.repeat(u[:250], 4), often)


def test_rest_padding_silence_and_a_sensor_that_stands_still():
    u, y = simulated()
    rest = np.zeros(100)
    padded = wrong(np.concatenate([rest, u]), np.concatenate([rest + 3, y]))
    assert "Samples 1 to 100 repeat one value in both signals" in padded
    padded = wrong(np.concatenate([u, rest]), np.concatenate([y, rest]))
    assert "Samples 1001 to 1100 repeat one value in both signals" in padded
    silence = 0.01 * rng(5).normal(size=(2, 300))
    quiet = wrong(np.concatenate([silence[0], u]), np.concatenate([silence[1], y]))
    assert "The input hardly moves until sample 30" in quiet
    stuck = y.copy()
    stuck[400:440] = y[400]
    assert "The output stands still from sample 401 to 440 while the input moves" in wrong(u, stuck)


def test_the_experiment_is_named():
    u, y = simulated()
    stuck = y.copy()
    stuck[800:840] = y[800]
    assert "from sample 201 to 240 of 'b' while" in " ".join(first_look(of_two(u, stuck, 600)).wrong)


@given(
    scale=st.sampled_from([1e-290, 1e-5, 3.0, 1e290]),
    shift=st.sampled_from([0.0, -2.0, 10.0]),
    sign=st.sampled_from([1, -1]),
)
@settings(max_examples=20, deadline=None)
def test_units_change_no_finding(scale, shift, sign):
    u, y = simulated(n=600)
    y = np.minimum(y, np.quantile(y, 0.9))
    plain = look(u, y)
    other = look(scale * (sign * u + shift), scale * (y + shift))
    assert (other.delay, len(other.wrong)) == (plain.delay, len(plain.wrong))
    np.testing.assert_allclose(other.excitation.condition, plain.excitation.condition, rtol=1e-6)


@pytest.mark.parametrize("n", range(1, 45))
def test_very_short_and_very_large_records_are_looked_at(n):
    u, y = simulated(n=n)
    for factor in (1.0, 1.7e308 / max(np.abs(u).max(), np.abs(y).max())):
        record = Record(factor * u, factor * y, 0.5)
        found = first_look(record)
        assert np.isfinite([found.input.mean, found.output.std]).all()
        if n % 11 == 0:
            with style(), np.errstate(all="ignore"):
                assert {"signals", "histogram", "spectrum"} <= figures(record, found).keys()
                if factor == 1.0:
                    assert all(draw().axes for draw in figures(record, found).values())


# Public records


@pytest.mark.parametrize(
    ("file", "input_", "output", "said"),
    [
        (
            "cascaded_tanks/dataBenchmark.csv",
            "uEst",
            "yEst",
            "The output stands at its highest value (10) in 4.7 %",
        ),
        ("daisy_exchanger/exchanger.dat", 2, 3, "Samples 1 to 100 repeat one value in both signals"),
        ("daisy_heating_system/heating_system.dat", 2, 3, "The input has 6 levels"),
        ("wiener_hammerstein_2009/estimation.csv", 1, 2, "The input hardly moves until sample 5001"),
    ],
)
def test_public_records_are_seen_through(file, input_, output, said):
    import hident as hi

    assert said in " ".join(hi.first_look(hi.read(measured(file), input=input_, output=output)).wrong)


@pytest.mark.parametrize("code", [-9999.0, 9999.0, -999.0, 1e30, 32767.0, 555.0])
def test_a_code_for_missing_samples_is_called_one_and_nothing_else(code):
    u, y = simulated()
    y[[50, 51, 300]] = code
    [said] = look(u, y).wrong
    assert said.startswith(f"The output is {code:.10g} in 3 samples, far outside of its other values (")
    assert "looks like a code for missing samples" in said
    assert f"(--missing {code:.10g} --gaps split)" in said


def test_two_codes_in_one_signal_and_one_in_the_other():
    u, y = simulated()
    y[[50, 51, 52]], y[[60, 70, 80]], u[9] = -9999.0, -999.0, 1e30
    of_input, of_output = look(u, y).wrong
    assert "The input is 1e+30 in 1 samples" in of_input
    assert "'missing: [-9999, -999]' with 'gaps: split' (--missing -9999,-999 --gaps split)" in of_output


@pytest.mark.parametrize(
    "spoilt",
    [
        lambda u, y: (np.round(u) * 99.0, y),
        lambda u, y: (np.where(u > 1.0, 50.0, np.sign(u)), y),
        lambda u, y: (u, np.clip(y, -1.0, 1.0)),
        lambda u, y: (u, np.where(np.arange(len(y)) == 9, 300.0, y)),
        lambda u, y: (u, 9999.0 + y),
    ],
)
def test_what_is_no_code(spoilt):
    assert "code" not in " ".join(look(*spoilt(*simulated())).wrong)
