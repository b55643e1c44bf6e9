"""Settings that are chosen by the data."""

import math
import pickle
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import hident as hi
from hident import plugins
from hident.config.spec import Of, canonical, component
from hident.engine.experiment import load
from hident.engine.fingerprint import modules
from hident.engine.runner import run
from hident.errors import ConfigError, EstimationError
from hident.estimators.base import EstimatorSpec
from hident.estimators.selection.folds import at_the_end, in_blocks
from hident.model_output import simulated
from hident.records import Held, Part, Record, needed
from hident.reports.one_trial.searches import abscissa_of, draw_selection
from hident.reports.output import check
from hident.reports.scoring import scoring
from hident.reports.style import subplots
from tests.unit.plans import planned, refusals, replaced

plugins.load()
KERNEL = {"kind": "kernel", "kernel": "gaussian", "bandwidth": {"alpha": 0}}
WIDTHS = [0.02, 0.08, 0.3, 1]
CUBIC = {"kind": "polynomial", "coefficients": [0, 1, 0.5, 0.25]}
TWO_STAGE = {"kind": "two_stage", "degree": 3, "delay": 0}
BASIS = {"basis": {"kind": "trigonometric", "interval": [-2, 2]}}


def record_of(samples=200, *, std=0.1, b=(1, 0.6, -0.3), a=(), seed=1, excitation=None):
    linear = {"kind": "arma", "a": list(a), "b": list(b)} if a else {"kind": "fir", "b": list(b)}
    system = {"kind": "hammerstein", "nonlinearity": CUBIC, "linear": linear}
    excitation = excitation or {"kind": "iid", "distribution": "uniform", "low": -2, "high": 2}
    return hi.simulate(system, excitation, samples, noise={"kind": "white", "std": std}, seed=seed)


def several(lengths, seed=1, **settings):
    parts = [
        {
            "name": f"run {i}",
            "samples": n,
            "excitation": {"kind": "iid", "distribution": "uniform", "low": -2, "high": 2},
        }
        for i, n in enumerate(lengths)
    ]
    return record_of(sum(lengths), seed=seed, excitation={"kind": "experiments", "parts": parts}, **settings)


def selected(estimate):
    return estimate.details["selection"]


class TestFolds:
    @pytest.mark.parametrize("lengths", [[50], [23, 7, 40], [3, 90]])
    @pytest.mark.parametrize("gap", [0, 2])
    def test_each_sample_is_held_out_once_and_never_fitted_then(self, lengths, gap):
        n = sum(lengths)
        bounds = np.cumsum([0, *lengths])
        parts = {
            f"e{i}": Part(start, stop, 0.5, Held(np.zeros(1), np.zeros(1)))
            for i, (start, stop) in enumerate(pairwise(bounds))
        }
        # The samples are numbered, so that what is fitted tells where it is from.
        record = Record(np.arange(n), -np.arange(n), 0.5, parts=parts if len(lengths) > 1 else {})
        folds = in_blocks(record, 5, gap)
        assert np.array_equal(np.sum([fold.held_out for fold in folds], axis=0), np.ones(n))
        experiment = np.searchsorted(bounds, np.arange(n), "right")
        for fold in folds:
            fitted = fold.training.u.astype(int)
            assert np.array_equal(fold.training.y, -fold.training.u)
            near = [
                i
                for i in range(n)
                if any(
                    fold.held_out[j] and experiment[j] == experiment[i]
                    for j in range(max(i - gap, 0), min(i + gap + 1, n))
                )
            ]
            assert sorted({*range(n)} - {*near}) == fitted.tolist()
            for part in fold.training.experiments:
                inside = fitted[part]
                # Consecutive samples of one experiment.
                assert np.array_equal(inside, np.arange(inside[0], inside[-1] + 1))
                assert len({*experiment[inside]}) == 1
            assert all(part.dt == 0.5 for part in fold.training.parts.values())

    def test_the_end_of_each_experiment(self):
        fold = at_the_end(several([40, 20]), 0.25, 0)
        assert np.flatnonzero(fold.held_out).tolist() == [*range(30, 40), *range(55, 60)]
        assert list(fold.training.parts) == ["run 0 1", "run 1 2"]

    def test_a_record_of_one_experiment_stays_one(self):
        assert at_the_end(record_of(40), 0.25, 0).training.parts == {}

    def test_experiments_shorter_than_the_folds_have_empty_blocks(self):
        folds = in_blocks(record_of(3), 5, 0)
        assert [np.flatnonzero(fold.held_out).tolist() for fold in folds] == [[0], [1], [2]]


