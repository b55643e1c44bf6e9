"""Block-oriented systems: wiring, truths, starts."""

import pickle
from typing import Annotated, Any

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from hident.config.spec import Of
from hident.linear_blocks import TransferFunction
from hident.systems import blocks, nonlinearity
from hident.systems.base import SystemSpec

system: TypeAdapter[SystemSpec] = TypeAdapter(Annotated[SystemSpec, Of("system")])
FIR = {"kind": "fir", "b": [1, 2], "initial": "zero"}
AR = {"kind": "ar", "a": [0.5], "initial": "zero"}
U = np.random.default_rng(5).normal(size=50)


def build(kind: str, **keys: Any) -> SystemSpec:
    return system.validate_python({"kind": kind, **keys})


HAMMERSTEIN = build("hammerstein", nonlinearity="abs", linear=AR)
WIENER = build("wiener", linear=AR, nonlinearity={"kind": "saturation", "low": -1, "high": 2})
WIENER_HAMMERSTEIN = build("wiener_hammerstein", input_linear=FIR, nonlinearity="abs", output_linear=AR)
HAMMERSTEIN_WIENER = build(
    "hammerstein_wiener",
    input_nonlinearity="abs",
    linear=AR,
    output_nonlinearity={"kind": "saturation", "low": -1, "high": 2},
)
SYSTEMS = pytest.mark.parametrize(
    "spec", [HAMMERSTEIN, WIENER, WIENER_HAMMERSTEIN, HAMMERSTEIN_WIENER], ids=lambda spec: spec.kind
)


def test_hammerstein_filters_what_the_nonlinearity_gives():
    v = HAMMERSTEIN.simulate(U)
    np.testing.assert_allclose(v[1:], 0.5 * v[:-1] + np.abs(U[1:]), atol=1e-14)


def test_wiener_bends_what_the_linear_block_gives():
    x = np.zeros(len(U))
    for k, u in enumerate(U):
        x[k] = 0.5 * x[k - 1] + u
    np.testing.assert_allclose(WIENER.simulate(U), np.clip(x, -1, 2), atol=1e-14)


def test_wiener_hammerstein_is_a_wiener_block_and_a_filter():
    v = WIENER_HAMMERSTEIN.simulate(U)
    np.testing.assert_allclose(v[1:], 0.5 * v[:-1] + np.abs(U[1:] + 2 * U[:-1]), atol=1e-14)


def test_hammerstein_wiener_bends_what_a_hammerstein_block_gives():
    np.testing.assert_array_equal(HAMMERSTEIN_WIENER.simulate(U), np.clip(HAMMERSTEIN.simulate(U), -1, 2))


def test_the_truth_between_two_nonlinearities():
    truth = HAMMERSTEIN_WIENER.truth()
    assert truth.linear == TransferFunction(a=(0.5,))
    assert HAMMERSTEIN_WIENER.provides() == {"linear", "response", "value a_1", "value b_0"}
    # Which nonlinearity takes the factor no value tells.
    assert truth.rescaled is not None
    moved = truth.rescaled({"linear": 2.0})
    assert moved.linear == TransferFunction(b=(0.5,), a=(0.5,))
    assert moved.values == {"a_1": 0.5, "b_0": 0.5}


@SYSTEMS
def test_simulation_leaves_the_input_and_itself_alone(spec):
    before = U.copy()
    output = spec.simulate(U)
    np.testing.assert_array_equal(U, before)
    assert output.shape == U.shape
    assert not np.shares_memory(output, U)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(spec)).simulate(U), output)


def test_truth_of_one_linear_block():
    truth = WIENER.truth()
    assert truth.linear == TransferFunction(a=(0.5,))
    assert truth.values == {"a_1": 0.5, "b_0": 1.0}
    assert truth.breakpoints == (-1, 2)
    assert truth.nonlinearity == nonlinearity.Saturation(low=-1, high=2)
    assert HAMMERSTEIN.truth().breakpoints == (0,)
    assert WIENER.provides() == {"nonlinearity", "linear", "response", "value a_1", "value b_0"}


def test_truth_of_two_linear_blocks():
    truth = WIENER_HAMMERSTEIN.truth()
    assert truth.linear is None
    assert truth.values == {"input_b_0": 1, "input_b_1": 2, "output_a_1": 0.5, "output_b_0": 1}
    assert truth.breakpoints == (0,)
    values = {f"value {name}" for name in truth.values}
    assert WIENER_HAMMERSTEIN.provides() == {"nonlinearity", "response", *values}


def test_burn_ins_add_up():
    ar, fir = {"kind": "ar", "a": [0.5]}, {"kind": "fir", "b": [1, 2, 3]}
    alone = build("hammerstein", nonlinearity="identity", linear=ar).burn_in()
    both = build("wiener_hammerstein", input_linear=fir, nonlinearity="identity", output_linear=ar)
    assert alone == TransferFunction(a=(0.5,)).memory() > 0
    assert both.burn_in() == 3 + alone


@SYSTEMS
def test_given_starts_need_no_burn_in(spec):
    assert spec.burn_in() == 0


@pytest.mark.parametrize("kind", ["hammerstein", "wiener"])
def test_a_given_state_belongs_to_the_first_sample(kind):
    spec = build(kind, nonlinearity="identity", linear={**AR, "initial": [8]})
    assert spec.burn_in() == 0
    assert spec.simulate(np.zeros(3)).tolist() == [4, 2, 1]


def test_after_the_burn_in_the_two_linear_blocks_have_forgotten_the_start():
    slow = {"kind": "ar", "a": [0.9]}
    spec = build("wiener_hammerstein", input_linear=slow, nonlinearity="abs", output_linear=slow)
    assert isinstance(spec, blocks.WienerHammerstein)
    burn_in = spec.burn_in()
    rng = np.random.default_rng(6)
    past, record = rng.normal(size=burn_in), rng.normal(size=40)
    output = spec.simulate(np.concatenate((past, record)))[burn_in:]
    longer = spec.simulate(np.concatenate((rng.normal(size=500), past, record)))[-40:]
    np.testing.assert_allclose(output, longer, rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    ("first", "second", "starts"),
    [("stationary", "zero", "stationary and zero"), ([3], "stationary", "[3.0] and stationary")],
)
def test_mixed_starts_are_refused(first, second, starts):
    with pytest.raises(ValidationError) as caught:
        build(
            "wiener_hammerstein",
            input_linear={**AR, "initial": first},
            nonlinearity="abs",
            output_linear={**AR, "initial": second},
        )
    (error,) = caught.value.errors()
    assert error["msg"].removeprefix("Value error, ") == (
        f"both linear blocks must start stationary, or both from a given state, not {starts}: "
        "a burn-in would move the given state before the record"
    )


def test_an_unstable_block_is_refused_at_its_place():
    with pytest.raises(ValidationError) as caught:
        build("hammerstein", nonlinearity="abs", linear={"kind": "ar", "a": [1.25]})
    (error,) = caught.value.errors()
    assert error["loc"] == ("linear",)
    assert error["msg"] == "is unstable: poles 1.25 lie on or outside the unit circle"
