"""A discrete model works at its own sampling interval: records of another one are told, not taken."""

import numpy as np
import pytest

import hident as hi
from hident.block_chain import BlockChain

DISCRETE = hi.FittedModel(BlockChain((hi.TransferFunction(b=(0.0, 0.5), a=(0.5,)),), dt=4.0))
U = np.array([1.0, 1.0, 0.0])
SAID = "for samples every 4, and the record has one every 2"


@pytest.mark.parametrize("take", [DISCRETE.simulate, DISCRETE.signals, DISCRETE.predict])
def test_a_record_of_another_interval_is_refused(take):
    with pytest.raises(ValueError, match=SAID):
        take(hi.Record(U, U, 2.0))


def test_its_own_interval_and_none_are_the_models():
    for dt in (4.0, 4.0 * (1 + 1e-12), None):
        assert DISCRETE.simulate(hi.Record(U, U, dt)).tolist() == DISCRETE.simulate(U).tolist()


def test_what_has_no_dynamics_has_any_interval():
    static = hi.FittedModel(BlockChain((), dt=4.0))
    assert static.simulate(hi.Record(U, U, 2.0)).tolist() == U.tolist()