class TestCriteria:
    def test_leave_one_out_is_what_fitting_without_each_sample_gives(self):
        record = record_of(40)
        chosen = hi.fit(
            hi.Select(by="leave_one_out", over={"bandwidth.h0": WIDTHS}, estimator=KERNEL), record
        )
        expected = []
        for h0 in WIDTHS:
            kernel = hi.Kernel(kernel="gaussian", bandwidth={"h0": h0, "alpha": 0})
            errors = []
            for i in range(len(record)):
                rest = Record(np.delete(record.u, i), np.delete(record.y, i))
                errors.append(record.y[i] - needed(kernel.fit(rest).nonlinearity)(record.u[i : i + 1])[0])
            expected.append(np.mean(np.square(errors)))
        np.testing.assert_allclose(selected(chosen).criterion, expected, rtol=1e-10)
        assert chosen.values == {"selected bandwidth.h0": WIDTHS[int(np.argmin(expected))]}

    def test_of_a_filtered_kernel_it_is_the_error_of_one_step_prediction(self):
        record = record_of(100, b=[2], a=[0.7])
        known = {"kind": "known_dynamics", "a": [0.7], "b": [2]}
        select = hi.Select(
            by="cross_validation", over={"bandwidth.h0": [0.1, 0.5]}, estimator={**KERNEL, "prefilter": known}
        )
        expected = []
        for h0 in (0.1, 0.5):
            kernel = hi.Kernel(kernel="gaussian", bandwidth={"h0": h0, "alpha": 0}, prefilter=known)
            errors = np.full(100, np.nan)
            for fold in in_blocks(record, 5, 0):
                curve = needed(kernel.fit(fold.training).nonlinearity)
                predicted = 0.7 * np.roll(record.y, 1) + 2.0 * curve(record.u)
                errors[fold.held_out] = (record.y - predicted)[fold.held_out]
            expected.append(np.mean(errors[1:] ** 2))
        np.testing.assert_allclose(selected(hi.fit(select, record)).criterion, expected, rtol=1e-10)

    def test_prefilters_of_several_gains_are_judged_in_the_unit_of_the_output(self):
        record = record_of(300, b=[1], a=[0.7])
        blocks = [{"kind": "known_dynamics", "a": [0.7], "b": [gain]} for gain in (100, 1, 0.01)]
        kernel = {"kind": "kernel", "kernel": "gaussian", "bandwidth": {"h0": 0.2, "alpha": 0}}
        for by in ("cross_validation", "leave_one_out", "holdout"):
            found = hi.fit(hi.Select(by=by, over={"prefilter": blocks}, estimator=kernel), record)
            criterion = selected(found).criterion
            np.testing.assert_allclose(criterion, criterion[0], rtol=1e-9)
            assert found.values["selected prefilter"] == 1.0

    def test_cross_validation_scores_the_simulated_output_of_each_block(self):
        record = record_of(200)
        select = hi.Select(by="cross_validation", folds=4, over={"lags": ["1..3"]}, estimator=TWO_STAGE)
        expected = []
        for lags in (1, 2, 3):
            errors = np.full(200, np.nan)
            for fold in in_blocks(record, 4, 0):
                estimate = hi.TwoStage(lags=lags, degree=3, delay=0).fit(fold.training)
                errors[fold.held_out] = (record.y - simulated(estimate, record))[fold.held_out]
            expected.append(np.mean(errors[20:] ** 2))
        found = hi.fit(select, record)
        np.testing.assert_allclose(selected(found).criterion, expected, rtol=1e-12)
        assert found.values["selected lags"] == 3.0
        # The estimate is that of the whole record.
        whole = hi.TwoStage(lags=3, degree=3, delay=0).fit(record)
        assert {name: found.values[name] for name in whole.values} == dict(whole.values)

    @pytest.mark.parametrize("by", ["cross_validation", "holdout"])
    @pytest.mark.parametrize("lengths", [[200], [90, 110]])
    def test_a_block_that_is_held_out_begins_in_the_state_that_it_has(self, by, lengths):
        """Without noise nothing is left of it: neither a lag nor a filter reaches where nothing is known."""
        record = several(lengths, std=0, b=[1, 0.5, 0.4, -0.3])
        found = hi.fit(hi.Select(by=by, over={"lags": [2, 4]}, estimator=TWO_STAGE), record)
        short, right = selected(found).criterion
        assert right < 1e-20
        assert short > 0.01

    def test_what_is_fitted_behind_a_block_begins_in_motion(self):
        """A chain that takes each experiment to begin settled would learn a wrong model from it."""
        record = record_of(400, std=0.2, b=[1, 0.5], a=[0.8])
        chain = [{"kind": "polynomial", "degree": 3}, {"kind": "linear", "nb": 2, "nf": 1}]
        select = hi.Select(
            by="cross_validation",
            over={"blocks.1.nb": [2]},
            estimator={"kind": "prediction_error", "blocks": chain, "start": "rest"},
        )
        assert selected(hi.fit(select, record)).criterion[0] == pytest.approx(0.04, rel=0.15)

    def test_information_criteria(self):
        record = record_of(200)
        n = 180
        for by, formula in (
            ("aic", lambda v, d: n * math.log(v) + 2 * d),
            ("bic", lambda v, d: n * math.log(v) + d * math.log(n)),
            ("fpe", lambda v, d: v * (1 + d / n) / (1 - d / n)),
        ):
            found = hi.fit(hi.Select(by=by, over={"lags": [1, 3, 5]}, estimator=TWO_STAGE), record)
            expected = []
            for lags in (1, 3, 5):
                estimate = hi.TwoStage(lags=lags, degree=3, delay=0).fit(record)
                v = np.mean((record.y - simulated(estimate, record))[20:] ** 2)
                # |b| = 1 takes one of the coefficients.
                expected.append(formula(v, lags + 3 - 1))
            np.testing.assert_allclose(selected(found).criterion, expected, rtol=1e-12)

    def test_among_perfect_fits_the_one_with_the_fewest_parameters_is_taken(self):
        record = record_of(200, std=0)
        for by in ("aic", "bic", "fpe"):
            found = hi.fit(hi.Select(by=by, over={"lags": [5, 4, 3]}, estimator=TWO_STAGE), record)
            assert found.values["selected lags"] == 3.0

    @pytest.mark.parametrize(
        ("settings", "count"),
        [
            # b_0 to b_2 of length one, and c_1 to c_3.
            ({"kind": "two_stage", "lags": 3, "degree": 3}, 5),
            ({"kind": "known_nonlinearity", "lags": 3, "nonlinearity": "abs"}, 3),
            # f and g have three coefficients each; a_1, b_0 and b_1, of which b_0 is one.
            ({"kind": "voros_hammerstein", "n": 1, "m": 2, "delay": 0, "degree": 3}, 8),
            ({"kind": "kernel", "kernel": "gaussian", "bandwidth": "plug_in"}, None),
            # A cubic, its constant included, b_0 and f_1; one gain is free.
            (
                {
                    "kind": "prediction_error",
                    "blocks": [{"kind": "polynomial", "degree": 3}, {"kind": "linear", "nb": 1, "nf": 1}],
                },
                5,
            ),
        ],
    )
    def test_free_parameters(self, settings, count):
        estimator = Of("estimator").validate(settings)
        assert isinstance(estimator, EstimatorSpec)
        assert estimator.free_parameters() == count

    def test_bic_finds_the_number_of_lags(self):
        select = hi.Select(by="bic", over={"lags": ["1..6"]}, estimator=TWO_STAGE)
        found = [hi.fit(select, record_of(400, seed=seed)).values["selected lags"] for seed in range(20)]
        assert found.count(3.0) >= 18

    def test_a_gap_keeps_noise_that_remembers_from_the_choice(self):
        record = record_of(100)
        criteria = [
            selected(
                hi.fit(
                    hi.Select(
                        by="cross_validation", gap=gap, over={"bandwidth.h0": WIDTHS}, estimator=KERNEL
                    ),
                    record,
                )
            ).criterion
            for gap in (0, 5)
        ]
        assert not np.array_equal(*criteria)


