"""Records that begin in mid-motion: the states at the first sample are found with the blocks."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

import hident as hi
from hident.block_chain import BlockChain
from hident.errors import ConfigError, EstimationError
from hident.fitted_model import Begun, FittedModel, digest
from hident.initial_states import initial_states, showing
from hident.linear_blocks import TransferFunction
from hident.records import Held, Part, Record
from hident.static_functions import Chebyshev, StaticFunction
from hident.systems.nonlinearity import Polynomial

# Half of what was is left after 14 samples and after one; all static gains are 1.
SLOW = TransferFunction((0.05,), (0.95,))
QUICK = TransferFunction((0.4,), (0.6,))
BENT = Polynomial(coefficients=[0.0, 1.0, 0.4])
WIDE = (-12.0, 12.0)
FUNCTION = StaticFunction(
    Chebyshev(2, *WIDE), tuple(np.linalg.solve(Chebyshev(2, *WIDE).rows(np.r_[-1:2]).T, BENT(np.r_[-1.0:2])))
)
BEFORE = 300
TRUTHS = {
    "N-L": BlockChain((FUNCTION, SLOW)),
    "L-N": BlockChain((SLOW, FUNCTION)),
    "L-N-L": BlockChain((SLOW, FUNCTION, QUICK)),
    "N-L-N": BlockChain((FUNCTION, SLOW, FUNCTION)),
}


def blocks(structure):
    """Blocks that begin at the truth: what is asked here is where the search ends."""
    linear = iter([SLOW, QUICK])
    found: list[hi.PolynomialBlock | hi.LinearBlock] = []
    for letter in structure.split("-"):
        if letter == "N":
            found.append(hi.PolynomialBlock(degree=2, range=WIDE, start=BENT))
        else:
            block = next(linear)
            found.append(hi.LinearBlock(nb=1, nf=1, start=hi.Arma(b=block.b, a=block.a)))
    return found


def in_motion(structure, samples=300, seed=0, noise=0.0, pole=0.0):
    """A record whose input has been running for long, and its output without noise."""
    draws = np.random.default_rng(seed)
    # Slow and not about zero: what was before is far from rest, and from the first input.
    u = 2.0 * lfilter([0.3], [1.0, -0.7], draws.normal(size=BEFORE + samples)) + 1.0
    clean = TRUTHS[structure].response(u)[BEFORE:]
    v = lfilter([noise], [1.0, -pole], draws.normal(size=samples + 100))[100:]
    return Record(u[BEFORE:], clean + v), clean


def joined(*records):
    """One record of several experiments."""
    u, y = (np.concatenate([getattr(one, name) for one in records]) for name in "uy")
    parts, begin = {}, 0
    for k, one in enumerate(records):
        end = begin + len(one)
        parts[f"part {k}"] = Part(begin, end, 1.0, Held(np.arange(float(len(one))), one.u))
        begin = end
    return Record(u, y, parts=parts)


def model_of(spec, record):
    """The chain of blocks that is fitted."""
    found = hi.fit(spec, record).model
    assert isinstance(found, FittedModel)
    return found


def estimator(structure, start="estimated", **fields):
    return hi.PredictionError(blocks=blocks(structure), start=start, starts=1, **fields)


class TestWithoutNoise:
    @pytest.mark.parametrize("structure", TRUTHS)
    def test_all_is_found_to_rounding(self, structure):
        one, other = in_motion(structure, 300, 1)[0], in_motion(structure, 200, 2)[0]
        record = joined(one, other)
        model = model_of(estimator(structure), record)
        np.testing.assert_allclose(model.simulate(record), record.y, rtol=0.0, atol=1e-8 * np.std(record.y))
        for found, true in zip(model.chain.linear, TRUTHS[structure].linear, strict=True):
            np.testing.assert_allclose((*found.b, *found.a), (*true.b, *true.a), rtol=0.0, atol=1e-8)

    @pytest.mark.parametrize("structure", TRUTHS)
    def test_each_experiment_keeps_its_own_states(self, structure):
        records = [in_motion(structure, samples, samples)[0] for samples in (300, 200)]
        model = model_of(estimator(structure), joined(*records))
        assert [one.sha256 for one in model.begun] == [digest(one.u, one.y) for one in records]
        for record, known in zip(records, model.begun, strict=True):
            # The chain begun so far from settled by hand.
            states = tuple(np.array(state) for state in known.states)
            made = model.chain.response(record.u, "settled", states)
            np.testing.assert_array_equal(made, model.simulate(record))
            settled = model.chain.response(record.u, "settled")
            assert np.max(np.abs(settled - record.y)) > 0.1 * np.std(record.y)

    def test_starts_of_its_own_are_enough(self):
        record = in_motion("L-N-L", 1000, 5)[0]
        chain = [hi.LinearBlock(nb=1, nf=1), hi.PolynomialBlock(degree=2), hi.LinearBlock(nb=1, nf=1)]
        model = model_of(hi.PredictionError(blocks=chain, start="estimated"), record)
        np.testing.assert_allclose(model.simulate(record), record.y, rtol=0.0, atol=1e-7 * np.std(record.y))

    def test_a_held_block_has_states_too(self):
        record = in_motion("N-L", 300, 1)[0]
        held = [blocks("N-L")[0], hi.LinearBlock(nb=1, nf=1, start=hi.Arma(b=SLOW.b, a=SLOW.a), held=True)]
        model = model_of(hi.PredictionError(blocks=held, start="estimated", starts=1), record)
        assert model.chain.linear[0] == SLOW
        np.testing.assert_allclose(model.simulate(record), record.y, rtol=0.0, atol=1e-8 * np.std(record.y))

    def test_a_delay_is_part_of_the_state(self):
        u = np.random.default_rng(0).normal(size=500)
        delayed = TransferFunction((0.0, 0.0, 0.0, 1.0, 0.5), (0.8,))
        y = delayed.filter(u)[100:]
        record = Record(u[100:], y)
        spec = hi.PredictionError(blocks=[hi.LinearBlock(nb=2, nf=1, nk=3)], start="estimated")
        model = model_of(spec, record)
        assert [len(state) for state in model.begun[0].states] == [4]
        np.testing.assert_allclose(model.simulate(record), y, rtol=0.0, atol=1e-9)


class TestWithNoise:
    """A hundred records: the estimates of the pole that is slow, of 400 samples without any left out."""

    TRIALS, SAMPLES = 100, 400

    def found(self, structure, start, seed=40):
        # A noise model beside output error, white and coloured noise.
        noise = {"ar": 1} if structure == "L-N" else {}
        pole = 0.0 if structure == "N-L" else 0.6
        name = "input_a_1" if structure == "L-N-L" else "a_1"
        spec = estimator(structure, start, noise=noise)
        rows = []
        for trial in range(self.TRIALS):
            record, _ = in_motion(structure, self.SAMPLES, seed + trial, 0.05, pole)
            values = hi.fit(spec, record).values
            rows.append((values[name] - 0.95, values[f"se_{name}"]))
        return np.array(rows).T

    @pytest.mark.parametrize("structure", ["N-L", "L-N", "L-N-L"])
    def test_no_bias_and_true_intervals(self, structure):
        errors, claimed = self.found(structure, "estimated")
        spread = np.std(errors) / np.sqrt(self.TRIALS)
        assert abs(np.mean(errors)) < 4.0 * spread
        share = np.mean(np.abs(errors) < 1.96 * claimed)
        assert share == pytest.approx(0.95, abs=3.0 * np.sqrt(0.95 * 0.05 / self.TRIALS))
        settled, _ = self.found(structure, "settled")
        # The same records, begun as they did not begin.
        assert np.sqrt(np.mean(settled**2)) > 3.0 * np.sqrt(np.mean(errors**2))


class TestOtherRecords:
    @pytest.fixture(scope="class")
    @staticmethod
    def model():
        return model_of(estimator("L-N-L"), in_motion("L-N-L", 400, 3, 0.01)[0])

    def test_the_states_of_another_stretch_come_from_its_first_samples(self, model):
        record, clean = in_motion("L-N-L", 400, 7, 0.01)
        assert model.known(record.u, record.y) is None
        assert np.sqrt(np.mean((model.simulate(record) - clean) ** 2)) < 0.01
        # Later samples tell nothing of them.
        window = showing(model.chain, len(record))
        other = record.y.copy()
        other[window:] += 100.0
        np.testing.assert_array_equal(model.simulate(Record(record.u, other)), model.simulate(record))

    def test_metrics_find_them_on_the_validation_record(self, model):
        record, (validation, clean) = in_motion("L-N-L", 400, 3, 0.01)[0], in_motion("L-N-L", 300, 8, 0.01)
        spec = hi.FitIndex(on="validation")
        fits = {}
        for start in ("estimated", "settled"):
            found = hi.fit(estimator("L-N-L", start), replace(record, validation=validation))
            fits[start] = hi.score(found, replace(record, validation=validation), fit=spec)["fit"]
        noise = 100.0 * np.std(validation.y - clean) / np.std(validation.y)
        assert fits["estimated"] > 100.0 - 1.1 * noise
        assert fits["settled"] < 100.0 - 10.0 * noise

    def test_an_input_alone_begins_settled(self, model):
        u = in_motion("L-N-L", 50, 3)[0].u
        np.testing.assert_array_equal(model.simulate(u), model.chain.response(u, "settled"))

    def test_a_prediction_begins_so_too(self, model):
        record, _ = in_motion("L-N-L", 400, 7, 0.01)
        np.testing.assert_array_equal(model.predict(record), model.simulate(record))

    def test_outputs_that_are_not_finite_tell_nothing(self, model):
        u = np.ones(50)
        np.testing.assert_array_equal(
            model.simulate(Record(u, np.full(50, np.nan))), model.chain.response(u, "settled")
        )


class TestFirstSamples:
    def test_fewer_samples_than_states(self):
        chain = BlockChain((TransferFunction((1.0,), (0.5, 0.2, 0.1)),))
        [state] = initial_states(chain, np.ones(2), np.array([3.0, 4.0]))
        made = chain.response(np.ones(2), "settled", (state,))
        np.testing.assert_allclose(made, [3.0, 4.0], rtol=1e-9)

    @pytest.mark.parametrize("unit", [1e-30, 1e30])
    def test_units_do_not_matter(self, unit):
        record, _ = in_motion("L-N-L", 200, 1, 0.01)
        chain = TRUTHS["L-N-L"]
        last = chain.linear[1].scaled(unit)
        own = initial_states(chain, record.u, record.y)
        other = initial_states(replace(chain, blocks=(*chain.blocks[:2], last)), record.u, unit * record.y)
        np.testing.assert_allclose(other[0], own[0], rtol=1e-6)
        np.testing.assert_allclose(other[1] / unit, own[1], rtol=1e-6)

    def test_blocks_without_states(self):
        chain = BlockChain((TransferFunction((2.0,)), FUNCTION))
        assert [state.tolist() for state in initial_states(chain, np.ones(5), np.ones(5))] == [[]]
        assert showing(chain, 5) == 0

    def test_too_many_states_are_refused(self):
        draws = np.random.default_rng(0)
        records = []
        for _ in range(60):
            u = draws.normal(size=40)
            records.append(Record(u, lfilter(np.ones(10), [1.0], u) + 0.1 * draws.normal(size=40)))
        spec = hi.PredictionError(blocks=[hi.LinearBlock(nb=10)], start="estimated")
        with pytest.raises(EstimationError) as caught:
            hi.fit(spec, joined(*records))
        assert str(caught.value) == (
            "the linear blocks have 540 states at the first samples of 60 experiments, and at most 500 can "
            "be found: leave first samples out by 'n_init' instead"
        )


class TestModelFile:
    def test_it_keeps_the_states(self, tmp_path):
        record = joined(in_motion("L-N-L", 300, 1, 0.01)[0], in_motion("L-N-L", 200, 2, 0.01)[0])
        model = model_of(estimator("L-N-L"), record)
        hi.write_model(model, tmp_path / "model.json")
        again = hi.load_model(tmp_path / "model.json")
        assert again.begun == model.begun
        assert again.start == "estimated"
        np.testing.assert_array_equal(again.simulate(record), model.simulate(record))

    @pytest.mark.parametrize(
        "begun, start, message",
        [
            (
                [{"sha256": "0" * 64, "states": [[1.0, 2.0]]}],
                "estimated",
                "begun[0].states: must have as many numbers as the states of the linear blocks, [1], not [2]",
            ),
            (
                [{"sha256": "0" * 64, "states": [[1.0]]}],
                "settled",
                'begun: holds states, which only a model of "start": "estimated" has',
            ),
        ],
    )
    def test_what_does_not_fit(self, tmp_path, begun, start, message):
        model = FittedModel(TRUTHS["N-L"], start="estimated", begun=(Begun("0" * 64, ((1.0,),)),))
        hi.write_model(model, tmp_path / "model.json")
        data = json.loads((tmp_path / "model.json").read_text())
        data |= {"begun": begun, "start": start}
        (tmp_path / "model.json").write_text(json.dumps(data))
        with pytest.raises(ConfigError) as caught:
            hi.load_model(tmp_path / "model.json")
        assert message in str(caught.value)
