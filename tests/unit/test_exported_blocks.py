"""Linear blocks in other packages: the same response to 1e-12, and messages where there is none."""

import sys

import numpy as np
import pytest

from hident.errors import ConfigError
from hident.linear_blocks import ContinuousTransferFunction, TransferFunction

DISCRETE = {
    "gain": TransferFunction(b=(2.0,)),
    "feedback alone": TransferFunction(b=(0.5,), a=(1.6, -0.89)),
    "finite": TransferFunction(b=(1.0, -2.0, 0.5)),
    "delayed": TransferFunction(b=(0.0, 0.0, 1.0)),
    "delayed feedback": TransferFunction(b=(0.0, 1.0), a=(0.5,)),
    "as many": TransferFunction(b=(1.0, 0.3), a=(0.9,)),
    "longer numerator": TransferFunction(b=(1.0, 0.3, 0.2, 0.1), a=(0.9,)),
    "longer denominator": TransferFunction(b=(1.0, 0.3), a=(0.9, -0.4, 0.1)),
    "zeros at the end": TransferFunction(b=(1.0, 0.0), a=(0.5, 0.0, 0.0)),
}
CONTINUOUS = {
    "first order": ContinuousTransferFunction(b=(2.0,), a=(0.5,)),
    "zero in the right half plane": ContinuousTransferFunction(b=(1.0, -1.0), a=(4.0, 4.0, 3.0)),
    "no highest b": ContinuousTransferFunction(b=(1.0, 0.0), a=(2.5, 1.5)),
    "no static gain": ContinuousTransferFunction(b=(0.0, 1.0), a=(2.5, 1.5)),
    "slow": ContinuousTransferFunction(b=(3.0,), a=(2e3, 1e6)),
}
W = np.random.default_rng(3).normal(size=60)
FREQUENCIES = np.linspace(0.01, 3.1, 50)


def assert_close(found, expected):
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


def gain(block, frequencies):
    """The complex gain of a discrete block, by the definition of its powers of q^-1."""
    q = np.exp(-1j * frequencies)
    return np.polyval(block.b[::-1], q) / np.polyval(block.denominator[::-1], q)


@pytest.mark.parametrize("name", DISCRETE)
def test_a_dlti_has_the_same_response(name):
    block = DISCRETE[name]
    exported = block.to_scipy(dt=0.1)
    assert exported.dt == 0.1
    _, response = exported.output(W, None)
    assert_close(response[:, 0], block.filter(W))
    _, gains = exported.freqresp(FREQUENCIES)
    assert_close(gains, gain(block, FREQUENCIES))


@pytest.mark.parametrize("name", CONTINUOUS)
def test_an_lti_has_the_same_response(name):
    block = CONTINUOUS[name]
    omega = FREQUENCIES / block.a[-1] ** (1 / len(block.a))
    _, gains = block.to_scipy().freqresp(omega)
    assert_close(gains, block.frequency_response(omega))


@pytest.mark.parametrize("name", DISCRETE)
def test_a_discrete_block_of_control_has_the_same_response(name):
    control = pytest.importorskip("control")
    block = DISCRETE[name]
    exported = block.to_control(dt=0.1)
    assert exported.dt == 0.1
    assert_close(exported(np.exp(1j * FREQUENCIES)), gain(block, FREQUENCIES))
    response = control.forced_response(exported, inputs=W).outputs
    assert_close(response, block.filter(W))


@pytest.mark.parametrize("name", CONTINUOUS)
def test_a_continuous_block_of_control_has_the_same_response(name):
    pytest.importorskip("control")
    block = CONTINUOUS[name]
    omega = FREQUENCIES / block.a[-1] ** (1 / len(block.a))
    assert_close(block.to_control()(1j * omega), block.frequency_response(omega))


def test_a_delay_goes_along_with_the_sampled_block():
    block = ContinuousTransferFunction(b=(1.0, 0.2), a=(2.5, 1.5), delay=0.33)
    message = (
        "a scipy.signal.lti holds no delay, and this block has 0.33: take sampled(dt).to_scipy(dt), the same "
        "response at the samples of a held input"
    )
    with pytest.raises(ConfigError) as caught:
        block.to_scipy()
    assert str(caught.value) == message
    _, response = block.sampled(0.1).to_scipy(0.1).output(W, None)
    assert_close(response[:, 0], block.respond(W, 0.1))


def test_control_refuses_a_delay():
    pytest.importorskip("control")
    with pytest.raises(
        ConfigError, match=r"holds no delay, and this block has 2: take sampled\(dt\).to_control"
    ):
        ContinuousTransferFunction(b=(1.0,), a=(1.0,), delay=2.0).to_control()


@pytest.mark.parametrize("block", [DISCRETE["gain"], CONTINUOUS["slow"]])
def test_without_control_the_message_says_how_to_get_it(block, monkeypatch):
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(ConfigError) as caught:
        block.to_control()
    assert str(caught.value) == "to_control needs python-control: pip install 'hident[control]'"