class TestChoice:
    def test_the_first_of_equals_is_taken(self):
        over = {"bandwidth.h0": [0.3, 0.3], "empty": ["zero", "nearest"]}
        found = hi.fit(hi.Select(by="leave_one_out", over=over, estimator=KERNEL), record_of())
        assert found.values == {"selected bandwidth.h0": 0.3, "selected empty": 1.0}
        assert selected(found).chosen == 0

    def test_what_is_no_number_is_chosen_by_its_place_in_the_list(self):
        over: dict[str, Any] = {"kernel": ["window_unit", "gaussian"], "bandwidth.h0": [0.1, 3]}
        estimator = {"kind": "kernel", "bandwidth": {"alpha": 0}}
        found = hi.fit(hi.Select(by="leave_one_out", over=over, estimator=estimator), record_of())
        assert found.values["selected bandwidth.h0"] == 0.1
        assert found.values["selected kernel"] in (1.0, 2.0)
        assert selected(found).estimator.kernel == over["kernel"][int(found.values["selected kernel"]) - 1]

    def test_a_candidate_that_fails_is_left_out(self):
        estimator = {**KERNEL, "kernel": "window_unit", "empty": "fail"}
        select = hi.Select(by="cross_validation", over={"bandwidth.h0": [1e-6, 0.3]}, estimator=estimator)
        found = hi.fit(select, record_of())
        assert found.values == {"selected bandwidth.h0": 0.3}
        assert np.isnan(selected(found).criterion[0])
        assert "have no sample within the kernel's window" in selected(found).failures[0]

    @pytest.mark.parametrize(
        ("by", "settings"), [("aic", {}), ("holdout", {"share": 0.4}), ("cross_validation", {"folds": 3})]
    )
    def test_candidates_that_are_too_long_for_the_record_are_left_out(self, by, settings):
        over = {"lags": [2, 200]}
        select = hi.Select(by=by, over=over, estimator={**TWO_STAGE, "degree": 1}, **settings)
        found = hi.fit(select, record_of(100))
        assert found.values["selected lags"] == 2.0
        assert "needs at least" in selected(found).failures[1]
        alone = hi.Select(by=by, over={"lags": [2]}, estimator={**TWO_STAGE, "degree": 1}, **settings)
        assert select.fewest_samples() == alone.fewest_samples()
        assert found.values == hi.fit(alone, record_of(100)).values

    def test_where_a_record_suits_no_candidate_the_shortest_is_named(self):
        select = hi.Select(by="aic", over={"lags": [30, 200]}, estimator=TWO_STAGE)
        with pytest.raises(ConfigError, match=r"needs at least \d+ samples, and the record has 40"):
            hi.fit(select, record_of(40))

    def test_candidates_that_a_sampling_does_not_suit_are_left_out(self):
        steps = {"kind": "multistep", "switching_time": 1, "std": 1}
        linear = {"kind": "continuous", "a": [2.5, 1.5]}
        system = {"kind": "hammerstein", "nonlinearity": "identity", "linear": linear}
        record = hi.simulate(system, steps, 400, dt=0.1)
        model = {"kind": "linear_model", "block": {"n": 2}}
        select = hi.Select(by="holdout", over={"block.horizon": [4, 30]}, estimator=model)
        found = hi.fit(select, record)
        assert found.values["selected block.horizon"] == 4.0
        with pytest.raises(ConfigError, match=r"all 2 candidates fail.*block\.horizon 60"):
            hi.fit(hi.Select(by="aic", over={"block.horizon": [60, 70]}, estimator=model), record)

    def test_where_all_fail_it_says_why(self):
        estimator = {**KERNEL, "kernel": "window_unit", "empty": "fail"}
        select = hi.Select(by="cross_validation", over={"bandwidth.h0": [1e-6, 1e-7]}, estimator=estimator)
        with pytest.raises(EstimationError, match=r"^all 2 candidates fail, among others: 40 of 200 points"):
            hi.fit(select, record_of())
        select = hi.Select(by="aic", over={"lags": [1, 2]}, estimator=TWO_STAGE)
        with pytest.raises(EstimationError, match=r"^all 2 candidates fail: the output is 1 throughout"):
            select.fit(Record(np.random.default_rng(0).normal(size=50), np.ones(50)))

    def test_samples_that_one_candidate_says_nothing_of_count_for_none(self):
        record = record_of(60, a=[0.5], b=[1])
        estimator = {**KERNEL, "bandwidth": {"h0": 0.3, "alpha": 0}, "prefilter": {"kind": "least_squares"}}
        select = hi.Select(by="leave_one_out", over={"prefilter.order": [1, 7]}, estimator=estimator)
        assert isinstance(select.candidates[0].fit(record).values["a_1"], float)
        both = selected(hi.fit(select, record)).criterion[0]
        one = hi.Kernel(
            kernel="gaussian",
            bandwidth={"h0": 0.3, "alpha": 0},
            prefilter={"kind": "least_squares", "order": 1},
        )
        errors = one.left_out_errors(one.fit(record), record)
        assert np.isnan(errors[0])
        assert both == np.mean(errors[7:] ** 2)


