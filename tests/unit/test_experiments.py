"""Records of several experiments: their grids, their data, and what cannot be made."""

import pickle
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

import hident.systems.blocks
import hident.systems.nonlinearity  # noqa: F401  (for their registration)
from hident.config.spec import Of, canonical
from hident.engine.trial import Data, generate
from hident.errors import ConfigError
from hident.records import Held, Periodic
from hident.signals import noise  # noqa: F401  (for its registration)
from hident.signals.base import ExcitationSpec
from hident.signals.excitation import Filtered, Iid, Multisine, Multistep, Prbs, Sine, Staircase
from hident.signals.experiments import Experiments, SteppedSine
from hident.systems.linear import Ar

SYSTEM = {
    "kind": "wiener_hammerstein",
    "input_linear": {"kind": "continuous", "a": [12, 20]},
    "nonlinearity": {"kind": "exponential", "scale": 50, "rate": 0.2},
    "output_linear": {"kind": "continuous", "a": [105, 500]},
}
SINE = {"kind": "sine", "amplitude": 1.5, "frequency": 0.01}
STAIRS = {"kind": "staircase", "levels": [-1, 1], "hold": 250, "initial": 0}
RANDOM = {"kind": "multistep", "switching_time": 7, "std": 1}
LEVELS = {"name": "levels", "excitation": STAIRS, "samples": 1000}
GAINS = {"name": "gains", "excitation": SINE, "periods": 4, "samples_per_period": 60}


def experiments(*parts: dict[str, Any]) -> Experiments:
    found = Of("excitation").validate({"kind": "experiments", "parts": list(parts)})
    assert isinstance(found, Experiments)
    return found


def data(excitation: dict[str, Any] | ExcitationSpec, samples: int, **keys: Any) -> Data:
    plain = canonical(excitation)
    return Data.model_validate({"samples": samples, "dt": 0.5, "system": SYSTEM, "excitation": plain, **keys})


def message(build: Any) -> str:
    with pytest.raises((ValueError, ConfigError)) as caught:
        build()
    if isinstance(caught.value, ValidationError):
        (error,) = caught.value.errors()
        return error["msg"].removeprefix("Value error, ")
    return str(caught.value)


def sampled(waveform, n, dt):
    """The waveform at the times 0, dt, ..., shape (n,)."""
    times = np.arange(n) * dt
    if isinstance(waveform, Held):
        return waveform.levels[np.searchsorted(waveform.times, times + 1e-9, side="right") - 1]
    phases = np.multiply.outer(times, waveform.harmonics) * 2 * np.pi / waveform.period
    return waveform.offset + (np.exp(1j * phases) @ waveform.amplitudes).real


ONE_OF_EACH = [
    Iid(distribution="gaussian", std=2.0),
    Multistep(std=2.0, switching_time=0.35, limits=(-3.0, 3.0)),
    Prbs(order=5, clock=3),
    Sine(amplitude=2.0, offset=0.5, period=1.7, phase=0.3),
    Sine(amplitude=2.0, frequency=1.3),
    Staircase(levels=(1.0, -2.0, 0.5), hold=1.3, initial=4.0),
    Multisine(period=16, rms=1.5, grid="odd", offset=-1.0),
    Multisine(period=15, rms=1.5, highest=4),
    Filtered(excitation=Iid(distribution="gaussian", std=1.0), linear=Ar(a=(0.5,))),
]


@pytest.mark.parametrize("spec", ONE_OF_EACH, ids=lambda spec: spec.kind)
class TestWaveforms:
    def test_has_the_samples(self, spec):
        one, other = np.random.default_rng(1), np.random.default_rng(1)
        waveform = spec.waveform(60, 0.1, one)
        np.testing.assert_allclose(
            sampled(waveform, 60, 0.1), spec.sample(60, 0.1, other), rtol=0, atol=1e-12
        )
        # What is drawn next does not depend on which of the two was made.
        assert one.random() == other.random()

    def test_before_the_record(self, spec):
        waveform = spec.waveform(60, 0.1, np.random.default_rng(1))
        if isinstance(spec, Staircase):
            assert waveform.before == 4.0
            assert spec.sample(5, 0.1, np.random.default_rng(1), 3).tolist() == [4, 4, 4, 1, 1, 1, 1, 1]
        elif isinstance(waveform, Held):
            assert waveform.before == 0.0
            assert spec.period_at(0.1) is None
        else:
            assert waveform.period == spec.period_at(0.1)
            assert waveform.settled


