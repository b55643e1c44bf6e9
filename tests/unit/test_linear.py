"""Linear blocks: closed forms, starts, memory, invariances, messages."""

import pickle
from typing import Annotated, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from hident.config.spec import Of, components
from hident.linear_blocks import TransferFunction
from hident.systems.linear import Ar, Arma, DiscreteSpec, Fir

BLOCKS = (
    Ar(a=(0.8,), initial="zero"),
    Ar(a=(1.6, -0.89), b0=2.0, initial="zero"),
    Fir(b=(0.0, 1.0, -2.0), initial="zero"),
    Arma(a=(0.5, 0.2), b=(1.0, 0.3, 0.1), initial="zero"),
)
quick = settings(deadline=None, derandomize=True, max_examples=30)
signals = st.lists(st.floats(-10, 10), min_size=1, max_size=60).map(np.array)
linear: TypeAdapter[DiscreteSpec] = TypeAdapter(Annotated[DiscreteSpec, Of("linear")])


def build(**keys: Any) -> DiscreteSpec:
    return linear.validate_python(keys)


@pytest.mark.parametrize(
    ("block", "closed_form"),
    [
        (TransferFunction(a=(0.8,)), lambda k: 0.8**k),
        (TransferFunction(a=(1.2, -0.36)), lambda k: (k + 1) * 0.6**k),
        (
            TransferFunction(a=(2 * 0.9 * np.cos(0.5), -0.81)),
            lambda k: 0.9**k * np.sin(0.5 * (k + 1)) / np.sin(0.5),
        ),
        (TransferFunction(b=(1.0, 2.0), a=(-0.5,)), lambda k: np.where(k == 0, 1.0, -3.0 * (-0.5) ** k)),
        (TransferFunction(b=(0.0, 3.0)), lambda k: np.where(k == 1, 3.0, 0.0)),
    ],
    ids=["simple pole", "double pole", "complex poles", "pole and zero", "delay"],
)
def test_impulse_response_has_its_closed_form(block, closed_form):
    np.testing.assert_allclose(block.impulse_response(40), closed_form(np.arange(40)), rtol=0, atol=1e-13)


def test_an_impulse_response_of_no_samples_is_empty():
    assert TransferFunction(a=(0.8,)).impulse_response(0).shape == (0,)


def test_filter_obeys_the_difference_equation_from_given_past_outputs():
    w = np.random.default_rng(1).normal(size=30)
    past = [0.7, -1.3]
    v = TransferFunction(b=(2.0, -1.0, 0.5), a=(0.9, -0.5)).filter(w, np.array(past))
    before = {-1: past[0], -2: past[1]}
    for k in range(30):
        feedback = [before[k - i] if k < i else v[k - i] for i in (1, 2)]
        inputs = [w[k - j] if k >= j else 0.0 for j in (0, 1, 2)]
        expected = 0.9 * feedback[0] - 0.5 * feedback[1] + 2.0 * inputs[0] - inputs[1] + 0.5 * inputs[2]
        assert v[k] == pytest.approx(expected, abs=1e-13)


def test_filter_refuses_a_wrong_number_of_past_outputs():
    with pytest.raises(ValueError, match=r"^needs 2 past outputs, not 1$"):
        TransferFunction(a=(0.5, 0.1)).filter(np.ones(3), np.array([1.0]))


def test_filtering_leaves_its_arguments_unchanged():
    w, past = np.arange(5.0), np.array([1.0])
    TransferFunction(a=(0.5,)).filter(w, past)
    assert w.tolist() == [0, 1, 2, 3, 4]
    assert past.tolist() == [1]


@pytest.mark.parametrize(
    "block",
    [TransferFunction(a=(0.8,)), TransferFunction(b=(2.0, 0.5, 0.1), a=(1.6, -0.89))],
)
def test_the_inverse_undoes_the_block(block):
    w = np.random.default_rng(2).normal(size=500)
    np.testing.assert_allclose(block.inverse().filter(block.filter(w)), w, rtol=0, atol=1e-12)
    np.testing.assert_allclose(block.filter(block.inverse().filter(w)), w, rtol=0, atol=1e-12)


@pytest.mark.parametrize("b", [(0.0, 1.0), (1e-17, 1.0)])
def test_a_delay_has_no_inverse(b):
    message = r"^a block with b_0 = 0 delays its input and has no causal inverse$"
    with pytest.raises(ValueError, match=message):
        TransferFunction(b=b).inverse()