class TestPassesThrough:
    def test_what_all_candidates_hold(self):
        select = hi.Select(by="bic", over={"lags": [1, 3]}, estimator=TWO_STAGE)
        values = {name.removeprefix("value ") for name in select.provides() if name.startswith("value ")}
        assert {"b_0", "a_1", "a_3", "selected lags"} <= values
        assert "b_1" not in values
        assert {"nonlinearity", "linear", "response"} <= select.provides()
        assert set(select.names()) == values

    def test_the_record_that_the_shortest_candidate_needs_is_left_to_fit(self):
        for by, settings in (("cross_validation", {"folds": 3}), ("holdout", {"share": 0.4}), ("aic", {})):
            select = hi.Select(by=by, over={"lags": [1, 4]}, estimator=TWO_STAGE, **settings)
            n, least = select.fewest_samples(), min(one.fewest_samples() for one in select.candidates)
            assert n >= least
            record = record_of(n)
            fitted = [] if by == "aic" else select._folds(record)
            assert all(len(fold.training) >= least for fold in fitted)

    def test_experiments_at_several_intervals_are_taken_by_who_takes_them(self):
        plain = hi.Select(by="leave_one_out", over={"bandwidth.h0": WIDTHS}, estimator=KERNEL)
        assert plain.takes_experiments() == "any"
        over = {"prefilter": [{"kind": "least_squares", "order": 1}]}
        estimator = {**KERNEL, "bandwidth": {"h0": 1, "alpha": 0}}
        assert (
            hi.Select(by="leave_one_out", over=over, estimator=estimator).takes_experiments()
            == "at_one_interval"
        )

    def test_rules_for_the_factor(self):
        one = hi.Select(by="bic", over={"lags": [1, 3]}, estimator=TWO_STAGE)
        assert [rule.rule for rule in needed(one.normalisations())] == ["|b| = 1, b_0 > 0"]
        base = {"kind": "two_stage", "lags": 2, "degree": 2}
        both = hi.Select(by="bic", over={"delay": [0, 1]}, estimator=base)
        assert [rule.rule for rule in needed(both.normalisations())] == [
            "|b| = 1, b_0 > 0",
            "|b| = 1, b_1 > 0",
        ]

    def test_needs_of_the_truth_and_draws(self):
        base = {"kind": "bilinear_least_squares", "lags": 2, "degree": 2}
        select = hi.Select(by="bic", over={"start": ["two_stage", "truth", "random"]}, estimator=base)
        assert select.needs_of_truth() == {"nonlinearity", "linear"}
        assert select.draws()
        assert not hi.Select(by="bic", over={"lags": [1]}, estimator=TWO_STAGE).draws()

    def test_selections_within_a_selection(self):
        inner = {
            "kind": "select",
            "by": "leave_one_out",
            "over": {"bandwidth.h0": WIDTHS},
            "estimator": KERNEL,
        }
        over = {"estimator.kernel": ["gaussian", "triangular"]}
        found = hi.fit(hi.Select(by="cross_validation", over=over, estimator=inner), record_of())
        assert set(found.values) == {"selected bandwidth.h0", "selected estimator.kernel"}

    @pytest.mark.parametrize("by", ["cross_validation", "holdout"])
    def test_a_selection_within_a_selection_within_a_selection(self, by):
        inner = {
            "kind": "select",
            "by": "bic",
            "over": {"degree": ["1..4"]},
            "estimator": {"kind": "two_stage"},
        }
        middle = {"kind": "select", "by": "holdout", "over": {"estimator.delay": [0, 1]}, "estimator": inner}
        record = record_of()
        over = {"estimator.estimator.lags": ["1..3"]}
        found = hi.fit(hi.Select(by=by, over=over, estimator=middle), record)
        assert found.values["selected estimator.estimator.lags"] == 3.0
        assert found.values["selected estimator.delay"] == 0.0
        assert found.values["selected degree"] == 3.0
        assert selected(found).within.within.estimator == hi.TwoStage(degree=3, delay=0, lags=3)
        # Each selection is judged by the error of the estimate that it took.
        plain = hi.Select(by=by, over={"lags": ["1..3"]}, estimator=TWO_STAGE)
        np.testing.assert_allclose(
            selected(found).criterion[2], selected(hi.fit(plain, record)).criterion[2], rtol=1e-12
        )

    @pytest.mark.parametrize("nested", [False, True])
    def test_a_mapping_that_the_estimator_leaves_at_its_default(self, nested):
        blocks = [
            {"kind": "polynomial", "degree": 1},
            {"kind": "linear", "nb": 1, "nf": 0},
        ]
        estimator: dict[str, Any] = {"kind": "prediction_error", "blocks": blocks}
        path = "noise.ar"
        if nested:
            over = {"n_init": [0, 1]}
            estimator, path = (
                {"kind": "select", "by": "holdout", "over": over, "estimator": estimator},
                f"estimator.{path}",
            )
        select = hi.Select(by="holdout", over={path: [0, 2]}, estimator=estimator)
        inner: Any = [getattr(one, "estimator", one) for one in select.candidates]
        assert [(one.noise.ar, one.noise.ma) for one in inner] == [(0, 0), (2, 0)]
        select = hi.Select(
            by="holdout",
            over={"terms.q0": [4], "terms.alpha": [0]},
            estimator={"kind": "orthogonal", **BASIS},
        )
        (candidate,) = select.candidates
        assert isinstance(candidate, hi.Orthogonal)
        assert (candidate.terms.q0, candidate.terms.alpha) == (4, 0)

    def test_what_a_selection_fits_behind_a_block_begins_in_motion(self):
        record = record_of(b=(1,), a=(0.97,))
        estimator = {"kind": "prediction_error", "blocks": [{"kind": "linear", "nb": 1, "nf": 1}]}
        inner = {"kind": "select", "by": "fpe", "over": {"noise.ma": [0]}, "estimator": estimator}
        plain, nested = (
            selected(hi.fit(hi.Select(by="cross_validation", over={path: [0]}, estimator=of), record))
            for path, of in (("noise.ar", estimator), ("estimator.noise.ar", inner))
        )
        assert nested.criterion == pytest.approx(plain.criterion, rel=1e-9)

    def test_two_selections_that_choose_by_one_name_are_refused(self):
        inner = {"kind": "select", "over": {"lags": [1, 2]}, "estimator": TWO_STAGE}
        middle = {"kind": "select", "over": {"by": ["aic", "bic"]}, "estimator": inner}
        with pytest.raises(
            ConfigError,
            match="'over' chooses 'by', and so does a selection inside: both would be called 'selected by'",
        ):
            hi.Select(by="holdout", over={"by": ["cross_validation", "holdout"]}, estimator=middle)

    def test_its_canonical_form_and_pickle_make_the_same_candidates(self):
        over = {"bandwidth.h0": ["1/5", 1], "kernel": ["gaussian", "triangular"]}
        select = hi.Select(
            by="leave_one_out", over=over, estimator={"kind": "kernel", "bandwidth": {"alpha": 0}}
        )
        assert len(select.candidates) == 4
        for other in (pickle.loads(pickle.dumps(select)), Of("estimator").validate(canonical(select))):
            assert other == select
            assert other.candidates == select.candidates
        assert canonical(select)["over"]["bandwidth.h0"] == [0.2, 1.0]

    def test_the_code_of_every_candidate_counts(self):
        over = {"prefilter": [{"kind": "least_squares", "order": 1}, {"kind": "known_dynamics", "a": [0.5]}]}
        estimator = {**KERNEL, "bandwidth": {"h0": 1, "alpha": 0}}
        found = modules([hi.Select(by="leave_one_out", over=over, estimator=estimator)])
        assert "hident.estimators.nonparametric.known_dynamics" in found
        assert "hident.estimators.nonparametric.least_squares" in found

    def test_components_in_python(self):
        kernel = hi.Kernel(kernel="gaussian", bandwidth={"h0": 9, "alpha": 0})
        one = hi.Select(by="leave_one_out", over={"bandwidth.h0": np.array(WIDTHS)}, estimator=kernel)
        assert one == hi.Select(by="leave_one_out", over={"bandwidth.h0": WIDTHS}, estimator=KERNEL)