def test_the_first_level_of_a_staircase_holds_before_the_record_unless_another_is_given():
    waveform = Staircase(levels=(3.0, 1.0), hold=2.0).waveform(9, 1.0, np.random.default_rng())
    assert waveform.before == 3.0


class TestGrids:
    def test_each_part_has_its_own(self):
        own = {"name": "own", "excitation": STAIRS, "samples": 30, "dt": 20}
        whole = {"name": "whole", "excitation": {"kind": "sine", "period": 6}, "periods": 3}
        multisine = {"kind": "multisine", "period": 16, "rms": 1}
        many = {"name": "many", "excitation": multisine, "periods": 2, "dt": 3}
        found = experiments(LEVELS, GAINS, own, whole, many).stretches(0, 0.5)
        assert [(s.name, s.samples, s.dt) for s in found] == [
            ("levels", 1000, 0.5),
            ("gains", 240, 2 * np.pi / 0.01 / 60),
            ("own", 30, 20),
            ("whole", 36, 0.5),
            ("many", 32, 3),
        ]

    def test_a_band_has_equal_ratios(self):
        band = {"low": 0.002, "high": "0.002*2**9", "count": 28}
        spec = SteppedSine.model_validate({"band": band, "periods": 2, "samples_per_period": 8})
        found = spec.stretches(0, 1.0)
        assert [s.name for s in found] == [str(i) for i in range(1, 29)]
        frequencies = 2 * np.pi / np.array([s.excitation.period_at(1.0) for s in found])
        np.testing.assert_allclose(frequencies[3:], 2 * frequencies[:-3], rtol=1e-13)
        np.testing.assert_allclose([s.dt * 8 for s in found], 2 * np.pi / frequencies, rtol=1e-14)

    def test_stepped_sines_stand_among_other_parts(self):
        stepped = {"kind": "stepped_sine", "frequencies": [0.1, 0.3], "periods": 2, "samples_per_period": 8}
        spec = experiments(LEVELS, {"name": "bode", "excitation": stepped})
        assert [s.name for s in spec.stretches(0, 0.5)] == ["levels", "bode 1", "bode 2"]
        spec.check(1032, 0.5)


