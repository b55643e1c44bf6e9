"""Figures and tables of identified systems: what they show, read back from the axes and rows."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgba

from hident import plugins
from hident.arrays import Array
from hident.config import spec
from hident.config.spec import Flag, Real, component
from hident.engine.experiment import load
from hident.engine.results import Results, Series
from hident.errors import ConfigError, EstimationError, SimulationError
from hident.estimators.base import CONTINUOUS, EstimatorSpec
from hident.estimators.convergence import History
from hident.estimators.moving_horizon.searches import PartitionSearch, StructureSearch
from hident.ledger.verdicts import judge
from hident.linear_blocks import ContinuousTransferFunction, TransferFunction
from hident.records import Estimate, Record, Truth
from hident.reports.one_trial.convergence import iterates
from hident.reports.one_trial.searches import contour_levels
from hident.reports.one_trial.static_fits import StaticCurve
from hident.reports.output import check
from hident.reports.style import style
from hident.reports.tables.distributions import percentile
from hident.systems.base import SystemSpec

STEADY_INPUT, STEADY_OUTPUT = 15.6, 7.0
LINEAR = ContinuousTransferFunction((1.0,), (2.0,))


class Saturating(SystemSpec):
    """A saturation before a lag."""

    sharpness: Real = 1.0
    """Slope of the saturation."""
    breaks: Flag = False
    """Whether the simulation fails."""

    def simulate(self, u, dt=1.0):
        if self.breaks:
            raise SimulationError("the solver broke down")
        return LINEAR.respond(np.tanh(self.sharpness * u), dt)

    def truth(self):
        return Truth(
            nonlinearity=lambda u: np.tanh(self.sharpness * u),
            continuous=LINEAR,
            response=self.simulate,
            values={"a_1": 2.0, "b_0": 1.0, "steady_input": STEADY_INPUT, "steady_output": STEADY_OUTPUT},
        )


class Varying(Saturating):
    """A saturation before a lag that settles the later the larger the operating point."""

    def settling_time(self, flow: float) -> float:
        return np.inf if flow == 20.0 else 0.1 * flow


def partition_search():
    lower, upper = np.linspace(-2.0, -0.2, 10), np.linspace(0.2, 2.0, 12)
    loss = 1.0 + (lower[:, None] + 0.6) ** 2 + 2.0 * (upper - 0.5) ** 2
    loss[-1, -3:] = np.nan
    return PartitionSearch(lower, upper, loss, (-0.55, 0.52), 0.99)


def structure_search():
    n, m, delay = (a.ravel() for a in np.meshgrid(np.arange(1, 6), np.arange(4), [1.0, 2.0], indexing="ij"))
    proper = m < n
    n, m, delay = n[proper], m[proper], delay[proper]
    error = 0.1 + np.where(n < 3, 0.5 / n, 0.0) + np.where(m < 1, 0.2, 0.0) + 0.05 * (delay == 1.0) + 1e-3 / n
    chosen = int(np.flatnonzero((n == 3) & (m == 1) & (delay == 2.0))[0])
    return StructureSearch(n, m, delay.astype(float), error, chosen)


class Stated(EstimatorSpec):
    """An estimator that says what it is told."""

    gain: Real = 1.0
    """Gain of its static part."""
    fails: Flag = False
    """Whether it fails."""
    plain: Flag = False
    """Whether it keeps no details and gives no response."""
    oscillates: Flag = False
    """Whether its iteration does not converge."""

    def provides(self):
        if self.plain:
            return frozenset({"value a_1", "value b_0"})
        names = ("a_1", "b_0", "u_-1", "u_1", "y_-1", "y_1")
        return frozenset({"response", "nonlinearity", "continuous", *(f"value {name}" for name in names)})

    def letters(self):
        return CONTINUOUS

    def fit(self, record, rng=None):
        if self.fails:
            raise EstimationError("the matrix is singular")
        if self.plain:
            return Estimate(values={"a_1": 2.0, "b_0": 1.0})
        values = {"a_1": 2.0, "b_0": 1.0, "u_-1": -0.55, "u_1": 0.52, "y_-1": -0.5, "y_1": 0.4}
        x = self.gain * np.tanh(record.u)
        steps = np.arange(9.0)
        wave: Array = np.power(-1.0 if self.oscillates else 0.3, steps)
        return Estimate(
            nonlinearity=lambda u: self.gain * np.tanh(u),
            continuous=LINEAR,
            response=lambda u, dt: LINEAR.respond(self.gain * np.tanh(u), dt),
            values=values,
            details={
                "history": History(2.0 + wave[:, None], 1.0 + 0.1 * wave[:, None], {}, not self.oscillates),
                "partition": partition_search(),
                "structure": structure_search(),
                "internal_variable": np.stack((record.u, x)),
                "smoothed": np.stack((np.linspace(-2, 2, 9), np.tanh(np.linspace(-2, 2, 9)))),
            },
        )


CONFIG = """\
version: 1
title: t
paper: p
trials: 5
samples: 200
dt: 0.1
system: {kind: saturating}
excitation: {kind: iid, distribution: uniform, low: -2, high: 2}
cases:
  system.sharpness: [1, 2, 4]
  sigma:
    0.5: {noise: {kind: white, std: 0.5}}
    1: {noise: {kind: white, std: 1}}
    2: {noise: {kind: white, std: 2}}
