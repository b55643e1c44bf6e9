"""Records that tell little or nothing: an error in words, or a model, and no warning of a library."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from hident.errors import EstimationError
from hident.identification.identify import identify
from hident.linear_blocks import TransferFunction
from hident.measurements.first_look import first_look
from hident.numerics.judgement import judgement
from hident.records import Record
from tests.forked import run_forked

TANK = TransferFunction((0.0, 0.4), (0.6,))
DRAWS = np.random.default_rng(0)
U = np.repeat(DRAWS.uniform(-2.0, 2.0, 50), 4)
NOISE = 0.01 * DRAWS.standard_normal(len(U))
Y = TANK.filter(np.clip(U, -1.0, 1.2)) + NOISE
HEAD, TAIL = 160, 40
STILL = np.ones(HEAD)
LATE, EARLY = np.r_[STILL, U[HEAD:]], np.r_[U[:HEAD], STILL[:TAIL]]
IMPULSE = np.eye(1, len(U), 10)[0]


def tried(u, y, *structures):
    """What is found, with each warning of a library as an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        first_look(Record(u, y))
        return identify(Record(u, y), structures or ("linear", "hammerstein"))


@pytest.mark.parametrize(
    ("u", "y", "why"),
    [
        (np.ones(len(U)), Y, "the input is 1 throughout"),
        (U, np.ones(len(U)), "the output is 1 throughout"),
        (1.0 + 1e-15 * NOISE, Y, "the input is 1 throughout"),
        (LATE, TANK.filter(LATE), "the input is 1 in all samples that are to be fitted"),
        (U, np.r_[STILL, Y[HEAD:]], "the output is 1 in all samples that are to be fitted"),
        # Before the samples that are fitted, in which a pole shows and nothing else.
        (
            np.roll(IMPULSE, -5),
            TANK.filter(np.roll(IMPULSE, -5)),
            "linear: the input .* tells 3 of 4 numbers",
        ),
        (U[:1], Y[:1], "the input is"),
        (U[:3] + NOISE[:3], Y[:3], "are too few"),
        (np.full(len(U), np.nan), Y, "the input"),
        (U, np.full(len(U), np.nan), "the output has 200 of 200 samples that are not finite"),
        (1e200 * U, Y, "use another unit"),
        (U, 1e-200 * Y, "use another unit"),
        (U, np.exp(2.0 * np.arange(len(U))), "use another unit"),
    ],
)
def test_what_tells_nothing_is_an_error_in_words(u, y, why):
    with pytest.raises(EstimationError, match=why):
        tried(u, y)


@pytest.mark.parametrize(
    ("u", "y"),
    [
        (EARLY, TANK.filter(EARLY)),
        (U, np.r_[Y[:HEAD], STILL[:TAIL]]),
        (IMPULSE, TANK.filter(IMPULSE)),
        (np.sign(U), TANK.filter(np.sign(U))),
        ((U > 0.0).astype(float), (Y > 0.0).astype(float)),
        (np.round(10.0 * U), np.round(10.0 * Y)),
        (1e30 * U, 1e-30 * Y),
        (1e-30 * U, 1e30 * Y),
        (U, U),
        (U, DRAWS.standard_normal(len(U))),
        (U, np.where(np.arange(len(U)) == 100, 1e30, Y)),
        (np.linspace(0.0, 1.0, len(U)), np.linspace(0.0, 2.0, len(U))),
        (U + 1e8, Y - 1e8),
    ],
)
def test_what_tells_little_has_a_finite_model_and_no_warning_of_a_library(u, y):
    found = tried(u, y)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            said = found.residuals().sentences
        except EstimationError as error:
            said = (str(error),)
        assert said
        made = found.estimate(Record(u, y)).model.simulate(Record(u, y))
    assert np.all(np.isfinite(made))
    assert np.isfinite(found.chosen.rms)


def test_of_models_that_are_exact_up_to_rounding_the_smallest_is_chosen():
    found = tried(U, U, "linear", "hammerstein")
    assert found.chosen.structure == "linear"
    assert found.chosen.count == min(one.count for one in found.trials if one.fit is not None)


def test_residuals_that_stand_still_are_judged_beside_the_output_elsewhere():
    u, y = np.zeros(100), np.zeros(100)
    rounding = np.array([1e-17 * 0.6**k for k in range(100)])
    assert judgement(u, y, rounding, scale=1.0).vanish
    # A constant is no noise, and has no autoregression.
    with pytest.raises(EstimationError, match="no noise to judge by"):
        _ = judgement(u, y, np.full(100, 0.5), scale=1.0).sentences


def test_a_signal_of_few_digits_beside_its_level_is_told():
    told = [sentence for sentence in first_look(Record(U + 1e9, Y)).wrong if "--detrend mean" in sentence]
    assert told == [
        "The input varies by 1e-09 of its level (1e+09): few digits are left of what it tells: "
        "take the level off (--detrend mean)."
    ]
    assert not any("--detrend mean" in sentence for sentence in first_look(Record(U + 1e4, Y)).wrong)


@pytest.mark.parametrize(
    ("u", "y", "told"),
    [
        (EARLY, TANK.filter(EARLY), "warning: the input is 1 in all samples kept apart"),
        (U, np.r_[Y[:HEAD], STILL[:TAIL]], "warning: the output is 1 in all samples kept apart"),
    ],
)
def test_samples_kept_apart_that_stand_still_are_a_warning(tmp_path, u, y, told):
    np.savetxt(tmp_path / "still.csv", np.column_stack([u, y]), delimiter=",", header="u,y", comments="")
    command = "identify still.csv --input u --output y --structure linear --out out"
    done = run_forked(command.split(), tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Warning" not in done.stderr
    assert told in done.stdout
    # Without a spread there is no fit in percent.
    if "output" in told:
        row = next(line for line in done.stdout.splitlines() if line.endswith("chosen"))
        assert "  -  " in row


def test_an_impulse_has_a_model_and_no_traceback(tmp_path):
    columns = np.column_stack([IMPULSE, TANK.filter(IMPULSE)])
    np.savetxt(tmp_path / "impulse.csv", columns, delimiter=",", header="u,y", comments="")
    command = "identify impulse.csv --input u --output y --structure linear --out out"
    done = run_forked(command.split(), tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Warning" not in done.stderr
    assert "up to rounding: there are no residuals to judge" in done.stdout