class TestRecords:
    def test_parts_stand_one_after_the_other(self):
        record = generate(data(experiments(LEVELS, GAINS), 1240), 1, 0)
        levels, gains = record.parts["levels"], record.parts["gains"]
        assert (levels.samples, gains.samples) == (slice(0, 1000), slice(1000, 1240))
        assert (len(levels), len(gains)) == (1000, 240)
        assert isinstance(levels.waveform, Held)
        assert isinstance(gains.waveform, Periodic)
        for part in (levels, gains):
            u = record.u[part.samples]
            np.testing.assert_allclose(u, sampled(part.waveform, len(part), part.dt), rtol=0, atol=1e-12)
        alone = generate(data(STAIRS, 1000), 1, 0)
        np.testing.assert_array_equal(alone.y, record.y[levels.samples])
        np.testing.assert_allclose(record.y[[0, 499, 999]], 50 * np.exp([0, -0.2, 0.2]), rtol=0.07)
        periods = record.y[gains.samples].reshape(4, 60)
        np.testing.assert_array_equal(periods, np.broadcast_to(periods[0], periods.shape))

    def test_a_start_in_equilibrium_shows_the_transient(self):
        record = generate(data(experiments({**GAINS, "start": "equilibrium"}), 240), 1, 0)
        settled = generate(data(experiments(GAINS), 240), 1, 0)
        assert record.y[0] == pytest.approx(50.0, abs=1e-12)
        assert np.max(np.abs(record.y - settled.y)[:60]) > 1.0
        # The slowest pole, 0.01, over three periods of 628.
        assert np.max(np.abs(record.y - settled.y)[180:]) < 10 * np.exp(-18.8)

    def test_noise_is_added_to_the_record_as_a_whole(self):
        clean = generate(data(experiments(LEVELS, GAINS), 1240), 1, 0)
        noisy = generate(data(experiments(LEVELS, GAINS), 1240, noise={"kind": "white", "std": 0.1}), 1, 0)
        assert np.std(noisy.y - clean.y) == pytest.approx(0.1, rel=0.1)

    def test_random_parts_draw_one_after_the_other(self):
        parts = [{"name": name, "excitation": RANDOM, "samples": 50} for name in ("one", "two")]
        spec = data(experiments(*parts), 100)
        record = generate(spec, 1, 3)
        assert not np.array_equal(record.u[:50], record.u[50:])
        for part in record.parts.values():
            u = record.u[part.samples]
            np.testing.assert_array_equal(u, sampled(part.waveform, 50, 0.5))

    @pytest.mark.parametrize("initial", ["stationary", "zero"])
    def test_every_part_is_an_experiment_of_its_own_in_discrete_time_too(self, initial):
        system = {
            "kind": "hammerstein",
            "nonlinearity": "abs",
            "linear": {"kind": "ar", "a": [0.9], "initial": initial},
        }
        once = {"name": "once", "excitation": STAIRS, "samples": 600}
        record = generate(data(experiments(once, {**once, "name": "again"}), 1200, system=system), 1, 0)
        alone = generate(data(STAIRS, 600, system=system), 1, 0)
        np.testing.assert_array_equal(record.y, np.tile(alone.y, 2))
        assert alone.parts == {}

    def test_one_experiment_at_an_interval_of_its_own_is_a_part(self):
        system = {
            "kind": "hammerstein",
            "nonlinearity": "abs",
            "linear": {"kind": "continuous", "a": [12, 20]},
        }
        once = {"name": "once", "excitation": RANDOM, "samples": 60}
        alone = generate(data(experiments({**once, "dt": 0.25}), 60, system=system), 1, 0)
        assert alone.dt == 0.5
        assert {name: part.dt for name, part in alone.parts.items()} == {"once": 0.25}
        same = generate(data(experiments(once), 60, system=system), 1, 0)
        assert same.parts == {}

    def test_one_experiment_on_a_system_that_follows_waveforms_is_a_part(self):
        record = generate(data(SINE, 50), 1, 0)
        assert list(record.parts) == ["record"]
        assert record.parts["record"].dt == 0.5

    def test_the_order_of_the_parts_is_part_of_the_data(self):
        assert data(experiments(LEVELS, GAINS), 1240).key != data(experiments(GAINS, LEVELS), 1240).key

    def test_the_specs_survive_pickling_and_their_canonical_form(self):
        for spec in (experiments(LEVELS, GAINS), Of("excitation").validate(STAIRS)):
            assert pickle.loads(pickle.dumps(spec)) == spec
            assert Of("excitation").validate(canonical(spec)) == spec


STEPPED = {"kind": "stepped_sine", "frequencies": [0.1], "periods": 2, "samples_per_period": 8}