estimators:
  one: {kind: stated, gain: 1.1}
  two: {kind: stated, gain: 0.8, oscillates: true}
  failing: {kind: stated, fails: true}
  plain: {kind: stated, plain: true}
metrics:
  theta: {kind: value, of: [a_1, b_0], estimators: [one, two, failing]}
  error: {kind: percent_error, of: [a_1, b_0]}
published:
  paper_trials: unknown
  cells:
    - table: T
      row: r
      quantity: a1
      estimator: one
      metric: theta a_1
      statistic: median
      at: {system.sharpness: 1, sigma: 1}
tables:
  plain: {kind: parameters, title: P, metric: theta, of: [a_1], estimators: [one]}
  limit:
    kind: limit
    title: L
    x: system.sharpness
    along: sigma
    metric: error
    below: 5
    estimators: [one, two]
"""
SEARCH = """\
panels:
  - {show: structure, estimator: one, label: "(a) structure"}
  - {show: partition, estimator: one, label: "(b) points", x_label: "$u_{-1}$", y_label: "$u_1$"}
  - {show: structure, estimator: failing}
"""
STATIC = """\
x_label: input, mL/s
y_label: pH
panels:
  - title: (a) fits
    curves:
      - {estimator: one, at: {system.sharpness: 1}}
      - {estimator: two, label: other}
      - {estimator: failing}
    interval: [13.6, 17.6]
    x_offset: steady_input
    y_offset: 7
    partition: input
  - title: (b) points
    curves: [{estimator: one, show: [points, smoothed]}]
    x_label: internal variable
    y_label: output
    interval: [-2, 2]
    y_limits: [-2, 2]
    partition: output
"""
CONVERGENCE = """\
curves: [{estimator: one}, {estimator: two}]
of: [a_1]
metrics: [error]
y_labels: {error: "percent error of linear parameters, %"}
"""
VALIDATION = """\
excitation: {kind: staircase, levels: [0, 1, -1, 0.5], hold: 10}
samples: 400
x_offset: steady_input
t_label: time, s
u_label: input, mL/s
y_label: pH
u_title: (a) the input
panels:
  - {curves: [{estimator: one}, {estimator: two}], y_offset: steady_output}
"""
SETTLING = """\
curves: [{estimator: one}, {estimator: two}]
interval: [0, 40]
x_label: F, L/h
y_label: settling time, h
"""
SCATTER = "panels: [{x: {estimator: one, metric: %s}, y: {estimator: one, metric: %s}}]"
LIMIT = """\
table: limit
x_label: D
y_label: largest standard deviation of the input
log_x: true
interval: [-2, 2]
"""
DISTRIBUTION = """\
title: D
columns: {a1: a_1, b0: b_0, error: loss}
rows:
  - {label: stage 1, estimator: one, at: {sigma: 1}, metric: theta, metrics: {error: error}}
  - {label: stage 2, estimator: two, metric: theta, without: [error]}
