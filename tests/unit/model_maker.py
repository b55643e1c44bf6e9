"""Random chains of every kind of block, for tests of what is done with a model."""

import numpy as np
from hypothesis import strategies as st

import hident as hi
from hident.block_chain import BlockChain
from hident.fitted_model import FittedModel, NoiseModel
from hident.linear_blocks import ContinuousTransferFunction, TransferFunction
from hident.sampled_blocks import SampledTransferFunction
from hident.static_functions import (
    Chebyshev,
    CubicSpline,
    DeadZone,
    PiecewiseLinear,
    Saturation,
    StaticFunction,
)
from hident.systems.function_basis import Functions, Series

ORDERS = ("L", "N", "N-L", "L-N", "L-N-L", "N-L-N", "L-N-L-N-L", "N-N", "L-L")
GIVEN = (
    hi.Identity(),
    hi.Abs(),
    hi.Expression(expression="tanh(2*u)"),
    hi.Saturation(low=-1, high=np.inf),
    hi.Expression(expression="where(u > 0.5, 1, -u)"),
)
COEFFICIENTS = st.floats(-3.0, 3.0)


@st.composite
def linear_blocks(draw):
    """A stable block, with a delay, without feedback or with up to two pairs of poles."""
    # scipy warns of a first coefficient that is next to nothing.
    first = draw(st.floats(0.1, 3.0) | st.floats(-3.0, -0.1))
    b = [0.0] * draw(st.integers(0, 3)) + [first] + draw(st.lists(COEFFICIENTS, max_size=3))
    denominator = np.ones(1)
    for _ in range(draw(st.integers(0, 2))):
        radius, angle = draw(st.floats(0.0, 0.95)), draw(st.floats(0.0, np.pi))
        denominator = np.convolve(denominator, [1.0, -2.0 * radius * np.cos(angle), radius**2])
    return TransferFunction(b=tuple(b), a=tuple((-denominator[1:]).tolist()))


@st.composite
def continuous_blocks(draw, dt):
    """A stable continuous block of up to three poles for samples every ``dt``, with any delay."""
    denominator = np.ones(1)
    for _ in range(draw(st.integers(1, 3))):
        denominator = np.convolve(denominator, [dt * draw(st.floats(0.3, 5.0)), 1.0])
    a = tuple(denominator[-2::-1].tolist())
    # Of one sign: scipy warns of a first coefficient that is next to nothing.
    sign = draw(st.sampled_from([-1.0, 1.0]))
    b = tuple(sign * draw(st.floats(0.1, 3.0)) * dt**i for i in range(draw(st.integers(1, len(a)))))
    block = ContinuousTransferFunction(b, a, dt * draw(st.sampled_from([0.0, 0.3, 1.0, 2.75])))
    return SampledTransferFunction(block, dt, draw(st.sampled_from(["held", "linear"])))


@st.composite
def increasing(draw, fewest, most):
    """Numbers that are at least a tenth apart."""
    steps = draw(st.lists(st.floats(0.1, 2.0), min_size=fewest, max_size=most))
    return tuple((draw(st.floats(-3.0, 0.0)) + np.cumsum(steps)).tolist())


@st.composite
def bases(draw):
    """A basis of any kind."""
    kind = draw(
        st.sampled_from([Chebyshev, PiecewiseLinear, CubicSpline, Saturation, DeadZone, Functions, Series])
    )
    if kind in (PiecewiseLinear, CubicSpline):
        return kind(draw(increasing(2, 7)))
    low, high = draw(increasing(2, 2))
    if kind is Functions:
        return Functions(tuple(draw(st.permutations(GIVEN))), low, high)
    if kind is Series:
        basis = draw(st.sampled_from([hi.Hermite(), hi.Legendre(interval=(low, high))]))
        return Series(basis, draw(st.integers(0, 4)), low, high)
    return Chebyshev(draw(st.integers(0, 8)), low, high) if kind is Chebyshev else kind(low, high)


@st.composite
def static_functions(draw):
    """A function by a basis of any kind."""
    basis = draw(bases())
    return StaticFunction(
        basis, tuple(draw(st.lists(COEFFICIENTS, min_size=basis.size, max_size=basis.size)))
    )


@st.composite
def models(draw, orders=ORDERS):
    """A model of any order of blocks, with or without what may be left out."""
    kinds = draw(st.sampled_from(orders)).split("-")
    dt = draw(st.none() | st.floats(1e-6, 1e6))
    linear = linear_blocks() if dt is None else linear_blocks() | continuous_blocks(dt)
    blocks = tuple(draw(linear if kind == "L" else static_functions()) for kind in kinds)
    known = draw(st.booleans())
    return FittedModel(
        BlockChain(blocks, dt),
        start=draw(st.sampled_from(["rest", "settled"])),
        noise=NoiseModel((0.5,) * draw(st.integers(0, 2)), (-0.25,) * draw(st.integers(0, 2)), 1 / 3),
        errors=tuple({_first_number(block): draw(st.floats(0.0, 1e3))} for block in blocks) if known else (),
        ranges=tuple((-1.0, draw(st.floats(-1.0, 1e3))) for _ in blocks) if known else (),
    )


def _first_number(block):
    return "b_0" if isinstance(block, TransferFunction) else "c_1"