def with_validation(samples=300, std=0.1):
    fitted, other = (record_of(samples, std=std, seed=seed) for seed in (1, 2))
    return replace(fitted, validation=other)


CHAIN = {
    "kind": "prediction_error",
    "blocks": [{"kind": "polynomial", "degree": 2}, {"kind": "linear", "nb": 3}],
}
ORDERS = {"blocks.0.degree": ["1..6"], "blocks.1.nb": [2, 3, 4]}


class TestOfAChain:
    def test_orders_and_kinds_of_blocks_are_chosen_by_the_validation_part(self):
        record = with_validation()
        kinds = [{"kind": "polynomial", "degree": 3}, {"kind": "piecewise_linear", "knots": 3}]
        chosen = hi.Select(by="validation", over={"blocks.0": kinds, "blocks.1.nb": [1, 3]}, estimator=CHAIN)
        found = selected(hi.fit(chosen, record))
        assert found.estimator.blocks[0].degree == 3
        assert found.estimator.blocks[1].nb == 3
        errors = found.estimator.errors(found.estimator.fit(record), record.validation)
        assert found.criterion[found.chosen] == pytest.approx(np.nanmean(errors**2))
        assert [found.word("blocks.0", i) for i in (0, 1)] == [
            "polynomial degree 3",
            "piecewise_linear knots 3",
        ]

    def test_the_simplest_is_taken_that_cannot_be_told_from_the_best(self):
        record = with_validation()
        best, simplest = (
            selected(hi.fit(hi.Select(by="validation", take=take, over=ORDERS, estimator=CHAIN), record))
            for take in ("best", "simplest")
        )
        assert best.near is not None
        near = np.flatnonzero(best.near)
        assert best.chosen in near
        assert simplest.chosen in near
        assert simplest.parameters[simplest.chosen] == min(best.parameters[i] for i in near) == 6
        assert best.criterion[best.chosen] == min(best.criterion)

    def test_criteria_of_the_fits_stand_beside_the_validation_error(self):
        record = with_validation()
        by = [
            selected(hi.fit(hi.Select(by=by, over=ORDERS, estimator=CHAIN), record))
            for by in ("validation", "aic", "bic")
        ]
        assert np.array_equal(by[0].aic, by[1].criterion)
        assert np.array_equal(by[0].bic, by[2].criterion)
        assert np.array_equal(by[1].bic, by[2].criterion)
        assert by[1].near is None

    def test_of_a_piecewise_linear_function_all_values_are_parameters(self):
        spec = hi.PredictionError(blocks=[hi.PiecewiseLinearBlock(knots=6), hi.LinearBlock(nb=2, nf=1, nk=1)])
        assert spec.free_parameters() == 6 + 3 - 1

    def test_a_record_without_a_validation_part_is_refused(self):
        chosen = hi.Select(by="validation", over=ORDERS, estimator=CHAIN)
        with pytest.raises(EstimationError, match="'by: validation' is on the record's validation part, and"):
            chosen.check_record(record_of())
        with pytest.raises(EstimationError, match="this record has none"):
            chosen.fit(record_of())

    @pytest.mark.parametrize(
        ("settings", "message"),
        [
            (
                {"by": "bic", "take": "simplest"},
                "'bic' has a penalty for parameters already: leave 'take' out",
            ),
            (
                {
                    "by": "leave_one_out",
                    "take": "simplest",
                    "over": {"bandwidth.h0": WIDTHS},
                    "estimator": KERNEL,
                },
                "needs the number of free parameters to take the simplest, which 'kernel' does not say",
            ),
        ],
    )
    def test_what_cannot_be_taken_is_refused(self, settings, message):
        with pytest.raises(ConfigError, match=message):
            hi.Select(**{"over": ORDERS, "estimator": CHAIN, **settings})