"""


@pytest.fixture(autouse=True)
def _registered(monkeypatch):
    """The components of this file are forgotten after each test."""
    plugins.load()
    register = {family: dict(known) for family, known in spec._REGISTER.items()}
    monkeypatch.setattr(spec, "_REGISTER", register)
    component("system", "saturating")(Saturating)
    component("system", "varying")(Varying)
    component("estimator", "stated")(Stated)


@pytest.fixture
def make(tmp_path: Path):
    """Results of a configuration with one table or figure ``f``, with the given trials, else ones."""
    paper = tmp_path / "experiments" / "p"
    paper.mkdir(parents=True)
    (paper / "published.csv").write_text("table,row,quantity,printed,note\nT,r,a1,2.2,\n")

    def results(kind="", fields="", *, values=None, family="figures", system="saturating"):
        text = CONFIG.replace("{kind: saturating}", f"{{kind: {system}}}")
        if kind:
            lines = "".join(f"    {line}\n" for line in fields.splitlines())
            head = "" if family == "tables" else f"{family}:\n"
            text += f"{head}  f:\n    kind: {kind}\n{lines}"
        path = tmp_path / "c.yaml"
        path.write_text(text)
        plan = load(path)
        series = []
        for unit in plan.units:
            at = (unit.name, str(unit.labels["system.sharpness"]), str(unit.labels["sigma"]))
            for label in unit.metric_labels:
                found = (values or {}).get((label, *at), np.ones(5))
                series.append(Series(unit, label, np.asarray(found, dtype=float)))
        return Results(plan, tuple(series))

    return results


@pytest.fixture
def draw(make):
    """Draw a figure and close it afterwards."""
    import matplotlib.pyplot as plt

    def drawn(*arguments, **options):
        results = make(*arguments, **options)
        check(results.plan)
        return results.plan.experiment.figures["f"].draw(results, judge(results))

    with style():
        yield drawn
        plt.close("all")


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        ("search", SEARCH),
        ("static_fit", STATIC),
        ("convergence", CONVERGENCE),
        ("validation", VALIDATION),
        ("settling_map", SETTLING),
        ("limit", LIMIT),
    ],
)
def test_a_figure_is_the_same_file_each_time(draw, tmp_path, kind, fields):
    files = []
    for name in ("first.png", "second.png"):
        draw(kind, fields, system="varying").savefig(tmp_path / name, dpi=40, metadata={"Software": None})
        files.append((tmp_path / name).read_bytes())
    assert files[0] == files[1]


def lines_of(axes):
    return {line.get_label(): line for line in axes.lines}


class TestSearch:
    def test_a_structure_panel_shows_the_best_delay_of_every_candidate(self, draw):
        axes = draw("search", SEARCH).axes[0]
        lines = lines_of(axes)
        assert list(lines) == ["m = 0", "m = 1", "m = 2", "m = 3", "chosen"]
        search = structure_search()
        for m in range(4):
            at = (search.m == m) & (search.delay == 2.0)
            shown = lines[f"m = {m}"].get_ydata()
            assert shown[search.n[at] - 1] == pytest.approx(search.error[at])
            assert np.isnan(shown[:m]).all()
        assert axes.get_yscale() == "log"

    def test_a_ring_stands_around_the_chosen_structure_and_its_words_clear_of_the_curves(self, draw):
        axes = draw("search", SEARCH).axes[0]
        assert axes.get_title() == "(a) structure\nchosen: n = 3, m = 1, d = 2"
        assert not axes.texts
        assert lines_of(axes)["chosen"].get_xydata().ravel() == pytest.approx((3.0, 0.1 + 1e-3 / 3))

    def test_a_hopeless_candidate_does_not_flatten_the_others(self, draw, monkeypatch):
        search = structure_search()
        search.error[0] = 1e9
        monkeypatch.setitem(globals(), "structure_search", lambda: search)
        low, high = draw("search", SEARCH).axes[0].get_ylim()
        assert low < 0.1
        assert high < 100.0

    def test_a_partition_panel_shows_contours_the_best_pair_and_the_rejected_ones(self, draw):
        axes = draw("search", SEARCH).axes[1]
        lines = lines_of(axes)
        assert lines["rejected"].get_xydata() == pytest.approx(
            np.array([[-0.2, 2 - 2 * step] for step in np.array([2, 1, 0]) * 1.8 / 22])
        )
        best = next(line for label, line in lines.items() if label.startswith("best"))
        assert best.get_xydata().ravel() == pytest.approx([-0.55, 0.52])
        assert axes.get_title().endswith("\nbest: (-0.55, 0.52)")
        assert (axes.get_xlabel(), axes.get_ylabel()) == ("$u_{-1}$", "$u_1$")
        filled = axes.collections[0]
        assert filled.levels[0] == 1.0
        # The valley is light, the hills dark, also in grey.
        grey = [np.dot(to_rgba(colour)[:3], (0.299, 0.587, 0.114)) for colour in filled.get_facecolor()]
        assert np.all(np.diff(grey) < 0.0)

    def test_a_failed_estimate_is_said(self, draw):
        axes = draw("search", SEARCH).axes[2]
        assert [text.get_text() for text in axes.texts] == ["failed: the matrix is singular"]
        assert not axes.lines

    def test_few_pairs_are_numbers_on_a_grid_in_a_window_around_them(self, draw, monkeypatch):
        search = partition_search()
        kept = np.zeros(search.loss.shape, dtype=bool)
        kept[-2:, -2:] = True
        search.loss[~kept] = np.nan
        search.loss[kept] = [2.0, 3.0, 2.5, 4.0]
        monkeypatch.setitem(globals(), "partition_search", lambda: search)
        axes = draw("search", SEARCH).axes[1]
        assert [text.get_text() for text in axes.texts] == ["1.00", "1.25", "1.50", "2.00"]
        assert [*axes.get_xticks(minor=True)] == [*search.lower]
        low, high = axes.get_xlim()
        assert search.lower.min() < low < search.lower[-2] < search.lower[-1] < high

    @pytest.mark.parametrize("scale", [1.0, 1e-12, 1e30])
    def test_levels_follow_the_values_whatever_their_scale(self, scale):
        loss = scale * (1.0 + np.linspace(0.0, 3.0, 101) ** 2)
        levels = contour_levels(loss / loss.min())
        assert levels[0] == 1.0
        assert np.all(np.diff(levels) > 0.0)
        assert levels[-1] < 10.0

    def test_a_flat_criterion_has_no_contours(self, draw, monkeypatch):
        search = partition_search()
        search.loss[:] = 2.0
        monkeypatch.setitem(globals(), "partition_search", lambda: search)
        assert contour_levels(np.ones(5)) == pytest.approx([1.0])
        axes = draw("search", SEARCH).axes[1]
        assert not axes.collections
        assert len(axes.lines) == 1


class TestStaticFit:
    def test_truth_and_estimates_stand_at_absolute_values(self, draw):
        axes = draw("static_fit", STATIC).axes[0]
        lines = lines_of(axes)
        x = lines["true"].get_xdata()
        assert x[[0, -1]] == pytest.approx([13.6, 17.6])
        assert lines["true"].get_ydata() == pytest.approx(np.tanh(x - STEADY_INPUT) + 7.0)
        assert lines["one"].get_ydata() == pytest.approx(1.1 * np.tanh(x - STEADY_INPUT) + 7.0)
        assert lines["other"].get_ydata() == pytest.approx(0.8 * np.tanh(x - STEADY_INPUT) + 7.0)
        assert lines["partition points"].get_xdata() == pytest.approx(
            [STEADY_INPUT - 0.55, STEADY_INPUT + 0.52]
        )
        assert [text.get_text() for text in axes.texts] == ["failing failed: the matrix is singular"]

    def test_a_panel_has_the_labels_of_the_figure_or_its_own(self, draw):
        first, second = draw("static_fit", STATIC).axes
        assert (first.get_xlabel(), first.get_ylabel()) == ("input, mL/s", "pH")
        assert (second.get_xlabel(), second.get_ylabel()) == ("internal variable", "output")

    def test_points_and_smoothed_points_are_shown_where_asked_for(self, draw):
        axes = draw("static_fit", STATIC).axes[1]
        lines = lines_of(axes)
        assert list(lines) == ["true", "one, points", "one, smoothed", "partition points"]
        u, y = lines["one, points"].get_data()
        assert y == pytest.approx(1.1 * np.tanh(u))
        assert len(u) == 200
        assert len(lines["one, smoothed"].get_xdata()) == 9
        assert lines["partition points"].get_ydata() == pytest.approx([-0.5, 0.4])
        assert axes.get_ylim() == (-2.0, 2.0)

    @pytest.mark.parametrize(
        ("linear", "expected"), [("before", 1.1 * np.tanh(6.0)), ("after", 3.3 * np.tanh(2.0))]
    )
    @pytest.mark.parametrize("blocks", [("continuous", (3.0,), (2.0,)), ("linear", (0.0, 1.5), (0.5,))])
    def test_a_curve_may_take_the_gain_of_its_linear_block(self, linear, expected, blocks):
        part, b, a = blocks
        block = (ContinuousTransferFunction if part == "continuous" else TransferFunction)(b, a)
        found = replace(Stated(gain=1.1).fit(_record(), None), **{"continuous": None, part: block})
        curve = StaticCurve(estimator="one", linear=linear)
        assert curve.of(found, np.array([2.0])) == pytest.approx([expected])

    def test_the_curve_of_a_linear_model_is_its_static_gain(self):
        found = replace(Stated().fit(_record(), None), nonlinearity=None, continuous=LINEAR.scaled(3.0))
        assert StaticCurve(estimator="one").of(found, np.array([-2.0, 1.5])) == pytest.approx([-6.0, 4.5])

    def test_a_curve_may_end_where_the_trial_does(self, draw):
        shown = STATIC.replace("show: [points, smoothed]", "show: [curve, points]")
        shown = shown.replace("interval: [-2, 2]", "interval: [-9, 9]")
        whole = lines_of(draw("static_fit", shown).axes[1])["one"].get_ydata()
        lines = lines_of(draw("static_fit", shown + "    beyond: false\n").axes[1])
        reached = lines["one, points"].get_xdata()
        x, y = lines["one"].get_data()
        inside = (x >= reached.min()) & (x <= reached.max())
        assert 0 < np.count_nonzero(inside) < len(x)
        np.testing.assert_array_equal(y, np.where(inside, whole, np.nan))

    @pytest.mark.parametrize(("order", "terms"), [(1, [1]), (2, [1, 0]), (3, [1, 0, -1 / 3])])
    def test_the_expansion_of_the_truth_stands_beside_it(self, draw, order, terms):
        lines = lines_of(draw("static_fit", STATIC + f"    expansion: {order}\n").axes[1])
        x, y = lines[f"its expansion of order {order}"].get_data()
        expected = sum(term * x ** (i + 1) for i, term in enumerate(terms))
        # An interpolation, whose own error is smaller still.
        assert y == pytest.approx(expected, abs=1e-4)

    def test_one_legend_names_everything_once(self, draw):
        (legend,) = draw("static_fit", STATIC).legends
        texts = [text.get_text() for text in legend.get_texts()]
        assert texts == ["true", "one", "partition points", "other", "one, points", "one, smoothed"]

    def test_estimates_differ_without_colour_in_all_panels(self, draw):
        figure = draw("static_fit", STATIC)
        first, second = lines_of(figure.axes[0]), lines_of(figure.axes[1])
        assert first["one"].get_marker() == second["one, smoothed"].get_marker()
        assert first["one"].get_marker() != first["other"].get_marker()
        assert first["one"].get_linestyle() != first["other"].get_linestyle()


class TestConvergence:
    def test_parameters_and_scores_against_the_iteration(self, draw):
        parameter, score = draw("convergence", CONVERGENCE).axes
        lines = lines_of(parameter)
        assert list(lines) == ["one", "two, not converged", "true"]
        assert lines["one"].get_ydata() == pytest.approx(2.0 + 0.3 ** np.arange(9))
        assert lines["true"].get_ydata() == pytest.approx([2.0, 2.0])
        # No grid line is drawn over the truth.
        assert lines["true"].get_zorder() > parameter.xaxis.get_zorder()
        # Errors of a_1 and b_0 over |2| + |1|.
        expected = 100.0 * 1.1 / 3.0
        assert lines_of(score)["one"].get_ydata() == pytest.approx(expected * 0.3 ** np.arange(9))
        assert lines_of(score)["two, not converged"].get_ydata() == pytest.approx(np.full(9, expected))
        assert score.get_ylabel() == "percent error of linear parameters, %"
        assert parameter.get_ylabel() == "$a_{1}$"

    def test_a_true_value_of_another_name(self, draw):
        parameter, _ = draw("convergence", CONVERGENCE + "truths: {a_1: steady_input}\n").axes
        assert lines_of(parameter)["true"].get_ydata() == pytest.approx([STEADY_INPUT] * 2)

    def test_later_iterations_may_be_left_out(self, draw):
        parameter, score = draw("convergence", CONVERGENCE + "last: 3\n").axes
        assert lines_of(parameter)["one"].get_ydata() == pytest.approx(2.0 + 0.3 ** np.arange(4))
        assert len(lines_of(score)["one"].get_ydata()) == 4

    def test_a_metric_of_the_linear_block_sees_every_iterate(self):
        found = Stated().fit(_record(), None)
        blocks = [
            block
            for iterate in iterates(found, found.details["history"])
            if iterate is not None and (block := iterate.continuous) is not None
        ]
        assert np.ravel([block.a for block in blocks]) == pytest.approx(2.0 + 0.3 ** np.arange(9))
        assert np.ravel([block.b for block in blocks]) == pytest.approx(1.0 + 0.1 * 0.3 ** np.arange(9))

    def test_iterates_have_the_orders_of_the_stage_that_iterates(self):
        second = ContinuousTransferFunction((1.0, 0.5), (2.0, 3.0, 4.0))
        found = replace(
            Stated().fit(_record(), None), continuous=second, linear=TransferFunction((0.0, 1.0), (0.5,))
        )
        history = History(np.array([[7.0, 8.0]]), np.array([[1.0, 9.0]]), {}, True)
        (iterate,) = iterates(found, history)
        assert iterate is not None
        assert iterate.continuous == ContinuousTransferFunction((1.0, 9.0), (7.0, 8.0))
        assert iterate.linear == TransferFunction((1.0, 9.0), (7.0, 8.0))

    def test_an_iterate_that_is_no_estimate_leaves_a_gap(self):
        found = Stated().fit(_record(), None)
        history = History(np.array([[0.0], [np.nan], [2.0]]), np.ones((3, 1)), {}, True)
        assert [iterate is None for iterate in iterates(found, history)] == [True, True, False]

    def test_a_parameter_that_the_history_does_not_hold_is_named(self, draw):
        with pytest.raises(ValueError, match=r"the history of 'one' holds no c_1 \(it holds: a_1, b_0\)"):
            draw("convergence", "curves: [{estimator: one}]\nof: [c_1]\n")

    @pytest.mark.parametrize(
        ("fields", "message"),
        [
            (
                "curves: [{estimator: one}]\n",
                "give 'of', names of parameters, or 'metrics', labels of metrics",
            ),
            (
                "curves: [{estimator: one}]\nof: [a_1]\ny_labels: {b: x}\n",
                "y_labels names b, which is not shown",
            ),
        ],
    )
    def test_a_figure_of_nothing_is_refused(self, make, fields, message):
        with pytest.raises(ConfigError, match=message):
            make("convergence", fields)


def _record():
    return Record(np.linspace(-1.0, 1.0, 20), np.zeros(20), 0.1)


class TestValidation:
    def test_the_input_and_the_responses_stand_at_absolute_values(self, draw):
        applied, responses = draw("validation", VALIDATION).axes
        t, u = applied.lines[0].get_data()
        assert applied.get_title() == "(a) the input"
        assert t == pytest.approx(0.1 * np.arange(400))
        assert u[[0, 150, 250, 350]] - STEADY_INPUT == pytest.approx([0.0, 1.0, -1.0, 0.5])
        lines = lines_of(responses)
        actual = LINEAR.respond(np.tanh(u - STEADY_INPUT), 0.1)
        assert lines["actual"].get_ydata() == pytest.approx(STEADY_OUTPUT + actual)
        # Another gain scales the whole response.
        spread = np.sqrt(np.mean(actual**2)) / np.std(actual)
        assert f"one: {10.0 * spread:.3g} %" in lines
        assert f"two: {20.0 * spread:.3g} %" in lines

    def test_what_fails_is_said(self, draw):
        fields = VALIDATION.replace("estimator: two", "estimator: failing")
        responses = draw("validation", fields).axes[1]
        assert [text.get_text() for text in responses.texts] == ["failing failed: the matrix is singular"]
        broken = draw("validation", fields, system="saturating, breaks: true")
        assert [text.get_text() for text in broken.axes[1].texts] == [
            "the actual response failed: the solver broke down"
        ]

    def test_an_unstable_model_is_said(self, draw, monkeypatch):
        fit = Stated.fit
        unstable = ContinuousTransferFunction((1.0,), (-2.0,))
        monkeypatch.setattr(Stated, "fit", lambda *given: replace(fit(*given), continuous=unstable))
        responses = draw("validation", VALIDATION).axes[1]
        assert list(lines_of(responses)) == ["actual"]
        assert [text.get_text() for text in responses.texts] == [
            "one failed: its linear block is unstable\ntwo failed: its linear block is unstable"
        ]


class TestSettlingMap:
    def test_the_linearised_system_and_the_constants_of_the_estimates(self, draw):
        (axes,) = draw("settling_map", SETTLING, system="varying").axes
        lines = lines_of(axes)
        x, times = lines["linearised system"].get_data()
        assert np.isnan(times[x == 20.0]).all()
        assert times[x != 20.0] == pytest.approx(0.1 * x[x != 20.0])
        # A lag of 2 settles to 5 % after 2 ln 20.
        assert lines["one"].get_ydata() == pytest.approx(np.full(len(x), 2.0 * np.log(20.0)), rel=1e-4)
        assert lines.keys() == {"linearised system", "one", "two"}


def errors(reach):
    """Errors of 1 up to the given label of sigma, then 9, by estimator and sharpness."""
    return {
        ("error", name, sharpness, sigma): np.full(5, 1.0 if float(sigma) <= limit else 9.0)
        for (name, sharpness), limit in reach.items()
        for sigma in ("0.5", "1", "2")
    }


REACH = {
    ("one", "1"): 2.0,
    ("one", "2"): 1.0,
    ("one", "4"): 0.5,
    ("two", "1"): 1.0,
    ("two", "2"): 0.0,
    ("two", "4"): 0.0,
}


class TestLimit:
    def test_the_table_holds_the_largest_label_below_the_limit(self, make):
        table = (
            make(values=errors(REACH)).plan.experiment.tables["limit"].build(make(values=errors(REACH)), ())
        )
        assert table.header == ("system.sharpness", "one", "two")
        assert table.rows == (("1", ">= 2", "1"), ("2", "1", "none"), ("4", "0.5", "none"))
        assert list(table.data["open"]) == [True, False, False, False, False, False]
        assert table.data["sigma"].to_numpy() == pytest.approx([2, 1, 0.5, 1, np.nan, np.nan], nan_ok=True)

    def test_a_method_cannot_gain_by_failing_or_by_recovering(self, make):
        values = errors(REACH)
        values["error", "one", "1", "1"] = np.array([1.0, 1.0, np.nan, np.nan, np.nan])
        results = make(values=values)
        assert results.plan.experiment.tables["limit"].build(results, ()).rows[0][1] == "0.5"

    def test_the_figure_shows_the_table_beside_the_characteristics(self, draw):
        left, right = draw("limit", LIMIT, values=errors(REACH)).axes
        curves = lines_of(left)
        assert list(curves) == ["D = 1", "D = 2", "D = 4"]
        x, y = curves["D = 4"].get_data()
        assert y == pytest.approx(np.tanh(4.0 * x))
        lines = lines_of(right)
        assert list(lines) == ["one", "two", "goes beyond"]
        assert lines["one"].get_ydata() == pytest.approx([2.0, 1.0, 0.5])
        assert lines["two"].get_ydata() == pytest.approx([1.0, np.nan, np.nan], nan_ok=True)
        assert lines["goes beyond"].get_xydata().ravel() == pytest.approx([1.0, 2.0])

    def test_a_method_that_gets_nowhere_is_named_so(self, draw):
        reach = {**REACH, ("two", "1"): 0.0}
        fields = "\n".join(line for line in LIMIT.splitlines() if "interval" not in line)
        (axes,) = draw("limit", fields, values=errors(reach)).axes
        assert list(lines_of(axes)) == ["one", "two, nowhere", "goes beyond"]

    def test_methods_that_go_equally_far_are_seen_side_by_side(self, draw):
        figure = draw("limit", LIMIT, values=errors({**REACH, ("two", "1"): 2.0}))
        axes = figure.axes[1]
        lines = lines_of(axes)
        one, two = (lines[name].get_transform().transform((1.0, 2.0)) for name in ("one", "two"))
        assert two[0] - one[0] > 0.05 * figure.dpi
        assert two[1] == pytest.approx(one[1])
        arrows = [line for line in axes.lines if line.get_marker() == r"$\uparrow$"]
        assert [line.get_xydata().ravel().tolist() for line in arrows] == [[1.0, 2.0], [1.0, 2.0]]
        assert axes.get_xlim() == pytest.approx((4**-0.1, 4**1.1))


class TestScatter:
    def test_lines_stand_at_the_true_values(self, draw):
        axes = draw("scatter", SCATTER % ("theta a_1", "theta b_0")).axes[0]
        assert [line.get_label() for line in axes.lines] == ["our trials", "true", "true"]
        _, upright, level = axes.lines
        assert upright.get_xdata() == pytest.approx([2.0, 2.0])
        assert level.get_ydata() == pytest.approx([1.0, 1.0])

    def test_what_is_no_value_of_the_system_has_no_true_number(self, draw):
        axes = draw("scatter", SCATTER % ("error", "error")).axes[0]
        assert [line.get_label() for line in axes.lines] == ["our trials"]


class TestDistribution:
    @pytest.fixture
    def table(self, make):
        values = {("theta a_1", "one", "1", "1"): [1.0, 2.0, 3.0, np.nan, 2.5]}
        results = make("distribution", DISTRIBUTION, family="tables", values=values)
        check(results.plan)
        return results.plan.experiment.tables["f"].build(results, judge(results))

    def test_what_is_printed_stands_below_ours_with_sign_and_percentile(self, table):
        assert table.header == ("case", "a1", "b0", "error")
        assert table.rows == (
            ("stage 1", "2.25 [1.15, 2.92]", "1.00 [1.00, 1.00]", "1.00 [1.00, 1.00]"),
            ("printed", "2.2 = p50", "", ""),
            ("stage 2", "1.00 [1.00, 1.00]", "1.00 [1.00, 1.00]", ""),
        )
        assert table.notes[-1] == "stage 1: 1 of 5 trials failed in a1 and are left out there."

    def test_the_data_are_tidy(self, table):
        data = table.data
        assert list(data["metric"]) == ["theta a_1", "theta b_0", "error", "theta a_1", "theta b_0"]
        assert list(data.loc[0, ["row", "column", "sigma", "failed", "printed", "percentile"]]) == [
            "stage 1",
            "a1",
            "1",
            1.0,
            "2.2",
            50.0,
        ]

    @pytest.mark.parametrize(
        ("values", "printed", "expected"),
        [
            ([1, 2, 3, 4], 2.5, 50.0),
            ([1, 2, 3, 4], 0.0, 0.0),
            ([1, 2, 2, 3], 2.0, 50.0),
            ([1, 1], 2.0, 100.0),
        ],
    )
    def test_percentiles(self, values, printed, expected):
        assert percentile(np.array(values, dtype=float), printed) == expected

    def test_of_no_value_there_is_no_percentile(self):
        assert np.isnan(percentile(np.array([]), 1.0))


@pytest.mark.parametrize(
    ("kind", "fields", "message"),
    [
        (
            "search",
            SEARCH.replace("one", "onne"),
            r"panels\[0\].estimator: there is no estimator 'onne'; did you",
        ),
        (
            "static_fit",
            STATIC.replace("sharpness: 1", "sharpness: 9"),
            r"panels\[0\].curves\[0\].at.*there is no label of system.sharpness '9'",
        ),
        (
            "convergence",
            "curves: [{estimator: one}]\nmetrics: [eror]\n",
            r"metrics\[0\]: there is no metric 'eror'; did you mean 'error'",
        ),
        (
            "limit",
            LIMIT.replace("table: limit", "table: limits"),
            "table: there is no table 'limits'; did you mean",
        ),
    ],
)
def test_an_unknown_name_is_refused_when_the_file_is_read(make, kind, fields, message):
    with pytest.raises(ConfigError, match=message):
        make(kind, fields)


@pytest.mark.parametrize(
    ("kind", "fields", "message"),
    [
        (
            "static_fit",
            STATIC.replace("estimator: two", "estimator: plain"),
            r"panels\[0\].curves\[1\].estimator: the estimator 'plain' does not give a nonlinearity",
        ),
        (
            "static_fit",
            STATIC.replace("x_offset: steady_input", "x_offset: steady"),
            r"panels\[0\].x_offset: must be a number or a true value of the system, not 'steady' "
            r"\(it has: a_1, b_0, steady_input, steady_output\)",
        ),
        (
            "static_fit",
            STATIC.replace(
                "{estimator: one, show: [points, smoothed]}", "{estimator: plain, show: [points]}"
            ),
            r"panels\[1\].partition: no estimator of this panel gives y_-1 and y_1",
        ),
        (
            "convergence",
            CONVERGENCE.replace("estimator: two", "estimator: plain")
            .replace("[error]", "[theta a_1]")
            .replace("error:", "theta a_1:"),
            r"metrics\[0\]: the metric 'theta a_1' does not score the estimator 'plain'",
        ),
        (
            "validation",
            VALIDATION.replace("estimator: two", "estimator: plain"),
            r"panels\[0\].curves\[1\].estimator: the estimator 'plain' does not give a response",
        ),
        (
            "validation",
            VALIDATION.replace("samples: 400", "samples: 300"),
            "excitation: a record of 300 samples ends before the last of 4 levels",
        ),
        (
            "validation",
            VALIDATION.replace("y_offset: steady_output", "y_offset: level"),
            r"panels\[0\].y_offset: must be a number or a true value of the system, not 'level'",
        ),
        (
            "validation",
            VALIDATION.replace("x_offset: steady_input", "x_offset: level"),
            r"figures.f.x_offset: must be a number or a true value of the system, not 'level'",
        ),
        (
            "settling_map",
            SETTLING.replace("estimator: two", "estimator: plain"),
            r"figures.f.curves\[1\].estimator: the estimator 'plain' does not give a linear block in ",
        ),
        (
            "limit",
            LIMIT.replace("table: limit", "table: plain"),
            "table: the table 'plain' must be of kind limit, not parameters",
        ),
    ],
)
def test_a_figure_that_cannot_show_the_plan_is_refused(make, kind, fields, message):
    with pytest.raises(ConfigError, match=message):
        check(make(kind, fields).plan)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("without: [error]", "without: [b0]"), r"rows\[1\]: there is no metric 'theta loss'; did you mean"),
        (
            ("without: [error]", "without: [err]"),
            "the row 'stage 2' names the column 'err', which there is not; did you mean 'error'",
        ),
        (
            ("estimator: two", "estimator: plain"),
            r"rows\[1\]: the metric 'theta a_1' does not score the estimator 'plain'; "
            r"'without: \[a1\]' leaves the cell empty",
        ),
    ],
)
def test_a_distribution_that_cannot_be_filled_is_refused(make, change, message):
    with pytest.raises(ConfigError, match=message):
        check(make("distribution", DISTRIBUTION.replace(*change), family="tables").plan)


def test_a_detail_that_the_estimate_does_not_keep_is_named(draw):
    with pytest.raises(ValueError, match="the estimate of 'plain' holds no structure search"):
        draw("search", SEARCH.replace("estimator: one", "estimator: plain"))


def test_a_system_without_a_settling_time_is_refused(make):
    message = "the system 'saturating' has no settling time that varies with its input"
    with pytest.raises(ConfigError, match=message):
        check(make("settling_map", SETTLING).plan)


def test_a_system_without_what_is_shown_is_refused(make, monkeypatch):
    monkeypatch.setattr(Saturating, "truth", lambda self: Truth(values={"a_1": 2.0, "b_0": 1.0}))
    for kind, fields, part in (
        ("static_fit", STATIC.replace("x_offset: steady_input", "x_offset: 0"), "nonlinearity"),
        ("validation", VALIDATION.replace("steady_input", "0").replace("steady_output", "0"), "response"),
        ("limit", LIMIT, "nonlinearity"),
    ):
        with pytest.raises(ConfigError, match=f"the system 'saturating' has no true {part} to show"):
            check(make(kind, fields).plan)
