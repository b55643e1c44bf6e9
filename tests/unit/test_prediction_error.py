"""Chains of blocks by prediction error: derivatives, exactness, what no data determine, standard errors."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.signal import lfilter

import hident as hi
from hident.block_chain import BlockChain
from hident.errors import ConfigError, EstimationError
from hident.estimators.prediction_error.criterion import Data, point_at
from hident.estimators.prediction_error.gauge import gain_of, normalised
from hident.estimators.prediction_error.parameters import LinearStructure, Parameters, StaticStructure
from hident.fitted_model import FittedModel, NoiseModel
from hident.linear_blocks import TransferFunction
from hident.records import Held, Part, Record
from hident.static_functions import (
    Chebyshev,
    CubicSpline,
    DeadZone,
    PiecewiseLinear,
    Saturation,
    StaticFunction,
)

BASES = {
    basis.kind: basis
    for basis in (
        Chebyshev(4, -2.0, 3.0),
        PiecewiseLinear((-3.0, -1.0, 0.2, 2.0)),
        CubicSpline((-3.0, -1.0, 0.0, 2.0, 3.0)),
        Saturation(-0.5, 0.7),
        DeadZone(-0.5, 0.7),
    )
}
OUTPUT_ERROR = NoiseModel()
STARTS = ("rest", "settled")
FIRST = TransferFunction((0.0, 1.0, 0.5), (0.9, -0.3))
SECOND = TransferFunction((0.6, -0.3, 0.1), (0.4,))
CORNERED = {
    "saturation": StaticFunction(Saturation(-0.6, 0.8), (0.2, 1.5)),
    "dead_zone": StaticFunction(DeadZone(-0.6, 0.8), (0.2, 1.0, 2.0)),
}
CUBIC = hi.Polynomial(coefficients=[0.0, 1.0, 0.3, -0.1])


def model_of(found):
    """The chain of blocks that an estimate holds."""
    assert isinstance(found.model, FittedModel)
    return found.model


def function(basis, seed=0):
    return StaticFunction(basis, tuple(np.random.default_rng(seed).normal(size=basis.size).tolist()))


def gaussian(samples=1000, seed=0):
    return np.random.default_rng(seed).normal(size=samples)


def chain_of(letters, kind, seed=0):
    linear, draws = iter((FIRST, SECOND, TransferFunction((1.0, 0.2), (-0.5,)))), seed
    blocks = []
    for letter in letters:
        draws += 1
        blocks.append(next(linear) if letter == "L" else function(BASES[kind], draws))
    return BlockChain(tuple(blocks))


def structures(chain):
    return [
        LinearStructure(3, len(block.a))
        if isinstance(block, TransferFunction)
        else StaticStructure(block.basis)
        for block in chain.blocks
    ]


def point_of(chain, data, noise=OUTPUT_ERROR, states=None):
    return point_at(data, Parameters.of(structures(chain), chain, states=states), noise)


def differences(point, step=1e-6):
    """The derivatives of the predictions by central differences, as Point.rows has them."""
    theta, solved = point.theta, np.zeros(len(point.projected_rows))
    found = []
    for k in range(len(theta) + len(solved)):
        sides = []
        for sign in (step, -step):
            moved = np.concatenate((theta, solved))
            moved[k] += sign
            sides.append(point.prediction(moved[: len(theta)], moved[len(theta) :]))
        found.append((sides[0] - sides[1]) / (2.0 * step))
    return np.array(found)


class TestDerivatives:
    def check(self, chain, start, noise=OUTPUT_ERROR, n_init=7, states=None):
        rng = np.random.default_rng(5)
        u = rng.normal(0.3, 1.0, 150)
        parts = (slice(0, 90), slice(90, 150))
        y = np.concatenate([chain.response(u[part], start) for part in parts])
        # Not all of it can be met: coefficients that are solved for stay near their values.
        data = Data(u, y + 0.1 * np.std(y) * rng.normal(size=150), parts, start, n_init)
        point = point_of(chain, data, noise, states)
        rows, expected = point.rows(), differences(point)
        scale = np.max(np.abs(expected), axis=1, keepdims=True)
        # A hat function that no sample reaches changes nothing.
        scale[scale == 0.0] = 1.0
        np.testing.assert_allclose(rows / scale, expected / scale, rtol=0.0, atol=1e-6)

    @pytest.mark.parametrize("letters", ["L", "N", "NL", "LN", "LNL", "NLN", "LNLNL"])
    @pytest.mark.parametrize("kind", BASES)
    @pytest.mark.parametrize("start", STARTS)
    def test_of_the_chain(self, letters, kind, start):
        self.check(chain_of(letters, kind), start)

    @pytest.mark.parametrize("ar, ma", [((0.6, -0.2), ()), ((), (0.5,)), ((0.6, -0.2), (0.5, 0.1))])
    @pytest.mark.parametrize("letters", ["LNL", "NLN"])
    @pytest.mark.parametrize("n_init", [0, 7])
    def test_of_the_noise(self, ar, ma, letters, n_init):
        self.check(chain_of(letters, "cubic_spline"), "settled", NoiseModel(ar, ma), n_init)

    @pytest.mark.parametrize("letters", ["L", "NL", "LN", "LNL", "NLN", "LNLNL"])
    @pytest.mark.parametrize("noise", [OUTPUT_ERROR, NoiseModel((0.6, -0.2), (0.5,))])
    @pytest.mark.parametrize("start", STARTS)
    def test_of_the_states(self, letters, noise, start):
        chain, draws = chain_of(letters, "cubic_spline"), np.random.default_rng(8)
        states = {
            i: tuple(draws.normal(size=(2, max(2, len(block.a)))))
            for i, block in enumerate(chain.blocks)
            if isinstance(block, TransferFunction)
        }
        self.check(chain, start, noise, n_init=0, states=states)

    def test_the_gradient_of_the_loss_is_that_of_the_projected_one(self):
        data = Data(gaussian(300), gaussian(300, 1), (slice(0, 300),), "rest")
        point = point_of(chain_of("NLN", "polynomial"), data)
        gradient = -2.0 * point.rows()[: len(point.theta)] @ point.residuals
        for k, step in enumerate(1e-6 * np.eye(len(point.theta))):
            up, down = (point.moved(point.theta + sign * step).loss for sign in (1.0, -1.0))
            assert (up - down) / 2e-6 == pytest.approx(gradient[k], rel=1e-5, abs=1e-6 * point.loss)


def blocks_of(letters, **static):
    linear, found = iter(({"nb": 2, "nf": 2}, {"nb": 2, "nf": 1})), []
    for letter in letters:
        found.append(
            hi.LinearBlock(**next(linear)) if letter == "L" else hi.PolynomialBlock(degree=3, **static)
        )
    return found


def truth_of(letters):
    """A chain of the blocks above, its polynomials over ranges that no signal leaves."""
    linear = iter((TransferFunction((1.0, 0.5), (0.9, -0.3)), TransferFunction((1.0, -0.5), (0.4,))))
    wide = Chebyshev(3, -20.0, 20.0)
    # Increasing from end to end: a chain of two of them stays in bounds.
    grid = np.linspace(-20.0, 20.0, 9)
    cubic = np.linalg.solve(wide.rows(grid[::2][:4]).T, (grid + 0.1 * grid**2 + 0.02 * grid**3)[::2][:4])
    return BlockChain(
        tuple(next(linear) if letter == "L" else StaticFunction(wide, tuple(cubic)) for letter in letters)
    )


class TestRecoveryWithoutNoise:
    @pytest.mark.parametrize("letters", ["NL", "LN", "LNL", "NLN"])
    @pytest.mark.parametrize("start", STARTS)
    def test_all_structures(self, letters, start):
        u, truth = gaussian(), truth_of(letters)
        y = truth.response(u, start)
        found = hi.fit(hi.PredictionError(blocks=blocks_of(letters), start=start), Record(u, y))
        model = model_of(found).simulate(Record(u, y))
        np.testing.assert_allclose(model, y, rtol=0.0, atol=1e-8 * np.std(y))
        for block, true in zip(model_of(found).chain.linear, truth.linear, strict=True):
            np.testing.assert_allclose(block.a, true.a, rtol=0.0, atol=1e-8)
            gain = true.static_gain()
            np.testing.assert_allclose(block.b, np.array(true.b) / gain, rtol=0.0, atol=1e-8)

    @pytest.mark.parametrize("start", STARTS)
    @pytest.mark.parametrize("block", [hi.SaturationBlock(), hi.DeadZoneBlock()])
    def test_corners(self, block, start):
        cornered = CORNERED[block.kind]
        truth = BlockChain((FIRST, cornered))
        u = gaussian()
        y = truth.response(u, start)
        blocks = [hi.LinearBlock(nb=2, nf=2, nk=1), block]
        found = model_of(hi.fit(hi.PredictionError(blocks=blocks, start=start), Record(u, y))).chain
        gain = FIRST.static_gain()
        np.testing.assert_allclose(found.linear[0].a, FIRST.a, atol=1e-7)
        np.testing.assert_allclose(gain * np.array(found.static[0].range), cornered.range, atol=1e-6)


class TestNormalForm:
    """The rule of gauge.py: the response stays, and linear blocks have the static gain 1."""

    @pytest.mark.parametrize("first, second", list(product(BASES, BASES)))
    @pytest.mark.parametrize("start", STARTS)
    @pytest.mark.parametrize("gain", [-2.3, 0.4])
    def test_it_keeps_the_response(self, first, second, start, gain):
        u = gaussian(300, 3)
        f, g = function(BASES[first], 1), function(BASES[second], 2)
        block = replace(FIRST, b=tuple(gain * b for b in FIRST.b))
        for blocks in (
            (block, SECOND),
            (block, f),
            (f, block, g),
            (block, f, SECOND),
            (block, f, SECOND, g, FIRST),
        ):
            chain = BlockChain(blocks)
            form = normalised(chain, start=start)
            expected = chain.response(u, start)
            size = np.max(np.abs(expected))
            np.testing.assert_allclose(form.response(u, start), expected, rtol=0.0, atol=1e-10 * size)
            last = len(form.linear) - (not form.static)
            for linear in form.linear[:last]:
                assert linear.static_gain() == pytest.approx(1.0, rel=1e-12)
            again = normalised(form, start=start)
            np.testing.assert_allclose(again.response(u, start), expected, rtol=0.0, atol=1e-10 * size)

    def test_a_block_without_static_gain_has_an_impulse_response_of_length_one(self):
        block = TransferFunction((0.0, -2.0, 2.0), (0.5,))
        form = normalised(BlockChain((block, function(BASES["saturation"]))))
        [linear] = form.linear
        response = linear.impulse_response(200)
        assert np.linalg.norm(response) == pytest.approx(1.0)
        assert response[1] > 0.0
        assert gain_of(linear) == pytest.approx(1.0)

    def test_what_stands_between_two_functions_has_the_unit_of_the_input(self):
        f, g = function(BASES["cubic_spline"], 1), function(BASES["polynomial"], 2)
        form = normalised(BlockChain((f, FIRST, g)))
        ends = np.array(form.static[0].range)
        np.testing.assert_allclose(form.static[0](ends), ends, rtol=0.0, atol=1e-12)

    def test_held_blocks_stay(self):
        f = function(BASES["polynomial"])
        for held in ({0}, {1}, {2}, {0, 1}, {1, 2}):
            chain = BlockChain((FIRST, f, SECOND))
            form = normalised(chain, frozenset(held))
            for i in held:
                assert form.blocks[i] == chain.blocks[i]
            u = gaussian(300)
            np.testing.assert_allclose(
                form.response(u, "settled"), chain.response(u, "settled"), rtol=0.0, atol=1e-10
            )


def noisy(letters, samples=600, seed=0, static=None):
    """A record with coloured noise; static blocks are cubic unless it is said what they are."""
    u, truth = gaussian(samples, seed), truth_of(letters)
    if static is not None:
        blocks = (static if isinstance(one, StaticFunction) else one for one in truth.blocks)
        truth = BlockChain(tuple(blocks))
    y = truth.response(u, "settled")
    v = lfilter([1.0], [1.0, -0.8], gaussian(samples, seed + 1000))
    return Record(u, y + 0.1 * np.std(y) * v / np.std(v))


class TestGivenBlocks:
    def test_a_held_linear_block_stays_to_the_last_bit(self):
        given = hi.Arma(b=[1.0 / 3.0, 0.5], a=[0.9, -0.3])
        blocks = [hi.LinearBlock(nb=2, nf=2, start=given, held=True), *blocks_of("NL")[:1]]
        found = hi.fit(hi.PredictionError(blocks=blocks), noisy("LN"))
        assert model_of(found).chain.blocks[0] == TransferFunction((1.0 / 3.0, 0.5), (0.9, -0.3))
        assert found.values["se_b_0"] == found.values["se_a_1"] == 0.0

    @pytest.mark.parametrize("letters", ["NL", "LN", "LNL"])
    def test_a_held_function_stays_to_the_last_bit(self, letters):
        given = hi.PolynomialBlock(degree=3, range=(-3.0, 3.0), start=CUBIC, held=True)
        blocks = [given if one.kind == "polynomial" else one for one in blocks_of(letters)]
        found = hi.fit(hi.PredictionError(blocks=blocks), noisy(letters))
        assert model_of(found).chain.static[0] == given.given()

    def test_the_search_starts_where_it_is_told(self):
        # An even function behind a block far from its linear approximation, which is nothing.
        u = gaussian()
        y = FIRST.filter(u) ** 2
        begun = hi.LinearBlock(nb=2, nf=2, nk=1, start=hi.Arma(b=[0.0, 1.0, 0.5], a=[0.9, -0.3]))
        spec = hi.PredictionError(blocks=[begun, hi.PolynomialBlock(degree=2)], start="rest", starts=1)
        found = hi.fit(spec, Record(u, y))
        assert found.values["iterations"] == 0.0
        assert found.values["starts"] == 1.0
        np.testing.assert_allclose(model_of(found).simulate(Record(u, y)), y, rtol=0.0, atol=1e-10)


class TestExcitation:
    LINEAR = hi.LinearBlock(nb=2, nf=1)

    def refused(self, u, *blocks, n_init=0):
        y = lfilter([1.0, 0.5], [1.0, -0.5], u) + 0.1 * gaussian(len(u), 9)
        with pytest.raises(EstimationError) as caught:
            hi.fit(hi.PredictionError(blocks=blocks, n_init=n_init), Record(u, y))
        return str(caught.value)

    def test_two_levels_and_a_cubic(self):
        u = np.sign(gaussian())
        assert self.refused(u, hi.PolynomialBlock(degree=3), self.LINEAR) == (
            "the input (it has 2 levels) tells 4 of 6 numbers of the chain apart: use one with more "
            "levels or frequencies, or blocks with fewer coefficients, knots or a narrower range"
        )

    def test_one_sine_and_a_linear_block_of_five_numbers(self):
        u = np.sin(0.3 * np.arange(1000))
        # From a known state it is told apart by how it swings in.
        message = self.refused(u, hi.LinearBlock(nb=3, nf=2), n_init=200)
        assert message.startswith("the input tells 2 of 5 numbers of the chain apart: ")

    def test_four_levels_are_enough_for_a_cubic(self):
        u = np.random.default_rng(0).integers(0, 4, 1000).astype(float)
        y = lfilter([1.0, 0.5], [1.0, -0.5], u + 0.2 * u**3)
        spec = hi.PredictionError(blocks=[hi.PolynomialBlock(degree=3), self.LINEAR], start="rest")
        assert hi.fit(spec, Record(u, y)).values["mse"] < 1e-20 * np.var(y)


UNITS = {
    "polynomial": hi.PolynomialBlock(degree=3),
    "piecewise_linear": hi.PiecewiseLinearBlock(knots=5),
    "cubic_spline": hi.CubicSplineBlock(knots=4),
    "saturation": hi.SaturationBlock(),
    "dead_zone": hi.DeadZoneBlock(),
}


class TestInvariance:
    @pytest.mark.parametrize("kind", UNITS)
    @pytest.mark.parametrize("letters", ["NL", "LN", "LNL"])
    def test_units_of_input_and_output(self, kind, letters):
        blocks = [UNITS[kind] if one.kind == "polynomial" else one for one in blocks_of(letters)]
        spec, record = hi.PredictionError(blocks=blocks), noisy(letters, static=CORNERED.get(kind))
        own = model_of(hi.fit(spec, record)).simulate(record)
        other = Record(3e4 * record.u, 1e-3 * record.y)
        scaled = model_of(hi.fit(spec, other)).simulate(other)
        np.testing.assert_allclose(1e3 * scaled, own, rtol=0.0, atol=1e-6 * np.std(own))

    @pytest.mark.parametrize("letters", ["NL", "LN", "LNL"])
    def test_order_of_experiments(self, letters):
        one, other = noisy(letters, 400, 1), noisy(letters, 300, 2)
        spec = hi.PredictionError(blocks=blocks_of(letters), noise={"ar": 1}, n_init=5)

        def estimate(*records):
            u, y = (np.concatenate([getattr(record, name) for record in records]) for name in "uy")
            parts, begin = {}, 0
            for record in records:
                end = begin + len(record)
                parts[f"part {len(record)}"] = Part(
                    begin, end, 1.0, Held(np.arange(len(record), dtype=float), record.u)
                )
                begin = end
            return hi.fit(spec, Record(u, y, parts=parts)).values

        forward, backward = estimate(one, other), estimate(other, one)
        for name in (
            ("a_1", "b_0", "se_a_1", "mse") if letters != "LNL" else ("input_a_1", "output_b_0", "mse")
        ):
            assert forward[name] == pytest.approx(backward[name], rel=1e-5)


class TestStandardErrors:
    """The share of 95 % intervals that hold the truth, within three standard deviations of its own."""

    TRIALS = 100

    def share(self, spec, seed):
        truth = StaticFunction(Chebyshev(2, -4.0, 4.0), (4.0, 4.0, 4.0))
        linear = TransferFunction((0.4,), (0.6,))
        begun = [
            hi.PolynomialBlock(
                degree=2, range=(-4.0, 4.0), start=hi.Polynomial(coefficients=[0.0, 1.0, 0.5])
            ),
            hi.LinearBlock(nb=1, nf=1, start=hi.Arma(b=[0.4], a=[0.6])),
        ]
        chain = (truth, linear) if spec["letters"] == "NL" else (linear, truth)
        blocks = begun if spec["letters"] == "NL" else begun[::-1]
        estimator = hi.PredictionError(blocks=blocks, starts=1, start="rest", noise=spec["noise"])
        held = 0
        rng = np.random.default_rng(seed)
        for _ in range(self.TRIALS):
            u, e = rng.normal(size=(2, 250))
            y = BlockChain(chain).response(u) + lfilter([0.1], [1.0, -0.8], e)
            values = hi.fit(estimator, Record(u, y)).values
            held += abs(values["a_1"] - 0.6) < 1.96 * values["se_a_1"]
        return held / self.TRIALS

    @pytest.mark.parametrize("letters, ar", [("NL", 0), ("LN", 1)])
    def test_coverage(self, letters, ar):
        share = self.share({"letters": letters, "noise": {"ar": ar}}, 11)
        assert share == pytest.approx(0.95, abs=3.0 * np.sqrt(0.95 * 0.05 / self.TRIALS))


@pytest.fixture(scope="module")
def fitted():
    rng = np.random.default_rng(4)
    u, e = rng.normal(size=(2, 3000))
    y = truth_of("NL").response(u, "settled") + lfilter([1.0], [1.0, -0.9, 0.2], e)
    record = Record(u, y)
    spec = hi.PredictionError(blocks=blocks_of("NL"), noise={"ar": 2})
    return hi.fit(spec, record), record, e


class TestPrediction:
    def test_one_step_errors_are_the_innovations(self, fitted):
        found, record, e = fitted
        errors = record.y - model_of(found).predict(record)
        assert np.var(errors) == pytest.approx(np.var(e), rel=0.02)
        assert np.mean(errors**2) == pytest.approx(found.values["mse"], rel=1e-9)
        assert model_of(found).noise.variance == pytest.approx(found.values["mse"])

    def test_more_steps_lie_between_one_step_and_simulation(self, fitted):
        found, record, _ = fitted
        errors = [np.var(record.y - model_of(found).predict(record, k)) for k in (1, 2, 5, 50)]
        simulated = np.var(record.y - model_of(found).simulate(record))
        assert errors == sorted(errors)
        assert errors[0] < 0.9 * errors[1]
        assert errors[-1] == pytest.approx(simulated, rel=1e-3)

    def test_two_steps_leave_the_noise_of_two_innovations(self, fitted):
        found, record, e = fitted
        errors = record.y - model_of(found).predict(record, 2)
        # v_k = e_k + .9 e_{k-1} + what was known two samples before.
        assert np.var(errors) == pytest.approx((1.0 + 0.9**2) * np.var(e), rel=0.03)

    def test_without_a_noise_model_it_is_the_simulation(self):
        model = FittedModel(BlockChain((FIRST,)))
        record = Record(gaussian(50), gaussian(50, 1))
        np.testing.assert_array_equal(model.predict(record), model.simulate(record))

    def test_each_experiment_is_predicted_by_itself(self):
        model = FittedModel(BlockChain((FIRST,)), noise=NoiseModel((0.7,), (0.3,)))
        records = [Record(gaussian(40, k), gaussian(40, k + 5)) for k in range(2)]
        held = [Held(np.arange(40.0), one.u) for one in records]
        parts = {str(k): Part(40 * k, 40 * (k + 1), 1.0, held[k]) for k in range(2)}
        u, y = (np.concatenate([getattr(one, name) for one in records]) for name in "uy")
        joined = Record(u, y, parts=parts)
        expected = np.concatenate([model.predict(one, 3) for one in records])
        np.testing.assert_array_equal(model.predict(joined, 3), expected)


class TestRefusals:
    @pytest.mark.parametrize(
        "blocks, message",
        [
            ([{"kind": "polynomial", "degree": 2}] * 2, "blocks 1 and 2 are both static"),
            (
                [{"kind": "linear", "nb": 1, "start": {"kind": "fir", "b": [1.0]}, "held": True}],
                "all blocks are held: one at least must be found",
            ),
            ([{"kind": "linear", "nb": 1, "held": True}], "'held' needs 'start', the block that stays"),
        ],
    )
    def test_blocks_that_cannot_be(self, blocks, message):
        with pytest.raises(ConfigError, match=message):
            hi.PredictionError(blocks=blocks)


class TestSearch:
    """Systems whose best fit is met only by way of smooth functions."""

    FIRST = TransferFunction((0.54, 0.21, -0.11), (0.81, -0.63))
    SECOND = TransferFunction((0.137, 0.118, 0.016), (1.437, -0.512))
    ALONE = TransferFunction((0.96, -1.32, 0.45), (1.488, -0.53))

    def ratio(self, blocks, y, u, seed):
        """The mean squared error of the fit over the noise's."""
        v = lfilter([1.0], [1.0, -1.2, 0.5], gaussian(len(u), seed + 50))
        v *= 0.056 * np.std(y) / np.std(v)
        spec = hi.PredictionError(blocks=blocks, start="rest")
        return hi.fit(spec, Record(u, y + v)).values["mse"] / np.mean(v**2)

    def test_functions_that_turn_back_around_a_linear_block(self):
        u = gaussian(2000, 0)
        y = CUBIC(self.ALONE.filter(CUBIC(u)))
        spline, linear = hi.CubicSplineBlock(knots=6), hi.LinearBlock(nb=3, nf=2)
        assert self.ratio([spline, linear, spline], y, u, 0) < 1.05

    def test_cubic_polynomials_that_prefer_another_optimum_than_the_splines(self):
        u = gaussian(2000, 0)
        alone = TransferFunction((0.176, 0.059, 0.158), (1.229, -0.339))
        x = alone.filter(np.tanh(u) + 0.18 * u**2)
        x /= np.std(x)
        y = np.tanh(x) - 0.15 * x**2
        spline, linear = hi.CubicSplineBlock(knots=6), hi.LinearBlock(nb=3, nf=2)
        # What splines of six knots leave of such functions is not the noise alone.
        assert self.ratio([spline, linear, spline], y, u, 0) < 1.15

    @pytest.mark.parametrize("seed", range(4))
    def test_zeros_that_the_linear_approximation_puts_into_the_wrong_block(self, seed):
        # Two real zeros of different blocks, near each other: noise makes a pair of them.
        first = TransferFunction((0.173, 0.412, -0.273), (1.357, -0.733))
        second = TransferFunction((0.329, -0.934, 0.137), (0.666, -0.511))
        u = gaussian(2000, seed)
        x = first.filter(u)
        x /= np.std(x)
        y = second.filter(x + 0.1 * x**2 - 0.05 * x**3)
        linear = hi.LinearBlock(nb=3, nf=2)
        assert self.ratio([linear, hi.PolynomialBlock(degree=3), linear], y, u, seed) < 1.05

    def test_only_the_starts_that_are_asked_for(self):
        record = noisy("NL")
        found = {
            of: hi.fit(hi.PredictionError(blocks=blocks_of("NL"), initialisation=of), record).values
            for of in (("linear_approximation",), ("over_parameterised",))
        }
        every = hi.fit(hi.PredictionError(blocks=blocks_of("NL"), starts=1000), record).values["starts"]
        assert all(0 < one["starts"] < every for one in found.values())

    def test_no_start_suits_the_structure(self):
        spec = hi.PredictionError(blocks=blocks_of("NL"), initialisation=["volterra_kernel"])
        with pytest.raises(EstimationError, match="no start could be made"):
            hi.fit(spec, noisy("NL"))

    @pytest.mark.parametrize("held", [False, True])
    def test_starts_of_fewer_blocks_are_for_two_linear_blocks_that_are_sought(self, held):
        u = gaussian(600, 0)
        record = hi.Record(u, self.SECOND.filter(np.abs(self.FIRST.filter(u))))
        first = hi.LinearBlock(nb=3, nf=2, start=hi.Arma(b=[1.0], a=[0.5]), held=held)
        blocks = [
            first if held else hi.LinearBlock(nb=3, nf=2),
            hi.CubicSplineBlock(knots=6),
            hi.LinearBlock(nb=3, nf=2),
        ]
        spec = hi.PredictionError(blocks=blocks, max_iterations=5)
        asked = spec.model_copy(update={"initialisation": (*spec.initialisation, "fewer_linear_blocks")})
        alone, more = (hi.fit(one, record).values for one in (spec, asked))
        assert more["finalists"] == alone["finalists"] + (0 if held else 2)
        assert more["mse"] <= alone["mse"]

    def test_an_even_function_between_linear_blocks(self):
        u = gaussian(2000, 0)
        y = self.SECOND.filter(np.abs(self.FIRST.filter(u)))
        spline, linear = hi.CubicSplineBlock(knots=6), hi.LinearBlock(nb=3, nf=2)
        assert self.ratio([linear, spline, linear], y, u, 0) < 1.05
