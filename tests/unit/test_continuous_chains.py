"""Chains with continuous linear blocks by prediction error: exactness, standard errors, what is refused."""

from dataclasses import replace

import numpy as np
import pytest

import hident as hi
from hident.block_chain import Block, BlockChain
from hident.errors import ConfigError, EstimationError
from hident.estimators.prediction_error.continuous_structure import ContinuousStructure
from hident.estimators.prediction_error.criterion import Data, point_at
from hident.estimators.prediction_error.parameters import LinearStructure, Parameters, StaticStructure
from hident.fitted_model import FittedModel, NoiseModel
from hident.linear_blocks import ContinuousTransferFunction, TransferFunction
from hident.records import Held, Part, Record, needed
from hident.sampled_blocks import SampledTransferFunction
from hident.static_functions import Chebyshev, CubicSpline, StaticFunction

DT = 0.2
FIRST = ContinuousTransferFunction((1.0, 0.5), (1.2, 0.8))
SECOND = ContinuousTransferFunction((1.0,), (0.7,), 0.3)
DISCRETE = TransferFunction((0.5, 0.2), (0.3,))
CUBIC = StaticFunction(CubicSpline((-3.0, -1.0, 0.0, 2.0, 3.0)), (-3.0, -2.0, -0.5, 0.3, 1.0, 2.5, 2.0))
LINEAR = {
    "hammerstein": hi.Continuous(a=[4, 4, 3], b=[1, -1], delay=2),
    "wiener": hi.Continuous(a=[4, 5, 2], b=[1, -2], delay=1),
}
CHEN = {
    "hammerstein": hi.Hammerstein(
        nonlinearity=hi.PiecewiseLinear(points=[[-1.5, -0.7], [-0.5, -0.5], [0.5, 0.5], [1.5, 0.7]]),
        linear=LINEAR["hammerstein"],
    ),
    "wiener": hi.Wiener(
        nonlinearity=hi.PiecewiseLinear(points=[[-1, -0.7], [-0.4, -0.2], [0, 0], [0.5, 0.5], [1.5, 0.9]]),
        linear=LINEAR["wiener"],
    ),
}


def model_of(found):
    """The chain of blocks that an estimate holds."""
    assert isinstance(found.model, FittedModel)
    return found.model


