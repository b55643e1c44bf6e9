"""From a record to a model: what is tried, and how the choice is made."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml

import hident as hi
from hident.errors import EstimationError
from hident.estimators.prediction_error.chain_fit import fit_chain
from hident.estimators.prediction_error.criterion import Data
from hident.estimators.prediction_error.starts import ALL
from hident.identification.bootstrap import bootstrap
from hident.identification.candidates import STRUCTURES, Functions, Orders, chain, orders_of
from hident.identification.continuation import continued, resumed
from hident.identification.identify import Trial, identify, near_the_best, preferred, simplest
from hident.identification.split import quiet_beginning, split
from hident.linear_blocks import TransferFunction
from hident.measurements.first_look import first_look
from hident.measurements.preparation import Samples, decimated
from hident.records import Held, Part, Record, needed
from tests.forked import run_forked

SPEC = chain("linear", orders_of("linear", 1, 0), ())


def tank(samples, seed=0, noise=0.01):
    """A valve that saturates before a slow tank, with its input."""
    draws = np.random.default_rng(seed)
    u = np.repeat(draws.uniform(-2.0, 2.0, samples // 4 + 1), 4)[:samples]
    x = np.clip(u, -1.0, 1.2)
    y = TransferFunction((0.0, 0.0, 0.4), (0.6,)).filter(x)
    return u, y + noise * draws.standard_normal(samples)


def record_of(u, y, experiments=(), validation=None):
    parts = {
        f"run {i}": Part(start, stop, 1.0, Held(np.zeros(1), np.zeros(1)))
        for i, (start, stop) in enumerate(experiments)
    }
    return Record(u, y, 1.0, parts=parts, validation=validation)


@pytest.fixture(scope="module")
def found():
    u, y = tank(300)
    record = record_of(u, y)
    return identify(record, ["hammerstein"]), record


def test_the_structure_of_the_system_is_chosen(found):
    found, record = found
    assert found.chosen.structure == "hammerstein"
    assert found.chosen.rms < 0.02
    estimate = found.estimate(record)
    exact = TransferFunction((0.0, 0.0, 0.4), (0.6,)).impulse_response(20)
    np.testing.assert_allclose(estimate.linear.impulse_response(20), exact, atol=0.02)
    levels = estimate.nonlinearity(np.array([-2.0, 0.0, 2.0]))
    np.testing.assert_allclose(levels, [-1.0, 0.0, 1.2], atol=0.1)


def test_the_model_is_fitted_to_all_and_chosen_by_a_part(found):
    found, record = found
    assert found.parts.said == "the last fifth, 60 samples"
    assert len(found.parts.estimation.u) == 240
    assert found.model_fit.point.data.count == len(record) - found.parts.everything.n_init
    assert found.chosen.fit.point.data.count < found.model_fit.point.data.count


def test_what_is_kept_apart_is_simulated_from_the_beginning_of_the_record():
    u, y = tank(200, noise=0.0)
    parts = split(record_of(u, y), 0)
    valve = hi.Saturation(low=-1.0, high=1.2)
    model = TransferFunction((0.0, 0.0, 0.4), (0.6,))
    assert valve is not None
    from hident.block_chain import BlockChain
    from hident.static_functions import Saturation, StaticFunction

    exact = BlockChain((StaticFunction(Saturation(-1.0, 1.2), (0.0, 1.0)), model))
    tail = parts.output - parts.simulated(exact)
    assert len(tail) == 40
    # The system began at rest and the model settled: nothing is left of that after 160 samples.
    np.testing.assert_allclose(tail, 0.0, atol=1e-12)


def test_the_last_fifth_of_each_experiment_is_kept_apart():
    u, y = tank(300)
    parts = split(record_of(u, y, [(0, 100), (100, 300)]), 0)
    assert parts.said == "the last fifth of each experiment, 60 samples"
    np.testing.assert_array_equal(parts.output, np.r_[y[80:100], y[260:300]])
    np.testing.assert_array_equal(parts.estimation.y, np.r_[y[:80], y[100:260]])
    assert parts.estimation.experiments == (slice(0, 80), slice(80, 240))


def test_a_record_for_validation_leaves_all_of_the_record_to_be_fitted():
    u, y = tank(200)
    other = record_of(*tank(120, seed=1))
    parts = split(record_of(u, y, validation=other), 10)
    assert parts.estimation is parts.everything
    np.testing.assert_array_equal(parts.output, other.y[10:])


def test_a_quiet_beginning_is_left_out_but_for_its_end():
    u, y = tank(2000)
    noise = 0.001 * np.random.default_rng(0).standard_normal(1000)
    record = record_of(np.r_[np.zeros(1000), u], np.r_[noise, y])
    quiet = quiet_beginning(record, 100)
    assert 600 <= quiet <= 900
    parts = split(record, 50)
    np.testing.assert_array_equal(parts.everything.u, record.u[quiet:])
    np.testing.assert_array_equal(parts.output, record.y[2400:])
    assert quiet_beginning(record_of(u, y), 100) == 0
    # An output that moves under a constant input says something.
    moving = np.r_[0.5 * np.sin(0.1 * np.arange(1000)), y]
    assert quiet_beginning(record_of(np.r_[np.ones(1000), u], moving), 100) == 0


def delayed(delay, held, structure, samples=2000, seed=0, noise=0.02):
    """A saturation before or behind a linear block with a delay, its input held for some samples."""
    draws = np.random.default_rng(seed)
    u = np.repeat(draws.uniform(-2.0, 2.0, samples // held + 1), held)[:samples]
    block = TransferFunction((*(0.0,) * delay, 0.2), (1.2, -0.4))
    if structure == "hammerstein":
        y = block.filter(np.clip(u, -1.0, 1.2))
    else:
        y = np.clip(block.filter(u), -1.0, 1.2)
    return u, y + noise * draws.standard_normal(samples)


def linear_block(found):
    [block] = [block for block in found.chosen.spec.blocks if isinstance(block, hi.LinearBlock)]
    return block


@pytest.mark.parametrize(
    ("structure", "held", "delay"),
    [
        ("hammerstein", 1, 15),
        ("hammerstein", 4, 40),
        ("wiener", 1, 5),
        ("wiener", 4, 0),
        ("wiener", 4, 1),
        ("wiener", 4, 15),
        ("wiener", 4, 40),
    ],
)
def test_a_delay_is_found_with_low_orders(structure, held, delay):
    found = identify(record_of(*delayed(delay, held, structure)), [structure])
    block = linear_block(found)
    shown = needed(found.delay)
    assert shown.low <= delay <= shown.high
    assert block.nk == delay
    assert block.nb <= 3
    assert block.nf == 2
    assert found.chosen.rms == pytest.approx(0.02, rel=0.05)


def test_a_delay_behind_the_filter_of_a_decimation_is_found():
    """Behind that filter the answer is smeared to both sides of 3.75 samples."""
    draws = np.random.default_rng(0)
    u = np.repeat(draws.uniform(-2.0, 2.0, 200), 40)
    y = np.clip(TransferFunction((*(0.0,) * 15, 0.01), (1.8, -0.81)).filter(u), -1.0, 1.2)
    slow = decimated(Samples("", u, y + 0.02 * draws.standard_normal(8000)), 4)
    found = identify(record_of(slow.u, slow.y), ["wiener"])
    block = linear_block(found)
    shown = needed(found.delay)
    assert shown.low <= 3.75 <= shown.high
    assert 3 <= block.nk <= 4
    assert block.nb + block.nf <= 6


def test_a_delay_that_is_given_is_that_of_all_chains():
    record = record_of(*delayed(15, 4, "wiener", 600))
    found = identify(record, ["wiener"], delay=14)
    assert {linear_block(replace(found, chosen=one)).nk for one in found.trials} == {14}
    with pytest.raises(
        EstimationError, match="a delay of 470 samples is too long: the shortest experiment has"
    ):
        identify(record, ["wiener"], delay=470)


def test_no_delay_is_found_where_the_input_does_not_act():
    u, y = np.random.default_rng(3).standard_normal((2, 400))
    found = identify(record_of(u, y), ["linear"])
    assert found.delay is None
    assert {linear_block(replace(found, chosen=one)).nk for one in found.trials} == {0}


def _trial(count, kept, fitted=None):
    # Whether it was fitted is all that matters of the fit.
    kept = np.asarray(kept, dtype=float)
    return Trial("linear", SPEC, count, object(), kept if fitted is None else fitted, kept)  # type: ignore[arg-type]


def test_the_simplest_of_those_that_cannot_be_told_apart_is_chosen():
    draws = np.random.default_rng(0)
    common = draws.chisquare(1, 1000)
    best = _trial(20, common)
    noise = draws.standard_normal(1000)
    near = _trial(5, common + 1e-4 * (noise - noise.mean()) + 1e-6)
    worse = _trial(2, common * 1.5)
    assert {id(one) for one in near_the_best([worse, near, best])} == {id(near), id(best)}
    assert preferred([worse, near, best], "validation") is near
    # One that is near by chance, and was fitted far worse.
    lucky = _trial(3, near.validation, fitted=1.5 * common)
    assert simplest([worse, lucky, near, best], "validation") is lucky
    assert preferred([worse, lucky, near, best], "validation") is near


def test_a_chain_that_is_clearly_worse_is_not_chosen_for_being_simple():
    draws = np.random.default_rng(0)
    common = draws.chisquare(1, 1000)
    best, worse = _trial(20, common), _trial(2, common + 0.05)
    assert preferred([worse, best], "validation") is best


def test_by_a_criterion_the_least_is_chosen_whatever_was_kept_apart():
    small, large = (
        _trial(count, np.full(50, kept), fitted=np.full(100, rms**2))
        for count, rms, kept in ((3, 1.0, 2.0), (9, 0.95, 1.0))
    )
    assert small.aic == pytest.approx(6.0)
    assert large.bic == pytest.approx(100 * np.log(0.95**2) + 9 * np.log(100))
    assert preferred([small, large], "validation") is large
    assert preferred([small, large], "bic") is small
    assert preferred([small, large], "aic") is small


def test_a_short_fit_is_judged_on_all_that_is_to_be_fitted():
    u, y = tank(9000)
    found = identify(record_of(u, y), ["linear"], n_init=10)
    # Orders are compared by fits to a part, and their criteria are of the same samples.
    assert {len(one.fitted) for one in found.trials if one.fit} == {7190}
    assert min(one.fit.point.data.count for one in found.trials if one.fit) < 7190


class TestFewLevels:
    def test_of_two_levels_no_static_function_at_the_input_is_tried(self):
        draws = np.random.default_rng(0)
        u = np.sign(draws.standard_normal(300))
        y = TransferFunction((0.0, 0.4), (0.6,)).filter(u) + 0.01 * draws.standard_normal(300)
        found = identify(record_of(u, y), ["linear", "hammerstein"])
        assert {one.structure for one in found.trials} == {"linear"}
        assert found.notes == (
            "not tried: hammerstein, as the input has 2 levels, and a static function of two levels is a "
            "line",
        )
        with pytest.raises(EstimationError, match="nothing could be fitted: not tried: hammerstein, as the"):
            identify(record_of(u, y), ["hammerstein"])

    def test_no_polynomial_beyond_the_levels_is_tried_before_the_linear_block(self):
        levels = Functions.of_input(np.tile([0.0, 1.0, 3.0, 4.0], 50))
        tried = [static for (static,) in levels.of("hammerstein")]
        assert tried == [
            {"kind": "piecewise_linear", "knots": 4},
            {"kind": "polynomial", "degree": 2},
        ]
        # Behind a linear block there are more levels.
        assert len(levels.of("wiener")) == len(Functions().of("wiener"))
        assert {first["kind"] for first, _ in levels.of("hammerstein_wiener")} == {"piecewise_linear"}
        assert "has 4 levels" in levels.notes(["linear", "hammerstein"])[0]
        assert levels.notes(["linear", "wiener"]) == ()

    def test_values_that_are_many_are_no_levels(self):
        assert Functions.of_input(np.linspace(0.0, 1.0, 100)).levels is None
        assert Functions.of_input(np.arange(10.0)).levels is None

    def test_the_values_at_the_levels_are_found(self):
        draws = np.random.default_rng(1)
        u = draws.choice([-2.0, 0.0, 1.0, 3.0], 400)
        exact = TransferFunction((0.0, 0.4), (0.6,)).filter(np.clip(u, -1.0, 2.0))
        y = exact + 0.01 * draws.standard_normal(400)
        found = identify(record_of(u, y), ["hammerstein"])
        function = needed(found.estimate(record_of(u, y)).nonlinearity)
        np.testing.assert_allclose(function(np.array([-2.0, 0.0, 1.0, 3.0])), [-1, 0, 1, 2], atol=0.02)


def drive(function, seed, samples=600):
    """A resonant drive at a few speeds, a sensor that does not tell their sign, and its filter."""
    draws = np.random.default_rng(seed)
    levels = draws.choice([-1.0, 1.4], samples) if seed % 2 else draws.uniform(-1.0, 1.6, samples)
    u = np.repeat(levels, 5 if seed % 2 else 8)[:samples]
    resonance = 0.93 * np.exp(0.48j)
    poles = np.poly([resonance, resonance.conjugate(), 0.88]).real
    x = TransferFunction((0.0, 0.0, 0.02, 0.01), tuple(-poles[1:])).filter(u)
    y = TransferFunction((0.4,), (0.6,)).filter(function(x / np.std(x)))
    return u, y / np.std(y) + 0.1 * draws.standard_normal(samples)


@pytest.mark.parametrize("function", [np.abs, np.square, lambda x: np.maximum(x, 0.0)])
def test_behind_a_function_that_is_far_from_a_line_both_linear_blocks_are_found(function):
    # The linear approximation says little of the roots: searches that split them end elsewhere in some.
    blocks = [Orders(4, 3, 0), Orders(4, 3, 0)]
    structure = chain("wiener_hammerstein", blocks, [{"kind": "cubic_spline", "knots": 8}]).structure()
    alone, left = [], []
    for seed in range(6):
        u, y = drive(function, seed)
        data = Data(u, y, (slice(0, len(u)),), "rest")
        found = fit_chain(structure, data, max_iterations=25)
        better = fit_chain(structure, data, max_iterations=25, initialisation=ALL)
        alone.append(found.point.loss / data.count)
        left.append(better.point.loss / data.count)
    assert max(alone) > 0.02
    # The noise has the variance 0.01.
    assert max(left) < 0.0115


@pytest.mark.parametrize(("first", "last"), [(0, 2), (3, 1)])
def test_a_shorter_chain_is_the_same_with_its_delay_between_two_blocks(first, last):
    u, y = drive(np.square, 0)
    data = Data(u, np.r_[np.zeros(first + last), y[: len(y) - first - last]], (slice(0, len(u)),), "rest")
    blocks = [Orders(4, 3, first), Orders(1, 1, last)]
    structure = chain("wiener_hammerstein", blocks, [{"kind": "polynomial", "degree": 2}]).structure()
    found = fit_chain(structure, data, max_iterations=25, initialisation=ALL)
    assert found.point.loss / data.count < 0.0115
    assert found.agreeing <= found.finalists


def test_a_longer_chain_is_no_worse_than_a_shorter_one_on_what_is_fitted():
    u, y = drive(np.abs, 0)
    tried = identify(record_of(u, y), ["wiener", "wiener_hammerstein"]).trials

    def least(structure):
        return min(one.estimation for one in tried if one.structure == structure)

    assert least("wiener_hammerstein") < 1.02 * least("wiener")


def test_a_bootstrap_spreads_as_the_standard_errors_say():
    u, y = tank(400, noise=0.1)
    record = record_of(u, y)
    found = identify(record, ["linear"])
    again = bootstrap(found, 60)
    assert again.failed == 0
    spread = np.std([chain.linear[0].a[0] for chain in again.chains], ddof=1)
    errors = found.estimate(record).values
    assert spread == pytest.approx(errors["se_a_1"], rel=0.4)
    same = bootstrap(found, 2)
    assert same.chains == again.chains[:2]


def function_of(fit):
    (function,) = fit.point.parameters.chain.static
    return function


class TestGoingOn:
    @pytest.fixture(scope="class")
    @staticmethod
    def fits():
        u, y = tank(3000, noise=0.05)
        spec = chain("hammerstein", [Orders(2, 1, 1)], [{"kind": "cubic_spline", "knots": 8}])
        part, whole = (Data(u[:n], y[:n], (slice(0, n),), "settled", 20) for n in (2400, 3000))
        return spec.structure(), spec.identify(record_of(u[:2400], y[:2400])), part, whole

    def test_with_the_same_functions_few_steps_are_left(self, fits):
        structure, fit, _, whole = fits
        again = continued(structure, fit.point.parameters.chain, whole)
        resumed_ = resumed(structure, fit.point.parameters, whole)
        # Knots follow the samples: those of all are not quite those of a part.
        assert resumed_.point.loss == pytest.approx(again.point.loss, rel=1e-2)
        assert resumed_.iterations <= again.iterations <= 3
        assert function_of(resumed_).basis == function_of(fit).basis != function_of(again).basis

    def test_where_many_samples_lie_beyond_the_functions_are_made_anew(self, fits):
        structure, fit, _, whole = fits
        wider = replace(whole, u=1.5 * whole.u)
        again = resumed(structure, fit.point.parameters, wider)
        low, high = function_of(again).range
        assert low < np.min(wider.u) < np.max(wider.u) < high

    def test_the_ranges_are_those_of_other_data(self, fits):
        structure, fit, part, whole = fits
        wider = replace(whole, u=1.5 * whole.u)
        again = continued(structure, fit.point.parameters.chain, part, whole=wider)
        assert function_of(again).range[1] > np.max(wider.u)
        assert again.point.data is part


def test_two_linear_blocks_share_the_order_and_the_last_has_the_delay():
    assert orders_of("wiener", 3, 1) == [Orders(3, 3, 1)]
    assert orders_of("wiener", 3, 0) == [Orders(4, 3, 0)]
    assert orders_of("wiener", 3, 7) == [Orders(6, 3, 4)]
    assert orders_of("wiener", 3, 7, is_sure=True) == [Orders(3, 3, 7)]
    assert orders_of("wiener_hammerstein", 4, 1) == [Orders(4, 3, 0), Orders(4, 3, 1)]


@pytest.mark.parametrize("structure", STRUCTURES)
def test_each_structure_is_an_estimator(structure):
    static = [{"kind": "polynomial", "degree": 3}] * STRUCTURES[structure].count("N")
    spec = chain(structure, orders_of(structure, 2, 1), static, n_init=5)
    kinds = "-".join("L" if isinstance(block, hi.LinearBlock) else "N" for block in spec.blocks)
    # A linear model has a constant beside it, which is a static block.
    assert kinds == {"linear": "L-N"}.get(structure, STRUCTURES[structure])


@pytest.mark.parametrize(
    ("u", "y", "said"),
    [
        (np.ones(200), np.arange(200.0), "the input is 1 throughout"),
        (np.arange(200.0), np.ones(200), "the output is 1 throughout"),
        (np.arange(30.0), np.arange(30.0), "23 samples to fit and 6 to choose by are too few"),
        (np.arange(200.0), np.full(200, np.nan), "the output has 200 of 200 samples that are not finite"),
    ],
)
def test_a_record_that_says_nothing_is_refused_with_the_reason(u, y, said):
    with pytest.raises(EstimationError, match=said):
        identify(record_of(u, y))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("identify")
    u, y = tank(300)
    lines = ["valve,level", *(f"{a:.6g},{b:.6g}" for a, b in zip(u, y, strict=True))]
    (folder / "tank.csv").write_text("\n".join(lines) + "\n")
    return folder


def test_bootstraps_are_bands_in_the_figures(folder):
    arguments = ["identify", "tank.csv", "--input", "valve", "--output", "level", "--structure", "linear"]
    done = run_forked([*arguments, "--bootstrap", "3", "--by", "bic", "--out", "bands"], folder)
    assert (done.returncode, done.stderr) == (0, "")
    assert "bands: 3 bootstraps of the residuals in blocks of" in done.stdout
    assert "chosen by BIC" in done.stdout
    assert (folder / "bands/bode.png").stat().st_size > 0


def _printed(folder, u, y, *arguments):
    lines = ["u,y", *(f"{a:.6g},{b:.6g}" for a, b in zip(u, y, strict=True))]
    (folder / "r.csv").write_text("\n".join(lines) + "\n")
    done = run_forked(["identify", "r.csv", "--input", "u", "--output", "y", *arguments], folder)
    assert done.returncode == 0
    assert all(line.startswith("warning: The ") for line in done.stderr.splitlines())
    return done.stdout


def test_what_show_finds_wrong_is_a_warning_and_stands_in_the_table(tmp_path):
    u, y = tank(300)
    y = np.minimum(y, np.quantile(y, 0.8))
    lines = ["u,y", *(f"{a:.6g},{b:.6g}" for a, b in zip(u, y, strict=True))]
    (tmp_path / "r.csv").write_text("\n".join(lines) + "\n")
    columns = ["r.csv", "--input", "u", "--output", "y", "--estimate", "1..250", "--validate", "r.csv"]
    done = run_forked(["identify", *columns, "--structure", "linear"], tmp_path)
    wrong = first_look(hi.read(tmp_path / "r.csv", input="u", output="y", estimation="1..250")).wrong
    assert len(wrong) == 1
    assert "saturated" in wrong[0]
    assert done.stderr.splitlines()[0] == f"warning: {wrong[0]}"
    assert done.stderr.splitlines()[1].startswith("warning: For validation: The output stands at its highest")
    assert f"- {wrong[0]}" in (tmp_path / "out/identify_r/table.md").read_text().splitlines()


def test_the_delay_is_printed_with_its_interval_and_can_be_given(tmp_path):
    u, y = tank(400)
    said = _printed(tmp_path, u, y, "--structure", "linear")
    assert "\ndelay: 2 samples, by the cross-correlation with the input, prewhitened by autoreg" in said
    said = _printed(tmp_path, u, y, "--structure", "linear", "--delay", "1")
    assert "; 1 in the chosen chain, as given\n" in said


def test_inputs_that_were_not_fitted_are_said(tmp_path):
    draws = np.random.default_rng(0)
    u = np.r_[draws.choice([0.0, 1.0, 2.0], 240), draws.choice([0.0, 3.0], 60)]
    y = TransferFunction((0.0, 0.4), (0.6,)).filter(u**2) + 0.01 * draws.standard_normal(300)
    said = _printed(tmp_path, u, y, "--structure", "hammerstein")
    assert "of the samples kept apart have input levels (3) that were not fitted" in said
    assert "the input has 3 levels: of a static function at the input it tells 3 values and" in said
    u, y = tank(300)
    assert "that were not fitted" not in _printed(tmp_path, u, y, "--structure", "linear")
    # The values at the end are greater than all before.
    u[250:] += 3.0
    said = _printed(tmp_path, u, y, "--structure", "linear")
    assert "% of the samples kept apart have input values, outside of " in said


def test_numbers_that_the_record_does_not_determine_are_said(tmp_path):
    u, y = np.random.default_rng(2).standard_normal((2, 200))
    said = _printed(tmp_path, u, y, "--structure", "linear", "--by", "aic")
    assert "numbers of the model are below their standard errors: the record does not determine them" in said
    assert "below their standard errors" not in _printed(tmp_path, *tank(300), "--structure", "linear")


def test_the_command_writes_a_model_a_table_and_a_configuration(folder):
    arguments = ["identify", "tank.csv", "--input", "valve", "--output", "level", "--dt", "4"]
    done = run_forked([*arguments, "--structure", "linear"], folder)
    assert (done.returncode, done.stderr) == (0, "")
    assert "chosen" in done.stdout
    written = folder / "out/identify_tank"
    model = hi.load_model(written / "model.json")
    assert (model.chain.structure, model.chain.dt) == ("L-N", 4.0)
    assert model.about["input"] == "valve"
    assert len(model.ranges) == 2
    document = json.loads((written / "model.json").read_text())
    assert list(document["about"]["data"]) == ["tank.csv"]
    assert (written / "table.md").read_text().startswith("# What was tried on tank.csv\n")
    assert yaml.safe_load((written / "experiment.yaml").read_text())["record"]["file"] == ["../../tank.csv"]
    again = run_forked(["run", "out/identify_tank/experiment.yaml", "--jobs", "1"], folder)
    assert again.returncode == 0
    compared = run_forked(
        ["simulate", "out/identify_tank/model.json", "tank.csv", "--compare", "level"], folder
    )
    assert "against 'level' (simulation): RMSE" in compared.stdout


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["--structure", "hamerstein"],
            "error: --structure: unknown structure 'hamerstein'; did you mean 'hammerstein'? (allowed: "
            "linear, hammerstein, wiener, wiener_hammerstein, hammerstein_wiener)\n",
        ),
        (["--by", "aicc"], "error: --by: must be validation, aic, bic, not 'aicc'; did you mean 'aic'?\n"),
        (["--n-init", "300"], "error: tank.csv: 0 samples to fit and 60 to choose by are too few: "),
    ],
)
def test_what_cannot_be_done_is_said(folder, arguments, said):
    done = run_forked(["identify", "tank.csv", "--input", "valve", "--output", "level", *arguments], folder)
    assert done.returncode == 2
    assert done.stderr.startswith(said)


class TestEstimatedStates:
    """A record of short experiments, each of which begins in motion."""

    @pytest.fixture(scope="class")
    @classmethod
    def record(cls):
        draws = np.random.default_rng(5)
        block = TransferFunction((0.0, 0.05), (0.95,))
        u, y = [], []
        for _ in range(8):
            level = np.repeat(draws.uniform(-2.0, 2.0, 60), 5)
            u.append(level[200:])
            y.append(block.filter(np.clip(level, -1.0, 1.2))[200:])
        noise = 0.005 * draws.standard_normal(800)
        return record_of(
            np.concatenate(u), np.concatenate(y) + noise, [(100 * k, 100 * (k + 1)) for k in range(8)]
        )

    @pytest.fixture(scope="class")
    @classmethod
    def found(cls, record):
        return identify(record, ["hammerstein"], start="estimated")

    def test_the_model_begins_as_each_experiment_does(self, record, found):
        model = found.estimate(record).model
        assert (model.start, len(model.begun)) == ("estimated", 8)
        assert found.chosen.spec.n_init == 0
        assert np.std(record.y - model.simulate(record)) == pytest.approx(0.005, rel=0.1)
        assert model.chain.linear[0].a[0] == pytest.approx(0.95, abs=0.005)

    def test_what_is_kept_apart_is_simulated_from_states_that_it_does_not_tell(self, record, found):
        assert found.chosen.rms == pytest.approx(0.005, rel=0.2)
        assert identify(record, ["hammerstein"]).chosen.rms > 1.5 * found.chosen.rms
        y = record.y.copy()
        y[80:100] += 5.0
        other = split(replace(record, y=y), None, "estimated")
        chain = found.chosen.fit.point.parameters.chain
        np.testing.assert_array_equal(other.simulated(chain), found.parts.simulated(chain))

    def test_bands_are_of_fits_beside_the_chosen_one(self, found):
        poles = [chain.linear[0].a[0] for chain in bootstrap(found, 5).chains]
        assert poles == pytest.approx([0.95] * 5, abs=0.01)

    def test_the_command_writes_a_configuration_that_finds_the_states_too(self, folder):
        arguments = ["tank.csv", "--input", "valve", "--output", "level", "--structure", "linear"]
        done = run_forked(["identify", *arguments, "--start", "estimated", "--out", "begun"], folder)
        assert done.returncode == 0
        written = yaml.safe_load((folder / "begun/experiment.yaml").read_text())
        assert written["estimators"]["chosen"]["start"] == "estimated"
        assert hi.load_model(folder / "begun/model.json").begun
        done = run_forked(["identify", *arguments, "--start", "estimate"], folder)
        assert (done.returncode, done.stderr) == (
            2,
            "error: --start: must be settled, rest, estimated, not 'estimate'; did you mean 'estimated'?\n",
        )
