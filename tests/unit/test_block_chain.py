"""A chain of blocks: what its blocks are called, and inputs of no samples."""

import numpy as np
import pytest

from hident.block_chain import BlockChain
from hident.fitted_model import FittedModel
from hident.linear_blocks import TransferFunction
from hident.records import Held, Part, Record
from hident.static_functions import PiecewiseLinear, Saturation, StaticFunction

N = StaticFunction(PiecewiseLinear((0.0, 1.0)), (0.0, 2.0))
L = TransferFunction(b=(0.0, 0.5), a=(0.5,))


@pytest.mark.parametrize(
    ("blocks", "names"),
    [((N,), ["N"]), ((N, L), ["N", "L"]), ((N, L, N), ["N1", "L", "N2"]), ((L, L), ["L1", "L2"])],
)
def test_blocks_are_numbered_where_there_are_several_of_a_kind(blocks, names):
    assert list(BlockChain(blocks).names) == names


@pytest.mark.parametrize("block", [N, L, TransferFunction(b=(1.0, 2.0)), TransferFunction(b=(2.0,))])
@pytest.mark.parametrize("start", ["rest", "settled"])
def test_no_input_gives_no_output(block, start):
    assert BlockChain((block,)).response(np.zeros(0), start).shape == (0,)


def test_a_model_simulates_an_input_as_it_does_a_record():
    model = FittedModel(BlockChain((N, L)))
    u = np.array([1.0, 3.0, -2.0])
    assert model.simulate(u).tolist() == model.simulate(Record(u, u)).tolist()


def test_the_signals_of_a_record_begin_anew_with_each_experiment():
    model = FittedModel(BlockChain((N, L)))
    u = np.array([1.0, 3.0, -2.0, 4.0])
    held = Held(np.zeros(1), np.zeros(1))
    parts = {"a": Part(0, 2, 1.0, held), "b": Part(2, 4, 1.0, held)}
    signals = model.signals(Record(u, u, parts=parts))
    assert signals[0].tolist() == u.tolist()
    assert signals[-1].tolist() == model.simulate(Record(u, u, parts=parts)).tolist()


def test_a_block_was_fitted_where_its_inputs_were_or_its_basis_ends():
    chain = BlockChain((N, StaticFunction(Saturation(0.0, 1.0), (0.0, 1.0)), L))
    assert [FittedModel(chain).range_of(i) for i in range(3)] == [(0.0, 1.0), None, None]
    ranges = ((0.0, 5.0), (1.0, 2.0), (3.0, 4.0))
    assert [FittedModel(chain, ranges=ranges).range_of(i) for i in range(3)] == list(ranges)
