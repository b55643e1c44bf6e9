"""Static blocks of given functions: what they know of their argument's unit, fits, files, other programs."""

from typing import Any

import numpy as np
import pytest

import hident as hi
from hident.block_chain import BlockChain
from hident.config.expression import Formula
from hident.errors import ConfigError, EstimationError
from hident.estimators.nonparametric.bases import BasisSpec
from hident.estimators.prediction_error.gauge import normalised
from hident.fitted_model import FittedModel
from hident.linear_blocks import ContinuousTransferFunction, TransferFunction
from hident.records import Record, needed
from hident.sampled_blocks import SampledTransferFunction
from hident.static_functions import Chebyshev, StaticFunction
from hident.systems.function_basis import Functions, Series

TANH = hi.Expression(expression="tanh(2*u)")
HALF = hi.Expression(expression="where(u > 0, u**2, 0)")
POWERS = (hi.Power(exponent=0), hi.Identity(), hi.Expression(expression="u**2"), hi.Abs())
BENT = (hi.Identity(), TANH, HALF)
LINEAR = TransferFunction((0.5, 0.2), (0.6,))
OTHER = TransferFunction((1.0, -0.3), (0.5,))


def gaussian(samples=800, seed=0):
    return np.random.default_rng(seed).normal(size=samples)


def model_of(found):
    assert isinstance(found.model, FittedModel)
    return found.model


def of(functions, *coefficients):
    return StaticFunction(Functions(tuple(functions), -4.0, 4.0), coefficients)


class TestBasis:
    X = np.array([-1.5, -0.2, 0.3, 2.0])

    def test_it_is_the_sum_of_its_functions_everywhere(self):
        function = of(BENT, 0.3, 1.0, 0.2)
        x = np.array([-100.0, -1.0, 0.5, 50.0])
        np.testing.assert_allclose(function(x), 0.3 * x + np.tanh(2 * x) + 0.2 * np.where(x > 0, x**2, 0))

    def test_its_slope(self):
        function, step = of(BENT, 0.3, 1.0, 0.2), 1e-6
        expected = (function(self.X + step) - function(self.X - step)) / (2 * step)
        np.testing.assert_allclose(function.slope(self.X), expected, rtol=1e-8)

    @pytest.mark.parametrize("factor", [2.5, -0.4])
    def test_powers_take_over_a_factor(self, factor):
        function = of(POWERS, 0.5, 1.0, -0.3, 2.0)
        assert Functions(POWERS, -1.0, 1.0).is_free_of_scale()
        np.testing.assert_allclose(function.moved(factor, 0.0)(factor * self.X), function(self.X), rtol=1e-12)

    def test_others_hold_in_a_unit_of_their_own(self):
        assert not Functions(BENT, -1.0, 1.0).is_free_of_scale()
        with pytest.raises(ValueError, match="hold in the unit of their argument"):
            of(BENT, 1.0, 1.0, 1.0).moved(2.0, 0.0)
        with pytest.raises(ValueError, match="hold in the unit of their argument"):
            of(POWERS, 1.0, 1.0, 1.0, 1.0).moved(2.0, 0.5)

    def test_one_that_is_neither_even_nor_odd_is_not_turned_round(self):
        np.testing.assert_allclose(of([HALF], 2.0).moved(2.0, 0.0)(2.0 * self.X), of([HALF], 2.0)(self.X))
        with pytest.raises(ValueError, match="for one sign of their argument"):
            of([HALF], 2.0).moved(-2.0, 0.0)

    def test_an_offset_needs_a_constant(self):
        np.testing.assert_allclose(of(POWERS, 1, 1, 0, 0).scaled(2.0, 3.0)(self.X), 5.0 + 2.0 * self.X)
        with pytest.raises(ValueError, match="none of the functions is constant"):
            of(BENT, 1, 1, 1).scaled(2.0, 3.0)
        np.testing.assert_allclose(of(BENT, 1, 0, 0).scaled(2.0, 0.0)(self.X), 2.0 * self.X)