class TestWhatCannotBeMade:
    @pytest.mark.parametrize(
        ("part", "expected"),
        [
            ({"samples": 5, "periods": 2}, "give exactly one of samples and periods (both found)"),
            ({}, "give exactly one of samples and periods (neither found)"),
            (
                {"samples": 5, "samples_per_period": 9},
                "samples_per_period needs periods, and takes the place of dt",
            ),
            (
                {"periods": 5, "dt": 1, "samples_per_period": 9},
                "samples_per_period needs periods, and takes the place of dt",
            ),
            (
                {"excitation": STAIRS, "periods": 5, "samples_per_period": 9},
                "the excitation staircase takes no periods, samples_per_period here",
            ),
            (
                {"excitation": STAIRS, "samples": 5, "start": "periodic"},
                "start: periodic needs a periodic excitation (sine, multisine), not staircase",
            ),
            (
                {
                    "excitation": {"kind": "multisine", "period": 9, "rms": 1},
                    "periods": 5,
                    "samples_per_period": 9,
                },
                "the period of multisine is given in samples: leave out samples_per_period",
            ),
            (
                {"excitation": STEPPED, "samples": 5, "start": "periodic"},
                "the excitation stepped_sine takes no samples, start here",
            ),
            (
                {"excitation": {"kind": "experiments", "parts": [GAINS]}},
                "an experiment cannot consist of experiments: write its parts here",
            ),
        ],
    )
    def test_a_part(self, part, expected):
        assert message(lambda: experiments({"name": "p", "excitation": SINE, **part})) == expected

    def test_nothing(self):
        assert message(experiments) == "must hold at least one experiment"
        expected = "SteppedSine: 'frequencies' must hold at least one"
        assert message(lambda: SteppedSine(periods=2, samples_per_period=8, frequencies=())) == expected

    def test_two_parts_of_one_name(self):
        expected = "the names of the parts must differ: gains stands twice"
        assert message(lambda: experiments(GAINS, GAINS)) == expected

    def test_the_wrong_sum_of_samples(self):
        spec = experiments(LEVELS, GAINS)
        expected = "its experiments have 1240 samples together: set 'samples' to 1240, not 1000"
        assert message(lambda: spec.check(1000, 0.5)) == expected
        spec.check(1240, 0.5)

    def test_a_part_that_is_no_whole_number_of_samples_long(self):
        spec = experiments({"name": "gains", "excitation": SINE, "periods": 4})
        assert message(lambda: spec.check(4, 0.5)) == (
            "gains: the period 628.3185307 holds 1256.637061 samples at dt = 0.5, not a whole number: "
            "give samples_per_period"
        )

    def test_a_part_that_its_own_excitation_refuses(self):
        whole = {"kind": "sine", "period": 6, "whole_periods": True}
        spec = experiments({"name": "gains", "excitation": whole, "samples": 13})
        assert message(lambda: spec.check(13, 0.5)) == (
            "gains: a record of 13 samples holds 1.083333333 periods of 12 samples, not a whole number "
            "(nearest sample counts that fit: 12, 24)"
        )

    @pytest.mark.parametrize("keys", [{}, {"frequencies": [1], "band": {"low": 1, "high": 2, "count": 2}}])
    def test_stepped_sines_without_or_with_two_sets_of_frequencies(self, keys):
        found = "both" if keys else "neither"
        expected = f"SteppedSine: give exactly one of frequencies and band ({found} found)"
        assert message(lambda: SteppedSine(periods=2, samples_per_period=8, **keys)) == expected

    def test_a_falling_band(self):
        band = {"low": 2, "high": 1, "count": 2}
        expected = "SteppedSine: band: 'low' must be below 'high', not 2 and 1"
        assert message(lambda: SteppedSine(periods=2, samples_per_period=8, band=band)) == expected

    def test_several_experiments_through_one_filter(self):
        filtered = Filtered(excitation=experiments(LEVELS, GAINS), linear=Ar(a=(0.5,)))
        expected = "cannot filter several experiments: filter the excitation of each of them"
        assert message(lambda: filtered.check(1240, 0.5)) == expected

    @pytest.mark.parametrize(
        "excitation",
        [
            {"kind": "experiments", "parts": [{**GAINS, "start": "periodic"}]},
            {**STEPPED, "start": "equilibrium"},
            {
                "kind": "experiments",
                "parts": [{"name": "s", "excitation": {**STEPPED, "start": "equilibrium"}}],
            },
        ],
    )
    def test_a_start_on_a_system_that_has_its_own(self, excitation):
        hammerstein = {"kind": "hammerstein", "nonlinearity": "abs", "linear": {"kind": "ar", "a": [0.5]}}
        assert message(lambda: data(excitation, 240, system=hammerstein)) == (
            "'start' needs a wiener_hammerstein system with continuous blocks; "
            "this hammerstein starts as its linear blocks say: leave it out"
        )
        assert data(excitation, 240).excitation.chooses_start()


class TestRepetitions:
    MULTISINE: dict[str, Any] = {
        "name": "m",
        "excitation": {"kind": "multisine", "period": 16, "rms": 1},
        "periods": 2,
        "repetitions": 3,
    }

    def test_each_has_its_own_random_numbers_and_name(self):
        record = generate(data(experiments(self.MULTISINE), 96), 1, 0)
        assert list(record.parts) == ["m 1", "m 2", "m 3"]
        u = [record.u[part.samples] for part in record.parts.values()]
        for one in u:
            np.testing.assert_allclose(one[:16], one[16:], atol=1e-12)
        assert not np.allclose(u[0], u[1])
        assert not np.allclose(u[1], u[2])

    def test_a_single_one_keeps_its_name(self):
        (stretch,) = experiments({**self.MULTISINE, "repetitions": 1}).stretches(0, 1.0)
        assert stretch.name == "m"

    def test_a_series_cannot_be_repeated(self):
        sines = {"kind": "stepped_sine", "frequencies": [1], "periods": 2, "samples_per_period": 8}
        part = {"name": "s", "excitation": sines, "repetitions": 2}
        assert message(lambda: experiments(part)) == "the excitation stepped_sine takes no repetitions here"