TRIED = """\
version: 1
title: Tried
record: {file: tank.csv, input: u, output: y, estimation: 1..300, validation: 301..600}
trials: 1
estimators:
  chosen:
    kind: select
    by: validation
    take: simplest
    over:
      blocks.0: [{kind: polynomial, degree: 1}, {kind: polynomial, degree: 3}]
      blocks.1.nb: [3, 4, 5]
    estimator: {kind: prediction_error, blocks: [{kind: polynomial, degree: 1}, {kind: linear, nb: 1}]}
metrics:
  fit: {kind: fit_index, on: validation}
tables:
  tried: {kind: candidates, title: What was tried, estimator: chosen}
"""


TOO_LONG = """\
version: 1
title: Lags that a short record does not hold
trials: 2
samples: 100
cases: {N: {30: {samples: 30}, 100: {}}}
system: {kind: hammerstein, nonlinearity: identity, linear: {kind: fir, b: [1, 0.6]}}
excitation: {kind: iid, distribution: uniform, low: -2, high: 2}
noise: {kind: white, std: 0.1}
estimators:
  lags: {kind: select, by: bic, over: {lags: [2, 20, 200]}, estimator: {kind: two_stage, degree: 1, delay: 0}}
metrics:
  n: {kind: value, of: [selected lags]}
"""


def test_table_md_says_which_candidates_the_records_do_not_suit(tmp_path):
    plan = planned(tmp_path, TOO_LONG)
    assert [line for line in scoring(plan) if "leaves out" in line] == [
        "Estimator lags leaves out what its records do not suit: lags 20 (needs at least 40 samples), lags "
        "200 (needs at least 400 samples) at N 30; lags 200 (needs at least 400 samples) at N 100."
    ]
    assert [one.value("mean") for one in run(plan).series] == [2.0, 2.0]
    assert refusals(tmp_path, TOO_LONG, "cases={N: {10: {samples: 3}}}") == [
        "a.yaml:10: estimators.lags: needs at least 4 samples, but samples is 3"
    ]


def test_the_table_of_all_tried_marks_the_simplest(tmp_path):
    record = record_of(600)
    rows = "\n".join(f"{a!r},{b!r}" for a, b in zip(record.u.tolist(), record.y.tolist(), strict=True))
    (tmp_path / "tank.csv").write_text(f"u,y\n{rows}\n")
    results = run(planned(tmp_path, TRIED))
    table = results.plan.experiment.tables["tried"].build(results, [])  # type: ignore[attr-defined]
    assert table.header == ("blocks.0", "blocks.1.nb", "parameters", "RMSE, validation", "AIC", "BIC", "")
    marks = {row[:2]: row[-1] for row in table.rows}
    assert marks["polynomial degree 3", "3"] == "chosen"
    assert marks["polynomial degree 3", "5"] == "within one standard error"
    assert marks["polynomial degree 1", "3"] == ""
    assert [float(row[3]) for row in table.rows] == sorted(float(row[3]) for row in table.rows)
    other = TRIED.replace("estimator: chosen}", "estimator: plain}").replace(
        "estimators:\n", "estimators:\n  plain: {kind: two_stage, lags: 3, degree: 3}\n"
    )
    with pytest.raises(ConfigError, match="the estimator 'plain' selects nothing: it is not of kind select"):
        check(planned(tmp_path, other))


