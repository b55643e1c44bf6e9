"""The Cramer-Rao bound of a chain of blocks: against formulas, by brute force, and met by the fit."""

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

import hident as hi
from hident.block_chain import BlockChain
from hident.errors import ConfigError
from hident.linear_blocks import TransferFunction
from hident.records import Record
from hident.static_functions import Chebyshev, StaticFunction

BEND = hi.Polynomial(coefficients=[0.0, 1.0, 0.5])
LAG = hi.Arma(b=[0.4], a=[0.6])
FUNCTION = StaticFunction(Chebyshev(2, -4.0, 4.0), (4.0, 4.0, 4.0))


def true_blocks(letters, **linear):
    static = hi.PolynomialBlock(degree=2, range=(-4.0, 4.0), start=BEND)
    block = hi.LinearBlock(nb=1, nf=1, start=LAG, **linear)
    return [static if letter == "N" else block for letter in letters]


def chain_of(letters):
    return BlockChain(
        tuple(FUNCTION if letter == "N" else TransferFunction((0.4,), (0.6,)) for letter in letters)
    )


def bound(letters, u, noise=(), variance=0.01, **linear):
    of = hi.PredictionError(blocks=true_blocks(letters, **linear), start="rest")
    record = Record(u, chain_of(letters).response(u))
    return hi.fit(hi.ChainCramerRao(of=of, noise=noise, variance=variance), record).values


@pytest.mark.parametrize("letters, free", [("NL", 4), ("LN", 4), ("LNL", 5)])
def test_white_noise_costs_its_variance_for_each_number_that_the_data_determine(letters, free):
    u = np.random.default_rng(0).normal(size=400)
    # A factor between two blocks is no number of the response.
    assert bound(letters, u)["output_mse"] == pytest.approx(free * 0.01 / 400, rel=1e-9)


@pytest.mark.parametrize("letters", ["NL", "LN"])
def test_coloured_noise_by_brute_force(letters):
    u = np.random.default_rng(1).normal(size=80)

    def response(theta):
        # Unit static gain: the numerator follows from the pole.
        x = lfilter([1.0 - theta[0]], [1.0, -theta[0]], u) if letters == "LN" else u
        y = theta[1] + theta[2] * x + theta[3] * x**2
        return y if letters == "LN" else lfilter([1.0 - theta[0]], [1.0, -theta[0]], y)

    theta = np.array([0.6, 0.0, 1.0, 0.5])
    np.testing.assert_allclose(response(theta), chain_of(letters).response(u), atol=1e-12)
    steps = 1e-5 * np.eye(4)
    columns = np.array([(response(theta + s) - response(theta - s)) / 2e-5 for s in steps]).T
    # From rest, as predictions begin: e = D v with what was before as zero.
    whitening = toeplitz(np.r_[1.0, -0.7, np.zeros(78)], np.zeros(80))
    information = columns.T @ whitening.T @ whitening @ columns / 0.01
    covariance = np.linalg.inv(information)
    found = bound(letters, u, noise=[0.7])
    assert found["se_a_1"] == pytest.approx(np.sqrt(covariance[0, 0]), rel=1e-5)
    assert found["output_mse"] == pytest.approx(np.trace(columns @ covariance @ columns.T) / 80, rel=1e-5)


def test_what_is_held_is_known():
    u = np.random.default_rng(0).normal(size=400)
    found = bound("NL", u, held=True)
    assert found["se_a_1"] == found["se_b_0"] == 0.0
    assert found["output_mse"] == pytest.approx(3 * 0.01 / 400, rel=1e-9)


def test_the_noise_of_the_record_stands_for_its_variance():
    draws = np.random.default_rng(2)
    u, e = draws.normal(size=(2, 5000))
    of = hi.PredictionError(blocks=true_blocks("NL"), start="rest")
    record = Record(u, chain_of("NL").response(u) + lfilter([0.1], [1.0, -0.7], e))
    own = hi.fit(hi.ChainCramerRao(of=of, noise=[0.7]), record).values
    given = hi.fit(hi.ChainCramerRao(of=of, noise=[0.7], variance=0.01 * np.mean(e**2)), record).values
    assert own["output_mse"] == pytest.approx(given["output_mse"], rel=1e-9)


def test_the_fit_meets_it():
    """Mean squared errors of 60 records over the bound: a chi-squared mean with 240 degrees of freedom."""
    spec = hi.PredictionError(blocks=true_blocks("LN"), start="rest", starts=1, noise={"ar": 1})
    ratios = []
    for seed in range(60):
        u, e = np.random.default_rng([seed, 5]).normal(size=(2, 600))
        clean = chain_of("LN").response(u)
        record = Record(u, clean + lfilter([0.1], [1.0, -0.8], e))
        least = hi.fit(hi.ChainCramerRao(of=spec, noise=[0.8], variance=0.01), record).values["output_mse"]
        model = hi.fit(spec, record).model
        assert model is not None
        ratios.append(np.mean((model.simulate(record) - clean) ** 2) / least)
    assert np.mean(ratios) == pytest.approx(1.0, abs=3.0 * np.sqrt(2.0 / 240))


@pytest.mark.parametrize(
    "change, message",
    [
        ({"blocks": [{"kind": "linear", "nb": 1, "nf": 1}]}, "block 1 needs 'start', the true block"),
        (
            {"blocks": true_blocks("NL"), "start": "estimated"},
            "must begin 'settled' or at 'rest': the bound is for a known beginning",
        ),
    ],
)
def test_what_it_cannot_be_the_bound_of(change, message):
    with pytest.raises(ConfigError, match=message):
        hi.ChainCramerRao(of=hi.PredictionError(**change))