def test_poles_zeros_and_radius():
    block = TransferFunction(b=(1.0, -0.5), a=(1.6, -0.89))
    np.testing.assert_allclose(np.sort_complex(block.poles()), [0.8 - 0.5j, 0.8 + 0.5j], atol=1e-14)
    np.testing.assert_allclose(block.zeros(), [0.5], atol=1e-15)
    assert block.radius() == pytest.approx(np.sqrt(0.89))
    assert TransferFunction(b=(1.0, 2.0)).radius() == 0.0
    assert block.is_stable()
    assert not TransferFunction(a=(1.0,)).is_stable()


def test_memory_of_a_simple_pole_is_the_logarithm_it_should_be():
    for pole in (0.5, 0.99, -0.9, 0.9999):
        expected = np.log(1e-16) / np.log(abs(pole))
        assert TransferFunction(a=(pole,)).memory() == pytest.approx(expected, abs=1.5)


@pytest.mark.parametrize(
    "block",
    [
        TransferFunction(a=(1.8, -0.81)),
        TransferFunction(a=(2.7, -2.43, 0.729)),
        TransferFunction(a=(2 * 0.99 * np.cos(0.01), -0.9801)),
        TransferFunction(a=(2 * 0.95 * np.cos(3.0), -0.9025)),
        TransferFunction(b=(1.0, *[0.0] * 300, 1.0), a=(0.5,)),
        TransferFunction(b=(*[0.0] * 300, 1.0), a=(0.5,)),
    ],
    ids=["double", "triple", "slowly turning", "fast turning", "late echo", "long delay"],
)
def test_the_response_is_negligible_after_the_memory_and_not_before(block):
    memory = block.memory()
    response = np.abs(block.impulse_response(4 * memory))
    assert response[memory:].max() <= 1e-16 * response.max() < response[memory - 1]


def test_memory_without_feedback_is_the_number_of_coefficients():
    assert TransferFunction(b=(1.0, 2.0, 3.0)).memory() == 3
    assert TransferFunction(b=tuple([0.0] * 99 + [1.0])).memory() == 100


@pytest.mark.parametrize("pole", [0.999999, 1.0, -1.5])
def test_memory_refuses_to_wait_forever(pole):
    message = rf"^a pole has modulus {abs(pole):.8g}: the response lasts too long \(at most 0.99999\)$"
    with pytest.raises(ValueError, match=message):
        TransferFunction(a=(pole,)).memory()