CONFIG = """\
version: 1
title: Selected
trials: 3
samples: 100
system: {kind: hammerstein, nonlinearity: abs, linear: {kind: fir, b: [1, 0.5]}}
excitation: {kind: iid, distribution: uniform, low: -1, high: 1}
noise: {kind: white, std: 0.1}
estimators:
  k:
    kind: select
    by: leave_one_out
    over: {bandwidth.h0: [0.1, 1]}
    estimator: {kind: kernel, kernel: gaussian, bandwidth: {alpha: 1/5}}
metrics:
  ise: {kind: mise, interval: [-1, 1]}
  h: {kind: value, of: [selected bandwidth.h0]}
tables:
  chosen: {kind: choices, title: Chosen, of: [h selected bandwidth.h0], estimators: [k]}
figures:
  search: {kind: search, panels: [{show: selection, estimator: k, label: Selected}]}
"""
BANDWIDTH = "over: {bandwidth.h0: [0.1, 1]}"
LAGS = {"kind: kernel, kernel: gaussian, bandwidth: {alpha: 1/5}": "kind: two_stage, degree: 2"}


class TestConfiguration:
    def test_tables_show_what_was_chosen(self, tmp_path):
        results = run(planned(tmp_path, CONFIG))
        table = results.plan.experiment.tables["chosen"].build(results, [])  # type: ignore[attr-defined]
        assert table.rows[0][-1] == "100"
        assert table.header[-1] in ("0.1", "1")

    def test_the_figure_of_one_trial_shows_the_criterion(self, tmp_path):
        results = run(planned(tmp_path, CONFIG))
        figure = results.plan.experiment.figures["search"].draw(results, [])  # type: ignore[attr-defined]
        (axes,) = (axes for axes in figure.axes if axes.lines)
        assert axes.get_title().startswith("Selected\nchosen: bandwidth.h0 ")
        assert axes.get_ylabel() == "mean squared prediction error\n(leave-one-out)"
        assert axes.lines[0].get_xdata().tolist() == [0.1, 1.0]

    SEVERAL = CONFIG.replace(
        "samples: 100\n", "cases: {samples: [100, 50], noise.std: [0.1, 0.2]}\n"
    ).replace("figures:\n", "  tried: {kind: candidates, title: Tried, estimator: k, trial: 1}\nfigures:\n")

    @pytest.mark.parametrize(
        ("at", "said"),
        [
            ("", "; of several cases the first: samples 100, noise.std 0.1"),
            ("at: {samples: 50}", "; of several cases the first: noise.std 0.1"),
            ("at: {noise.std: 0.2, samples: 50}", ""),
        ],
    )
    def test_what_is_of_one_trial_says_of_which_and_of_which_case(self, tmp_path, at, said):
        text = self.SEVERAL.replace("trial: 1", f"trial: 1, {at}" if at else "trial: 1")
        results = run(
            planned(tmp_path, text.replace("label: Sel", f"{at}, label: Sel" if at else "label: Sel"))
        )
        figure, table = (getattr(results.plan.experiment, of) for of in ("figures", "tables"))
        assert figure["search"].says(results) == f"trial 0{said}"
        # There is neither AIC nor BIC of a kernel estimate.
        assert table["tried"].built(results, []).notes == (f"Trial 1{said}.",)

    def test_a_variable_stands_for_a_value(self, tmp_path):
        text = replaced(
            CONFIG,
            {"[0.1, 1]}": "[0.1, $wide]}", "estimators:\n  k": "cases: {wide: [1, 2]}\nestimators:\n  k"},
        )
        plan = planned(tmp_path, text)
        assert [canonical(unit.estimator)["over"]["bandwidth.h0"] for unit in plan.units] == [
            [0.1, 1.0],
            [0.1, 2.0],
        ]

    @pytest.mark.parametrize(
        ("words", "message"),
        [
            (
                {"h0: [0.1, 1]": "h0: [0.1, -1]"},
                "a.yaml:12: estimators.k.over.bandwidth.h0[1]: must be greater than 0 (got -1)",
            ),
            (
                {"bandwidth.h0: [0.1, 1]": "bandwidth.h: [0.1, 1], bandwidth.h0: [1]"},
                "a.yaml:12: estimators.k.over.bandwidth.h: unknown key; did you mean 'h0'?",
            ),
            (
                {BANDWIDTH: "over: {bandwith.h0: [0.1, 1]}"},
                "a.yaml:12: estimators.k.over.bandwith.h0: estimator has no key 'bandwith'; did you mean "
                "'bandwidth'? (it has: kind, kernel, bandwidth) (got [0.1, 1])",
            ),
            (
                {BANDWIDTH: "over: {known_point.x: [0.1, 1]}"},
                "a.yaml:12: estimators.k.over.known_point.x: the estimator leaves 'known_point' out: write "
                "it there (got [0.1, 1])",
            ),
            (
                {BANDWIDTH: "over: {bandwidth.h0: [1], kernel: [gaussian, gausian]}"},
                "a.yaml:12: estimators.k.over.kernel[1]: must be 'window_half', 'window_unit', 'triangular', "
                "'epanechnikov' or 'gaussian'; did you mean 'gaussian'? (got 'gausian')",
            ),
            (
                {BANDWIDTH: "over: {bandwidth.h0: []}"},
                "a.yaml:12: estimators.k.over.bandwidth.h0: must hold at least one value (got [])",
            ),
            (
                {BANDWIDTH: "over: {}"},
                "a.yaml:12: estimators.k.over: must name at least one key path in the estimator, such as "
                "bandwidth.h0",
            ),
            (
                {BANDWIDTH: "over: {kernel: [triangular]}"},
                "a.yaml:13: estimators.k.estimator.bandwidth.h0: is required: Factor",
            ),
            (
                {BANDWIDTH: "over: {bandwidth: [plug_in], bandwidth.h0: [1]}"},
                "a.yaml:12: estimators.k.over.bandwidth: cannot be chosen as a whole and in part",
            ),
            (
                {BANDWIDTH: "over: {bandwidth.h0: [1], kind: [kernel, orthogonal]}"},
                "a.yaml:12: estimators.k.over.kind: cannot choose a kind by itself: list whole mappings with "
                "'kind:' under the key above it (got ['kernel', 'orthogonal'])",
            ),
            (
                {BANDWIDTH: "over: {bandwidth.h0: [1..1001]}", "alpha: 1/5": "alpha: 0"},
                "a.yaml:12: estimators.k.over: makes 1001 candidates, and at most 1000 are tried",
            ),
            (
                {BANDWIDTH: "over: {bandwidth.h0: [1..1000000000], kernel: [gaussian, triangular]}"},
                "a.yaml:12: estimators.k.over: makes 2000000000 candidates, and at most 1000 are tried",
            ),
            (
                {"kernel, kernel: gaussian": "kernl, kernel: gaussian"},
                "a.yaml:13: estimators.k.estimator.kind: unknown estimator; did you mean 'kernel'?",
            ),
            (
                {"kernel, kernel: gaussian": "[kernel], kernel: gaussian"},
                "a.yaml:13: estimators.k.estimator.kind: unknown estimator",
            ),
            (
                {"by: leave_one_out": "by: bic"},
                "a.yaml:9: estimators.k: 'bic' needs the number of free parameters, which 'kernel' does not "
                "say: take cross_validation",
            ),
            (
                {"by: leave_one_out": "by: leave_one_out\n    folds: 3"},
                "a.yaml:9: estimators.k: 'folds' is of cross_validation: leave it out, or set 'by'",
            ),
            (
                {**LAGS, BANDWIDTH: "over: {lags: [1, 2]}"},
                "a.yaml:9: estimators.k: 'leave_one_out' needs each sample's estimate without it, which "
                "'two_stage' does not give: take cross_validation",
            ),
            (
                {**LAGS, BANDWIDTH: "over: {lags: [3..1]}"},
                "a.yaml:12: estimators.k.over.lags[0]: must be a whole number >= 1 (got '3..1')",
            ),
            (
                {"[selected bandwidth.h0]": "[selected bandwith.h0]"},
                "a.yaml:16: metrics.h: the metric 'value' needs the value selected bandwith.h0 of the",
            ),
        ],
    )
    def test_what_is_wrong_is_said_where_it_stands(self, tmp_path, words, message):
        text = CONFIG.partition("tables:")[0]
        found = [line for line in refusals(tmp_path, replaced(text, words)) if line.startswith(message)]
        assert len(found) == 1, refusals(tmp_path, replaced(text, words))

    def test_a_measured_record(self, tmp_path):
        record = record_of(120)
        np.savetxt(
            tmp_path / "r.csv",
            np.column_stack([record.u, record.y]),
            delimiter=",",
            header="u,y",
            comments="",
        )
        text = """\
version: 1
title: Measured
record: {file: r.csv, input: u, output: y, dt: 1}
trials: 1
estimators:
  s:
    kind: select
    by: cross_validation
    over: {lags: [1..4]}
    estimator: {kind: two_stage, degree: 3, delay: 0}
metrics:
  lags: {kind: value, of: [selected lags, b_0]}
"""
        (tmp_path / "a.yaml").write_text(text, encoding="utf-8")
        results = run(load(tmp_path / "a.yaml", (), {}))
        (lags, _) = results.select("s")
        assert lags.values.tolist() == [3.0]