class TestNormalForm:
    CUBIC = StaticFunction(Chebyshev(3, -3.0, 3.0), (0.2, 2.0, 0.3, 0.5))

    @pytest.mark.parametrize("start", ["rest", "settled"])
    @pytest.mark.parametrize("functions", [POWERS, BENT, (HALF,)])
    def test_it_keeps_the_response(self, functions, start):
        u, f = gaussian(300), of(functions, *np.arange(1.0, 1.0 + len(functions)).tolist())
        for blocks in (
            (LINEAR, f),
            (f, LINEAR),
            (LINEAR, f, OTHER),
            (self.CUBIC, LINEAR, f),
            (f, LINEAR, self.CUBIC),
        ):
            chain = BlockChain(blocks)
            form = normalised(chain, start=start)
            expected = chain.response(u, start)
            size = np.max(np.abs(expected))
            np.testing.assert_allclose(form.response(u, start), expected, rtol=0.0, atol=1e-10 * size)

    def test_a_factor_goes_where_it_can(self):
        form = normalised(BlockChain((LINEAR, of(POWERS, 1, 1, 1, 1))))
        assert form.linear[0].static_gain() == pytest.approx(1.0)
        form = normalised(BlockChain((LINEAR, of(BENT, 1, 1, 1))))
        assert form.linear[0] == LINEAR
        form = normalised(BlockChain((of(BENT, 1, 1, 1), LINEAR)))
        assert form.linear[0].static_gain() == pytest.approx(1.0)
        # Behind a function and before one that takes none, the first has it.
        form = normalised(BlockChain((of(POWERS, 1, 1, 1, 1), LINEAR, of(BENT, 1, 1, 1))))
        assert form.linear[0].static_gain() == pytest.approx(1.0)


def blocks_of(letters, functions):
    return [
        hi.LinearBlock(nb=2, nf=1) if letter == "L" else hi.ExpansionBlock(basis=functions)
        for letter in letters
    ]


@pytest.mark.parametrize("letters", ["NL", "LN", "LNL"])
def test_without_noise_the_blocks_are_found(letters):
    u, linear = gaussian(), iter((LINEAR, OTHER))
    truth = BlockChain(tuple(next(linear) if one == "L" else of(BENT, 0.3, 1.0, 0.2) for one in letters))
    y = truth.response(u)
    spec = hi.PredictionError(blocks=blocks_of(letters, BENT), start="rest")
    found = model_of(hi.fit(spec, Record(u, y)))
    np.testing.assert_allclose(found.simulate(u), y, rtol=0.0, atol=1e-9 * float(np.std(y)))
    if letters == "LN":
        # The gain is a property of the data: tanh(2 u) knows its unit.
        np.testing.assert_allclose(found.chain.linear[0].b, LINEAR.b, rtol=1e-7)
        np.testing.assert_allclose(found.chain.static[0].coefficients, (0.3, 1.0, 0.2), rtol=1e-7)
        assert spec.normalisations() is None
        assert spec.free_parameters() == 6
    if letters == "NL":
        assert found.chain.linear[0].static_gain() == pytest.approx(1.0)
        assert spec.free_parameters() == 5


def test_the_gain_has_a_standard_error_that_holds():
    u, truth = gaussian(), BlockChain((LINEAR, of(BENT[:2], 0.3, 1.0)))
    y = truth.response(u)
    apart = []
    for seed in range(30):
        noisy = Record(u, y + 0.05 * gaussian(seed=100 + seed))
        values = hi.fit(hi.PredictionError(blocks=blocks_of("LN", BENT[:2]), start="rest"), noisy).values
        apart.append((values["b_0"] - 0.5) / values["se_b_0"])
    # Two systems give the same response: tanh and u are odd.
    turned = np.abs(np.array(apart)) > 8.0
    assert np.sum(turned) in range(31)
    spread = np.std(np.array(apart)[~turned])
    assert 0.6 < spread < 1.4