def test_parameters_have_names():
    block = TransferFunction(b=(1.0, 0.5), a=(0.8, -0.1))
    assert block.values() == {"a_1": 0.8, "a_2": -0.1, "b_0": 1.0, "b_1": 0.5}


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block.kind)
@quick
@given(w=signals, gain=st.floats(-5, 5), data=st.data())
def test_linearity(block, w, gain, data):
    other = np.array(data.draw(st.lists(st.floats(-10, 10), min_size=len(w), max_size=len(w))))
    together = block.simulate(gain * w + other)
    np.testing.assert_allclose(together, gain * block.simulate(w) + block.simulate(other), atol=1e-10)


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block.kind)
@quick
@given(w=signals, shift=st.integers(0, 20))
def test_shift_invariance_and_causality(block, w, shift):
    delayed = block.simulate(np.concatenate((np.zeros(shift), w)))
    assert not delayed[:shift].any()
    np.testing.assert_allclose(delayed[shift:], block.simulate(w), atol=1e-12)
    np.testing.assert_array_equal(block.simulate(w[: len(w) // 2 + 1]), block.simulate(w)[: len(w) // 2 + 1])


def test_the_stationary_start_has_the_stationary_variance():
    a, trials = 0.8, 20_000
    block = Ar(a=(a,))
    inputs = np.random.default_rng(3).normal(size=(trials, block.burn_in() + 1))
    first = np.array([block.simulate(w)[-1] for w in inputs])
    variance = 1.0 / (1.0 - a**2)
    # Four standard errors of the sample variance of normal values.
    assert first.var() == pytest.approx(variance, rel=4 * np.sqrt(2 / trials))


def test_a_burn_in_forgets_the_start():
    block = Arma(a=(1.6, -0.89), b=(1.0, 0.4))
    burn_in = block.burn_in()
    w = np.random.default_rng(4).normal(size=burn_in + 100)
    transfer = block.transfer_function()
    far_off = transfer.filter(w, np.array([1000.0, -1000.0]))[burn_in:]
    np.testing.assert_allclose(block.simulate(w)[burn_in:], far_off, rtol=0, atol=1e-11)


@pytest.mark.parametrize("initial", ["zero", (2.0,)])
def test_a_given_start_has_no_burn_in_and_belongs_to_the_first_sample(initial):
    block = Ar(a=(0.5,), initial=initial)
    assert block.burn_in() == 0
    past = 0.0 if initial == "zero" else 2.0
    np.testing.assert_allclose(block.simulate(np.array([1.0, 0.0])), [1 + past / 2, 0.5 + past / 4])


def test_fir_from_zero_has_had_no_input_before_the_record():
    np.testing.assert_array_equal(
        Fir(b=(1.0, 10.0, 100.0), initial="zero").simulate(np.ones(4)), [1, 11, 111, 111]
    )
    assert Fir(b=(1.0, 10.0, 100.0)).burn_in() == 3
    assert Fir(b=(1.0, 10.0), initial=()).simulate(np.ones(2)).tolist() == [1, 11]


def test_the_kinds_are_registered_and_read_from_plain_data():
    assert set(components("linear")) >= {"ar", "arma", "fir"}
    assert build(kind="ar", a=["4/5"]) == Ar(a=(0.8,))
    assert build(kind="fir", b=[0, 1]).transfer_function() == TransferFunction(b=(0.0, 1.0))
    assert build(kind="ar", a=[0.5], initial=["1/4"]).initial == (0.25,)


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block.kind)
def test_blocks_survive_pickling(block):
    assert pickle.loads(pickle.dumps(block)) == block


@pytest.mark.parametrize(
    ("keys", "place", "message"),
    [
        (
            {"kind": "ar", "a": [1.25]},
            (),
            "is unstable: poles 1.25 lie on or outside the unit circle",
        ),
        (
            {"kind": "ar", "a": [-1.0], "initial": "zero"},
            (),
            "is unstable: poles -1 lie on or outside the unit circle",
        ),
        (
            {"kind": "arma", "a": [1.6, -1.28], "b": [1]},
            (),
            "is unstable: poles 0.8+-0.8j (modulus 1.13137) lie on or outside the unit circle",
        ),
        (
            {"kind": "ar", "a": [-1.0000001]},
            (),
            "is unstable: poles -1.0000001 lie on or outside the unit circle",
        ),
        (
            {"kind": "arma", "a": [1.2, -1.0000001], "b": [1]},
            (),
            "is unstable: poles 0.6+-0.8j (modulus 1.00000005) lie on or outside the unit circle",
        ),
        (
            {"kind": "ar", "a": [0.9999900000001]},
            (),
            "has a pole of modulus 0.9999900000001, too slow for a stationary start (at most 0.99999): "
            "set 'initial' to zero or to the past outputs",
        ),
        (
            {"kind": "ar", "a": [0.999999]},
            (),
            "has a pole of modulus 0.999999, too slow for a stationary start (at most 0.99999): "
            "set 'initial' to zero or to the past outputs",
        ),
        (
            {"kind": "ar", "a": [0.5], "initial": [1, 2]},
            (),
            "'initial' must have as many past outputs as there are coefficients a (1), not 2",
        ),
        (
            {"kind": "fir", "b": [1], "initial": [1]},
            (),
            "'initial' must have as many past outputs as there are coefficients a (0), not 1",
        ),
        (
            {"kind": "ar", "a": [0.5], "initial": "rest"},
            ("initial",),
            "must be 'stationary', 'zero' or the list of past outputs v_-1, ..., v_-p, not 'rest'",
        ),
        ({"kind": "fir", "b": [0, 0]}, ("b",), "must have a coefficient other than zero"),
        ({"kind": "arma", "a": [0.5], "b": [0]}, ("b",), "must have a coefficient other than zero"),
        ({"kind": "ar", "a": [0.5], "b0": 0}, ("b0",), "must not be zero"),
        ({"kind": "ar", "a": 0.5}, ("a",), "must be a list of at least one number"),
        ({"kind": "ar", "a": []}, ("a",), "must be a list of at least one number"),
        (
            {"kind": "arma", "a": [0.0] * 201, "b": [1]},
            ("a",),
            "must be a list of at most 200",
        ),
    ],
)
def test_what_is_refused(keys, place, message):
    with pytest.raises(ValidationError) as caught:
        build(**keys)
    (error,) = caught.value.errors()
    assert error["loc"] == place
    assert error["msg"].removeprefix("Value error, ") == message


def test_a_slow_pole_is_accepted_from_a_given_start():
    assert build(kind="ar", a=[0.999999], initial="zero").burn_in() == 0