def steps(samples=600, seed=0, hold=3):
    return np.repeat(np.random.default_rng(seed).normal(size=samples // hold + 1), hold)[:samples]


def chain_of(letters):
    """Continuous blocks C, of which the first one's input is held, discrete ones D, and functions N."""
    blocks: list[Block] = []
    moves = False
    continuous = iter((FIRST, SECOND, FIRST))
    for letter in letters:
        if letter == "C":
            blocks.append(SampledTransferFunction(next(continuous), DT, "linear" if moves else "held"))
            moves = True
        else:
            blocks.append(DISCRETE if letter == "D" else CUBIC)
    return BlockChain(tuple(blocks), DT)


def smooth(letters):
    wide = Chebyshev(3, -20.0, 20.0)
    grid = np.linspace(-20.0, 20.0, 4)
    cubic = np.linalg.solve(wide.rows(grid).T, grid + 0.1 * grid**2 + 0.02 * grid**3)
    function = StaticFunction(wide, tuple(cubic.tolist()))
    chain = chain_of(letters)
    return replace(chain, blocks=tuple(function if one is CUBIC else one for one in chain.blocks))


def structure_of(block):
    if isinstance(block, SampledTransferFunction):
        one = block.continuous
        return ContinuousStructure.of(len(one.a), len(one.a) - 1, one.delay, DT, block.intersample)
    if isinstance(block, TransferFunction):
        return LinearStructure(len(block.b), len(block.a))
    return StaticStructure(block.basis)


@pytest.mark.parametrize("letters", ["C", "NC", "CN", "CNC", "NCN", "CNCNC", "CND", "DNC"])
@pytest.mark.parametrize("start", ["rest", "settled"])
@pytest.mark.parametrize("noise", [NoiseModel(), NoiseModel((0.6, -0.2), (0.5,))])
def test_derivatives(letters, start, noise):
    rng = np.random.default_rng(5)
    chain, u = smooth(letters), rng.normal(0.3, 1.0, 150)
    parts = (slice(0, 90), slice(90, 150))
    y = np.concatenate([chain.response(u[part], start) for part in parts])
    data = Data(u, y + 0.1 * np.std(y) * rng.normal(size=150), parts, start, 7)
    point = point_at(data, Parameters.of([structure_of(one) for one in chain.blocks], chain), noise)
    assert point is not None
    rows, theta, solved = point.rows(), point.theta, np.zeros(len(point.projected_rows))
    for k, row in enumerate(rows):
        sides = []
        for sign in (1e-6, -1e-6):
            moved = np.concatenate((theta, solved))
            moved[k] += sign
            sides.append(needed(point.prediction(moved[: len(theta)], moved[len(theta) :])))
        expected = (sides[0] - sides[1]) / 2e-6
        size = float(np.max(np.abs(expected))) or 1.0
        np.testing.assert_allclose(row / size, expected / size, rtol=0.0, atol=1e-6)


def blocks_of(letters):
    """What fits the chain of these letters, polynomials over ranges that no signal leaves."""
    continuous, found = iter(({"n": 2, "m": 1}, {"n": 1, "delay": 0.3})), []
    for letter in letters:
        found.append(
            hi.ContinuousBlock(**next(continuous)) if letter == "C" else hi.PolynomialBlock(degree=3)
        )
    return found


@pytest.mark.parametrize("letters", ["C", "NC", "CN", "CNC", "NCN"])
@pytest.mark.parametrize("start", ["rest", "settled"])
def test_without_noise_the_blocks_are_found(letters, start):
    u, truth = steps(), smooth(letters)
    y = truth.response(u, start)
    found = model_of(hi.fit(hi.PredictionError(blocks=blocks_of(letters), start=start), Record(u, y, DT)))
    np.testing.assert_allclose(found.simulate(u), y, rtol=0.0, atol=1e-7 * float(np.std(y)))
    for block, true in zip(found.chain.linear, truth.linear, strict=True):
        assert isinstance(block, SampledTransferFunction)
        assert isinstance(true, SampledTransferFunction)
        assert block.intersample == true.intersample
        np.testing.assert_allclose(block.continuous.a, true.continuous.a, rtol=1e-6)
        np.testing.assert_allclose(block.continuous.b, true.continuous.b, rtol=1e-6)


def test_alternating_blocks_of_five():
    """L-N-L-N-L in continuous time."""
    u, truth = steps(1500), smooth("CNCNC")
    y = truth.response(u)
    y = y + 0.01 * np.std(y) * np.random.default_rng(1).normal(size=len(u))
    blocks = [*blocks_of("CNCN"), hi.ContinuousBlock(n=2, m=1)]
    found = hi.fit(hi.PredictionError(blocks=blocks, start="rest"), Record(u, y, DT))
    assert model_of(found).chain.structure == "L-N-L-N-L"
    # Two in a hundred of the noise's variance are what nearly thirty numbers cost.
    error = np.mean((model_of(found).simulate(u) - truth.response(u)) ** 2)
    assert error < 0.05 * (0.01 * np.std(y)) ** 2


def test_discrete_and_continuous_blocks_stand_in_one_chain():
    u = steps()
    truth = BlockChain((DISCRETE, smooth("N").blocks[0], SampledTransferFunction(SECOND, DT)))
    y = truth.response(u)
    blocks = [hi.LinearBlock(nb=2, nf=1), hi.PolynomialBlock(degree=3), hi.ContinuousBlock(n=1, delay=0.3)]
    spec = hi.PredictionError(blocks=blocks, start="rest")
    found = hi.fit(spec, Record(u, y, DT))
    np.testing.assert_allclose(model_of(found).simulate(u), y, rtol=0.0, atol=1e-7 * float(np.std(y)))
    assert found.values["output_a_1"] == pytest.approx(0.7, rel=1e-6)
    # Behind a discrete block the input is held, and its letters have no meaning of their own.
    assert model_of(found).chain.linear[1].intersample == "held"
    assert spec.letters() == {}


@pytest.mark.parametrize("kind", CHEN)
class TestChen:
    """The systems of Chen, Hwang and Chang 2009, with the truth beside the estimates."""

    STEPS = hi.Multistep(switching_time=1, std=1.25, limits=[-2.5, 2.5])

    def record(self, kind, seed, **noise):
        return hi.simulate(CHEN[kind], self.STEPS, 1201, dt=0.1, seed=seed, **noise)

    def spec(self, kind):
        linear = hi.ContinuousBlock(n=3, m=1, delay=LINEAR[kind].delay)
        if kind == "hammerstein":
            # Knots where the segments meet.
            corners = hi.PiecewiseLinearBlock(knots=6, range=[-2.5, 2.5])
            return hi.PredictionError(blocks=[corners, linear], start="rest")
        return hi.PredictionError(blocks=[linear, hi.PiecewiseLinearBlock(knots=15)], start="rest")

    def test_coefficients_are_within_their_standard_errors(self, kind):
        linear = LINEAR[kind]
        true = {f"a_{i}": a for i, a in enumerate(linear.a, 1)} | {"b_1": linear.b[1]}
        apart = []
        for seed in range(10):
            values = hi.fit(self.spec(kind), self.record(kind, seed, noise=hi.White(nsr=0.05))).values
            assert values["b_0"] == 1.0
            assert values["se_b_0"] == 0.0
            apart.append([(values[name] - value) / values[f"se_{name}"] for name, value in true.items()])
        # Forty numbers of variance one, nearly: their mean square has a standard deviation of .22.
        assert 0.3 < np.mean(np.square(apart)) < (1.7 if kind == "hammerstein" else 2.0)

    def test_the_discrete_fit_leaves_as_much(self, kind):
        record, spec = self.record(kind, 3, noise=hi.White(nsr=0.05)), self.spec(kind)
        nk = 1 + round(LINEAR[kind].delay / 0.1)
        other = [
            hi.LinearBlock(nb=3, nf=3, nk=nk) if isinstance(one, hi.ContinuousBlock) else one
            for one in spec.blocks
        ]
        mse = hi.fit(spec, record).values["mse"]
        # One coefficient more: a little less is left.
        assert mse == pytest.approx(
            hi.fit(spec.model_copy(update={"blocks": tuple(other)}), record).values["mse"], rel=5e-3
        )

    def test_the_estimate_is_continuous(self, kind):
        record, spec = self.record(kind, 1, noise=hi.White(nsr=0.05)), self.spec(kind)
        found = hi.fit(spec, record)
        assert found.linear is None
        assert "continuous" in spec.provides()
        assert "linear" not in spec.provides()
        assert found.continuous == model_of(found).chain.linear[0].continuous
        scores = hi.score(found, record, error=hi.LinearPercentError(step=1))
        assert scores["error"] < 5.0
        # A held input at half the interval has the same response at the samples they share.
        u = record.u[:200]
        assert found.response is not None
        half = found.response(np.repeat(u, 2), 0.05)[::2]
        np.testing.assert_allclose(half, found.response(u, 0.1), rtol=0.0, atol=1e-8)


class TestBetweenSamples:
    """A Wiener-Hammerstein system whose signals move between samples, as those of a process do."""

    SYSTEM = hi.WienerHammerstein(
        input_linear=hi.Continuous(a=[0.8]),
        nonlinearity=hi.Polynomial(coefficients=[0, 1, 0.3, -0.1]),
        output_linear=hi.Continuous(a=[1.0, 0.5], b=[1, 0.3]),
    )

    def values(self, dt, **second):
        record = hi.simulate(self.SYSTEM, hi.Multistep(switching_time=1, std=1), round(240 / dt), dt=dt)
        blocks = [
            hi.ContinuousBlock(n=1),
            hi.PolynomialBlock(degree=3),
            hi.ContinuousBlock(n=2, m=1, **second),
        ]
        found = hi.fit(hi.PredictionError(blocks=blocks, start="rest"), record).values
        return found, float(np.sqrt(found["mse"]) / np.std(record.y))

    def test_straight_lines_are_off_by_the_square_of_the_interval(self):
        _, coarse = self.values(0.1)
        found, fine = self.values(0.05)
        assert coarse < 1e-3
        assert 3.0 < coarse / fine < 6.0
        assert found["output_a_1"] == pytest.approx(1.0, rel=1e-3)
        assert found["output_a_2"] == pytest.approx(0.5, rel=1e-3)

    def test_held_inputs_are_late_by_half_a_sample(self):
        found, left = self.values(0.1, intersample="held")
        assert left > 10.0 * self.values(0.1)[1]
        assert abs(found["output_a_2"] / 0.5 - 1.0) > 0.05


class TestGivenBlocks:
    SPEC = {"n": 2, "m": 1, "start": hi.Continuous(a=[1.2, 0.8], b=[1.0 / 3.0, 0.5])}

    def record(self):
        u = steps()
        y = chain_of("CN").response(u, "settled")
        return Record(u, y + 0.1 * np.std(y) * np.random.default_rng(1).normal(size=len(u)), DT)

    def test_a_held_block_stays_to_the_last_bit(self):
        blocks = [hi.ContinuousBlock(**self.SPEC, held=True), hi.CubicSplineBlock(knots=5)]
        found = hi.fit(hi.PredictionError(blocks=blocks), self.record())
        [linear] = model_of(found).chain.linear
        assert isinstance(linear, SampledTransferFunction)
        assert linear.continuous == ContinuousTransferFunction((1.0 / 3.0, 0.5), (1.2, 0.8))
        assert found.values["se_a_1"] == found.values["se_b_1"] == 0.0

    def test_the_search_starts_where_it_is_told(self):
        u = steps()
        truth = smooth("CN")
        blocks = [
            hi.ContinuousBlock(n=2, m=1, start=hi.Continuous(a=[1.2, 0.8], b=[1.0, 0.5])),
            blocks_of("N")[0],
        ]
        y = truth.response(u)
        found = hi.fit(hi.PredictionError(blocks=blocks, start="rest", starts=1), Record(u, y, DT))
        assert found.values["iterations"] == 0.0
        np.testing.assert_allclose(model_of(found).simulate(u), y, rtol=0.0, atol=1e-9 * np.std(y))

    def test_beside_a_held_function(self):
        given = hi.PolynomialBlock(degree=1, range=(-3.0, 3.0), start="identity", held=True)
        found = hi.fit(hi.PredictionError(blocks=[given, hi.ContinuousBlock(n=2, m=1)]), self.record())
        assert model_of(found).chain.static[0] == given.given()
        # The gain stays in the linear block: nothing else can take it.
        assert found.values["b_0"] != 1.0
        assert found.values["se_b_0"] > 0.0


def test_several_experiments():
    u = steps(400)
    parts = {
        str(k): Part(200 * k, 200 * (k + 1), DT, Held(DT * np.arange(200.0), u[200 * k : 200 * (k + 1)]))
        for k in range(2)
    }
    truth = smooth("NC")
    y = np.concatenate([truth.response(u[one.samples], "settled") for one in parts.values()])
    found = hi.fit(hi.PredictionError(blocks=blocks_of("NC")), Record(u, y, DT, parts=parts))
    assert found.values["a_2"] == pytest.approx(0.8, rel=1e-6)


class TestRefusals:
    @pytest.mark.parametrize(
        "block, message",
        [
            ({"n": 2, "m": 2}, "the order m = 2 of the numerator must be below n = 2"),
            ({"n": 2, "delay": 1.0, "nk": 2}, "give either 'delay', in the unit of dt, or 'nk', in samples"),
            ({"n": 1, "held": True}, "'held' needs 'start', the block that stays"),
            ({"n": 1, "start": {"kind": "ar", "a": [0.5]}}, "'start' must be a continuous block, not ar"),
            (
                {"n": 1, "start": {"kind": "continuous", "integrators": 1}},
                "'start' has a pole at 0, and the blocks that are fitted are stable",
            ),
            (
                {"n": 2, "start": {"kind": "continuous", "a": [1.0]}},
                "'start' has the orders 1 and 0, not n = 2 and m = 0",
            ),
            (
                {"n": 1, "start": {"kind": "continuous", "a": [1.0], "delay": 0.5}},
                "'start' has the delay 0.5, and the block 0",
            ),
        ],
    )
    def test_blocks_that_cannot_be(self, block, message):
        with pytest.raises(ConfigError) as caught:
            hi.PredictionError(blocks=[{"kind": "continuous", **block}, {"kind": "polynomial", "degree": 2}])
        assert message in str(caught.value)

    def test_a_record_without_sampling_interval(self):
        spec = hi.PredictionError(blocks=[hi.ContinuousBlock(n=1)])
        with pytest.raises(EstimationError, match="needs the sampling interval 'dt' of the data"):
            spec.fit(Record(steps(), steps(seed=1)))
        with pytest.raises(ValueError, match="needs the sampling interval 'dt' of the data"):
            spec.check(100, None)
        with pytest.raises(ValueError, match="needs the sampling interval 'dt' of the data"):
            spec.structure()

    @pytest.mark.parametrize("delay", [{"delay": 20.0}, {"nk": 100}, {"delay": 1e15}])
    def test_a_delay_as_long_as_the_record(self, delay):
        spec = hi.PredictionError(blocks=[hi.ContinuousBlock(n=1, **delay)])
        with pytest.raises(
            EstimationError, match=r"the delay .* of block 1 is as long as a record of 100 sam"
        ):
            spec.fit(Record(steps(100), steps(100, 1), DT))
        with pytest.raises(ValueError, match=r"samples every 0\.2"):
            spec.check(100, DT)


class TestOtherIntervals:
    def test_a_chain_of_continuous_blocks_has_samples_at_any(self):
        chain, u = chain_of("NC"), steps(100)
        assert chain.is_continuous
        expected = chain.response(u)
        np.testing.assert_allclose(chain.every(DT / 4).response(np.repeat(u, 4))[::4], expected, atol=1e-9)
        assert chain.every(DT) is chain

    def test_a_record_says_at_which(self):
        model, u = FittedModel(chain_of("NC"), start="rest"), np.repeat(steps(100), 2)
        record = Record(u, u, DT / 2)
        expected = model.chain.every(DT / 2).response(u)
        np.testing.assert_array_equal(model.simulate(record), expected)
        np.testing.assert_array_equal(model.signals(record)[-1], expected)
        np.testing.assert_array_equal(model.predict(record), expected)
        noisy = replace(model, noise=NoiseModel((0.5,)))
        with pytest.raises(ValueError, match=r"the noise model is one of samples every 0\.2, not 0\.1"):
            noisy.predict(record)
        assert noisy.every(DT / 2).noise == NoiseModel()

    def test_one_with_a_discrete_block_has_not(self):
        with pytest.raises(ValueError, match="at its own interval only"):
            chain_of("DNC").every(0.1)