def test_between_continuous_blocks():
    dt, u = 0.2, np.repeat(gaussian(300), 3)
    first = SampledTransferFunction(ContinuousTransferFunction((1.0,), (0.8,)), dt)
    second = SampledTransferFunction(ContinuousTransferFunction((1.0,), (0.5, 0.3)), dt, "linear")
    y = BlockChain((first, of(BENT, 0.3, 1.0, 0.2), second)).response(u)
    blocks = [hi.ContinuousBlock(n=1), hi.ExpansionBlock(basis=BENT), hi.ContinuousBlock(n=2)]
    found = hi.fit(hi.PredictionError(blocks=blocks, start="rest"), Record(u, y, dt))
    assert found.values["input_b_0"] == pytest.approx(1.0, rel=1e-6)
    assert found.values["output_a_2"] == pytest.approx(0.3, rel=1e-6)


def test_alternating_blocks_with_given_functions_and_a_continuous_block():
    """L-N-L-N-L of blocks of all sorts."""
    dt, u = 0.2, np.repeat(gaussian(500), 3)
    middle = SampledTransferFunction(ContinuousTransferFunction((1.0,), (0.6,)), dt)
    cubic = StaticFunction(Chebyshev(3, -6.0, 6.0), (0.0, 5.0, 1.0, 1.0))
    one = TransferFunction((0.4,), (0.6,))
    truth = BlockChain((one, of(BENT[:2], 1.0, 0.5), middle, cubic, TransferFunction((0.7,), (0.3,))))
    y = truth.response(u)
    noise = 0.01 * np.std(y)
    record = Record(u, y + noise * gaussian(len(u), 9), dt)
    lag = hi.LinearBlock(nb=1, nf=1)
    chain = [
        lag,
        hi.ExpansionBlock(basis=BENT[:2]),
        hi.ContinuousBlock(n=1),
        hi.PolynomialBlock(degree=3),
        lag,
    ]
    found = model_of(hi.fit(hi.PredictionError(blocks=chain, start="rest"), record))
    assert found.chain.structure == "L-N-L-N-L"
    assert np.mean((found.simulate(u) - y) ** 2) < 0.05 * noise**2


class TestGiven:
    def test_a_held_expansion_stays_to_the_last_bit(self):
        block = hi.ExpansionBlock(
            basis=[TANH, "identity"],
            range=[-2, 2],
            start=hi.Expression(expression="tanh(2*u) - u/3"),
            held=True,
        )
        given = block.given()
        assert given is not None
        np.testing.assert_allclose(given.coefficients, (1.0, -1.0 / 3.0), rtol=1e-12)
        u = gaussian()
        y = LINEAR.filter(given(u)) + 0.1 * gaussian(seed=1)
        found = hi.fit(
            hi.PredictionError(blocks=[block, hi.LinearBlock(nb=2, nf=1)], start="rest"), Record(u, y)
        )
        assert model_of(found).chain.static[0] == given

    def test_the_search_starts_where_it_is_told(self):
        block = hi.ExpansionBlock(basis=[TANH, "identity"], range=[-2, 2], start=TANH)
        u = gaussian()
        y = np.tanh(2 * LINEAR.filter(u))
        begun = hi.LinearBlock(nb=2, nf=1, start=hi.Arma(b=[0.5, 0.2], a=[0.6]))
        found = hi.fit(hi.PredictionError(blocks=[begun, block], start="rest", starts=1), Record(u, y))
        assert found.values["iterations"] == 0.0
        np.testing.assert_allclose(found.values["b_0"], 0.5, rtol=1e-9)