@component("estimator", "of_one_experiment")
class OfOneExperiment(hi.TwoStage):
    """An estimator that does not say that it keeps experiments apart."""

    def takes_experiments(self):
        return "one"


def test_what_cannot_be_chosen_from_is_refused_from_python():
    with pytest.raises(ConfigError, match=r"^Select: over.lags: must be a list of values \(got 3\)$"):
        hi.Select(by="bic", over={"lags": 3}, estimator=TWO_STAGE)
    one = OfOneExperiment(lags=1, degree=3, delay=0)
    with pytest.raises(ConfigError, match="'cross_validation' makes several experiments of one, which"):
        hi.Select(by="cross_validation", over={"lags": [1]}, estimator=one)
    found = hi.fit(hi.Select(by="holdout", over={"lags": [1, 3]}, estimator=one), record_of())
    assert found.values["selected lags"] == 3.0


def test_a_figure_has_a_line_for_each_choice_of_the_other_settings():
    over = {"bandwidth.h0": WIDTHS, "kernel": ["gaussian", "triangular"]}
    found = selected(
        hi.fit(
            hi.Select(by="leave_one_out", over=over, estimator={"kind": "kernel", "bandwidth": {"alpha": 0}}),
            record_of(),
        )
    )
    _, axes = subplots(figsize=(4.0, 3.0))
    said = draw_selection(axes, found)
    assert abscissa_of(found) == "bandwidth.h0"
    assert [line.get_label() for line in axes.lines] == ["kernel gaussian", "kernel triangular", "chosen"]
    np.testing.assert_array_equal(
        [line.get_ydata() for line in axes.lines[:2]], found.criterion.reshape(4, 2).T
    )
    best = found.estimator
    assert said == f"chosen: bandwidth.h0 {best.bandwidth.h0:g}, kernel {best.kernel}"