class TestRefusals:
    def test_a_formula_outside_the_whitelist(self):
        with pytest.raises(ConfigError, match="unknown function 'tan2'"):
            hi.ExpansionBlock(basis=[{"kind": "expression", "expression": "tan2(u)"}])

    def test_a_nonlinearity_with_memory(self):
        with pytest.raises(ConfigError, match="backlash has memory"):
            hi.ExpansionBlock(basis=[{"kind": "backlash", "width": 1}])

    def test_a_function_that_is_not_finite_on_the_input(self):
        log = hi.ExpansionBlock(basis=[hi.Expression(expression="log(u)")])
        u = gaussian(500)
        with pytest.raises(EstimationError, match=r"a static function is not finite at \d+ of 500 samples"):
            hi.fit(hi.PredictionError(blocks=[log, hi.LinearBlock(nb=1)]), Record(u, u + gaussian(500, 1)))


class TestFiles:
    FUNCTIONS = (
        *BENT,
        hi.ChenType3(),
        hi.Saturation(low=-1, high=np.inf),
        hi.Expression(expression="u**2 != u"),
    )
    MODEL = FittedModel(
        BlockChain((of(FUNCTIONS, 0.1, 1 / 3, -2.0, 0.5, 1.5, 0.25), LINEAR), 0.5),
        errors=({"c_2": 0.012}, {}),
    )

    def test_a_model_is_read_to_the_last_bit(self, tmp_path):
        hi.write_model(self.MODEL, tmp_path / "model.json")
        assert hi.load_model(tmp_path / "model.json").chain == self.MODEL.chain

    def test_a_function_that_is_not_known(self, tmp_path):
        hi.write_model(self.MODEL, tmp_path / "model.json")
        content = (tmp_path / "model.json").read_text().replace('"chen_type_3"', '"chen_type_9"')
        (tmp_path / "model.json").write_text(content)
        with pytest.raises(ConfigError, match=r"blocks\[0\].functions\[3\].*did you mean 'chen_type_4'"):
            hi.load_model(tmp_path / "model.json")

    @pytest.mark.parametrize("to", ["python", "scipy"])
    def test_python(self, to):
        names: dict[str, Any] = {}
        exec(hi.convert(self.MODEL, to), names)
        u = 2.0 * gaussian(200)
        np.testing.assert_allclose(names["response"](u), self.MODEL.simulate(u), rtol=0.0, atol=1e-12)

    def test_control(self):
        control = pytest.importorskip("control")
        names: dict[str, Any] = {}
        exec(hi.convert(self.MODEL, "control"), names)
        u = 2.0 * gaussian(50)
        state = names["initial_state"](u[0])
        found = control.input_output_response(names["system"](), 0.5 * np.arange(50), u, state).outputs
        np.testing.assert_allclose(found, self.MODEL.simulate(u), rtol=0.0, atol=1e-10)

    def test_matlab(self):
        source = hi.convert(self.MODEL, "matlab")
        assert "@(u) tanh((2.0 .* u))" in source
        assert "@(u) choose((1.0 * (u > 0.0)), (u .^ 2.0), 0.0)" in source
        assert "function y = choose(" in source
        assert "~=" in source
        assert "function y = beyond(" not in source

    def test_words(self):
        assert hi.formulas(self.MODEL).split("\n\n")[1].splitlines()[:3] == [
            "N: expansion, fitted to inputs from -4 to 4",
            "  f(u) = 0.1 u + 0.333(12) tanh(2*u) - 2 where(u > 0, u**2, 0)",
            "         + 0.5 (maximum(u, 0)/sqrt(0.1 + 0.9*maximum(u, 0)**2) + minimum(u, 0)**2"
            "*(exp(0.7*minimum(u, 0)) - 1))",
        ]

    def test_a_function_without_a_formula_is_not_converted(self):
        long = hi.PiecewiseLinear(points=[[float(k), float(k % 3)] for k in range(30)])
        model = FittedModel(BlockChain((of([long], 1.0),)))
        with pytest.raises(ConfigError, match="a function of the kind 'piecewise_linear' has no formula"):
            hi.convert(model, "python")


BASES = {
    basis.kind: basis
    for basis in (
        hi.Trigonometric(interval=[-3, 4]),
        hi.Legendre(interval=[-3, 4]),
        hi.Laguerre(),
        hi.Hermite(),
    )
}


def series(kind, q=4, seed=0):
    basis = Series(BASES[kind], q, -2.0, 3.0)
    return StaticFunction(basis, tuple(np.random.default_rng(seed).normal(size=basis.size).tolist()))


@pytest.mark.parametrize("kind", BASES)
class TestSeries:
    X = np.array([-5.0, -3.1, -1.0, 0.3, 2.2, 3.9, 5.0, 7.0])

    def test_slopes_are_derivatives_also_beyond_the_domain(self, kind):
        f, step = series(kind), 1e-6
        expected = (f(self.X + step) - f(self.X - step)) / (2 * step)
        np.testing.assert_allclose(f.slope(self.X), expected, rtol=0.0, atol=1e-7)

    def test_slopes_are_those_that_a_basis_has_without_its_own(self, kind):
        basis, x = BASES[kind], np.array([0.0, 0.4, 2.5])
        unit = np.eye(basis.size(6))
        np.testing.assert_allclose(basis.slopes(x, unit), BasisSpec.slopes(basis, x, unit), atol=1e-4)
        inside = x[1:]
        np.testing.assert_allclose(
            basis.slopes(inside, unit), BasisSpec.slopes(basis, inside, unit), atol=1e-8
        )

    def test_formulas_are_the_functions(self, kind):
        f = series(kind)
        assert isinstance(f.basis, Series)
        texts, coefficients = needed(f.basis.formulas(np.array(f.coefficients)))
        said = sum(c * Formula(text, ("u",))(u=self.X) for c, text in zip(coefficients, texts, strict=True))
        np.testing.assert_allclose(said, f(self.X), rtol=0.0, atol=1e-12)

    @pytest.mark.parametrize("letters", ["NL", "LN"])
    def test_without_noise_the_blocks_are_found(self, kind, letters, tmp_path):
        u, f = gaussian(), series(kind, 3, 1)
        y = LINEAR.filter(f(u)) if letters == "NL" else f(LINEAR.filter(u))
        block = hi.SeriesBlock(basis=BASES[kind], q=3)
        blocks = (
            [block, hi.LinearBlock(nb=2, nf=1)] if letters == "NL" else [hi.LinearBlock(nb=2, nf=1), block]
        )
        spec = hi.PredictionError(blocks=blocks, start="rest")
        model = model_of(hi.fit(spec, Record(u, y)))
        np.testing.assert_allclose(model.simulate(u), y, rtol=0.0, atol=1e-9 * float(np.std(y)))
        hi.write_model(model, tmp_path / "model.json")
        assert hi.load_model(tmp_path / "model.json").chain == model.chain
        names: dict[str, Any] = {}
        exec(hi.convert(model, "python"), names)
        np.testing.assert_allclose(names["response"](u), model.simulate(u), rtol=0.0, atol=1e-11)
        # Polynomials have no unit of their own, and the linear block the gain 1 before them.
        assert (spec.normalisations() is None) == (letters == "LN" and kind != "legendre")
        x = model.chain.signals(u)[0 if letters == "NL" else 1]
        basis = model.chain.static[0].basis
        assert isinstance(basis, Series)
        assert (basis.low, basis.high) == pytest.approx((np.min(x), np.max(x)), rel=1e-12)


def test_legendre_polynomials_are_moved_with_their_interval():
    f, x = series("legendre"), TestSeries.X
    for factor, offset in ((2.0, 0.0), (-0.5, 1.5)):
        np.testing.assert_allclose(f.moved(factor, offset)(factor * x + offset), f(x), rtol=1e-10)


def test_a_series_of_many_powers_is_not_converted():
    model = FittedModel(BlockChain((series("hermite", 30),)))
    with pytest.raises(ConfigError, match="'hermite' with q = 30 has no formula that is accurate"):
        hi.convert(model, "matlab")
