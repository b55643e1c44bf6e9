"""Labels that are held, tables and figures over axes, and the sizes of figures in print."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest

from hident.errors import ConfigError
from hident.ledger.verdicts import judge
from hident.reports.base import FigureSpec, TableSpec
from hident.reports.canvas import Canvas, drawn_on
from hident.reports.output import Outputs, check
from hident.reports.style import LINES, printed, style, subplots
from tests.unit.results_maker import PUBLISHED, made

AXES = "  sigma: [0.5, 1, 2]\n  law: {uniform: {excitation.high: 2}, other: {excitation.high: 3}}\n"
NOISE = "noise: {kind: white, std: $sigma}\n"
CURVE = """
figures:
  f: {{kind: curve, x: samples, metric: mise, x_label: N, y_label: error, {fields}}}
"""
GRID = """
tables:
  t:
    kind: grid
    title: Errors
    rows: samples
    columns: [{{estimator: one, metric: mise}}, {{estimator: two, metric: mise, header: second}}]
    {fields}
"""


def results_of(folder, rest, axes=AXES):
    """The value of each series is sigma * 100 + samples for one, that times ten for two."""
    results = made(folder, {}, rest=NOISE + rest, axes=axes)
    for series in results.series:
        labels = series.unit.labels
        gain = {"one": 1.0, "two": 10.0}[series.unit.name]
        law = {"uniform": 0.0, "other": 0.25}[str(labels.get("law", "uniform"))]
        value = gain * (100.0 * float(labels["sigma"]) + float(labels["samples"]) + law)
        series._values = np.array([value, value])
    return results


def drawn(results):
    spec = results.plan.experiment.figures["f"]
    assert isinstance(spec, FigureSpec)
    with style():
        return spec.drawn(results, judge(results))


def built(results):
    spec = results.plan.experiment.tables["t"]
    assert isinstance(spec, TableSpec)
    return spec.built(results, judge(results))


def lines_of(axes):
    return {line.get_label(): line for line in axes.lines if line.get_label()[0] != "_"}


def test_a_curve_over_two_axes_has_a_panel_for_each_pair_of_labels(tmp_path):
    fields = "facets: {rows: sigma, columns: law, names: {sigma: s}}"
    figure = drawn(results_of(tmp_path, CURVE.format(fields=fields)))
    grid = np.array(figure.axes).reshape(3, 2)
    assert [axes.get_title() for axes in grid[0]] == ["law = uniform", "law = other"]
    assert [axes.get_title() for axes in grid[1]] == ["", ""]
    assert [axes.texts[0].get_text() for axes in grid[:, 1]] == ["s = 0.5", "s = 1", "s = 2"]
    assert [axes.get_xlabel() for axes in grid[:, 0]] == ["", "", "N"]
    # Of equal labels one stands in the middle.
    assert [axes.get_ylabel() for axes in grid.flat] == ["", "", "error", "", "", ""]
    assert [axes.get_xlabel() for axes in grid[2]] == ["N", ""]
    assert grid[2, 0].xaxis.label.get_position()[0] > 1.0
    for row, sigma in zip(grid, (0.5, 1.0, 2.0), strict=True):
        for axes, law in zip(row, (0.0, 0.25), strict=True):
            lines = lines_of(axes)
            assert list(lines) == ["one", "two"]
            expected = 100.0 * sigma + np.array([10.0, 100.0, 1000.0]) + law
            assert lines["one"].get_ydata() == pytest.approx(expected)
            assert axes.get_legend() is None
            assert axes.get_ylim() == grid[0, 0].get_ylim()
    [legend] = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["one", "two"]


def _boxes(texts):
    return sorted((text.get_window_extent() for text in texts if text.get_text()), key=lambda box: box.x0)


@pytest.mark.parametrize(
    ("size", "kept"), [("column", ["50", "400", "1600"]), ("page", ["50", "100", "400", "1600"])]
)
def test_in_narrow_panels_no_numbers_and_no_labels_touch(size, kept):
    samples = [50, 100, 400, 1600]
    with style(), drawn_on(Canvas(size, 2, 3)) as canvas:
        for canvas.at in itertools.product(range(2), range(3)):
            figure, axes = subplots(figsize=(3.4, 2.6))
            axes.plot(samples, samples)
            axes.set_xscale("log")
            axes.set_xticks(samples, [str(n) for n in samples])
            axes.set_xticks([], minor=True)
            axes.set_xlabel("number of samples")
            axes.set_ylabel("integrated squared error of the nonlinearity")
        canvas.finish(["a", "b", "c"], ["d", "e"])
        figure.draw_without_rendering()
    below = figure.axes[3:]
    assert [label.get_text() for label in below[0].get_xticklabels() if label.get_text()] == kept
    assert figure.axes[0].get_xticks().tolist() == samples
    for axes in below:
        boxes = _boxes(axes.get_xticklabels())
        assert len(boxes) == len(kept)
        assert all(left.x1 < right.x0 for left, right in itertools.pairwise(boxes))
    [across] = _boxes(axes.xaxis.label for axes in figure.axes)
    [up] = _boxes(axes.yaxis.label for axes in figure.axes)
    for start, end, room in ((across.x0, across.x1, figure.bbox.x1), (up.y0, up.y1, figure.bbox.y1)):
        assert start > 0.0
        assert end < room


def test_rows_and_columns_keep_their_titles_where_their_outer_panels_are_left_out(tmp_path):
    fields = "facets: {rows: sigma, columns: law, names: {sigma: s}}"
    skip = "skip: [{sigma: 2, law: other}, {sigma: 0.5, law: uniform}]\n"
    grid = np.array(drawn(results_of(tmp_path, skip + CURVE.format(fields=fields))).axes).reshape(3, 2)
    assert [[axes.get_visible() for axes in row] for row in grid] == [
        [False, True],
        [True, True],
        [True, False],
    ]
    assert [axes.get_title() for axes in (grid[1, 0], grid[0, 1])] == ["law = uniform", "law = other"]
    assert grid[1, 1].get_title() == grid[2, 0].get_title() == ""
    beside = [[text.get_text() for text in axes.texts] for axes in (grid[0, 1], grid[1, 1], grid[2, 0])]
    assert beside == [["s = 0.5"], ["s = 1"], ["s = 2"]]


def test_dollars_in_labels_of_panels_are_no_mathematics_where_they_do_not_pair(tmp_path):
    fields = 'facets: {columns: law, names: {law: "$x_$"}}, at: {sigma: 1}, size: column'
    figure = drawn(results_of(tmp_path, CURVE.format(fields=fields).replace("label: N", 'label: "$5 & $6"')))
    assert figure.axes[0].get_title().startswith(r"\$x\_\$ =".replace("\\_", "_"))
    assert r"\$5 & \$6" in {axes.get_xlabel() for axes in figure.axes}


def test_labels_are_held(tmp_path):
    figure = drawn(results_of(tmp_path, CURVE.format(fields="at: {sigma: 2, law: other}")))
    [axes] = figure.axes
    assert list(lines_of(axes)) == ["one", "two"]
    assert lines_of(axes)["one"].get_ydata() == pytest.approx([210.25, 300.25, 1200.25])


def test_without_them_each_case_is_a_curve_of_its_own_and_too_many_are_refused(tmp_path):
    results = results_of(tmp_path, CURVE.format(fields="log_y: true"))
    with pytest.raises(ConfigError) as refused:
        check(results.plan)
    assert str(refused.value).endswith(
        "figures.f: 12 curves are to share 6 line styles: repeat the figure over an axis with 'facets', hold "
        "labels with 'at', or name fewer estimators"
    )


def test_looks_differ_in_dash_mark_and_grey():
    from matplotlib.colors import to_rgb

    assert len({str(look["linestyle"]) for look in LINES}) == len({look["marker"] for look in LINES}) == 6
    assert len({to_rgb(look["color"]) for look in LINES}) == 6


def test_printed_numbers_stand_in_their_panel_only(tmp_path):
    cells = PUBLISHED.format(runs=1, statistic="mean") + "      at: {sigma: 1, law: uniform}\n"
    numbers = "".join(f"T,N={n},error,{n},\n" for n in (10, 100, 1000))
    rest = NOISE + cells + CURVE.format(fields="facets: {columns: sigma}, at: {law: uniform}")
    results = made(tmp_path, {}, rest=rest, axes=AXES, printed=numbers)
    shown = ["one, printed" in lines_of(axes) for axes in drawn(results).axes]
    assert shown == [False, True, False]


def test_a_table_over_two_axes(tmp_path):
    fields = "facets: {rows: sigma, columns: law, names: {sigma: s}}"
    table = built(results_of(tmp_path, GRID.format(fields=fields)))
    assert table.header == (
        "s",
        "samples",
        "one, law = uniform",
        "second, law = uniform",
        "one, law = other",
        "second, law = other",
    )
    assert [row[0] for row in table.rows] == ["0.5"] * 3 + ["1"] * 3 + ["2"] * 3
    assert [row[1] for row in table.rows] == ["10", "100", "1000"] * 3
    assert table.rows[3] == ("1", "10", "110", "1100", "110", "1102")


@pytest.mark.parametrize(
    ("fields", "header", "first"),
    [
        ("at: {sigma: 2, law: other}", ("samples", "one", "second"), ("10", "210", "2102")),
        ("at: {sigma: 2}", ("samples, law", "one", "second"), ("10, uniform", "210", "2100")),
        (
            "at: {law: other}\n    facets: {rows: sigma}",
            ("sigma", "samples", "one", "second"),
            ("0.5", "10", "60.2", "602"),
        ),
    ],
)
def test_held_labels_are_no_rows_of_a_table(tmp_path, fields, header, first):
    table = built(results_of(tmp_path, GRID.format(fields=fields)))
    assert table.header == header
    assert table.rows[0] == first


def test_the_csv_of_a_table_over_axes_has_their_columns(tmp_path):
    rest = """
tables:
  t:
    kind: rate
    title: R
    axis: samples
    metric: mise
    estimators: [one]
    at: {law: other}
    facets: {columns: sigma}
"""
    table = built(results_of(tmp_path, rest))
    assert table.data is not None
    assert list(table.data["sigma"]) == ["0.5", "1", "2"]
    assert table.header[:3] == ("estimator", "slope, sigma = 0.5", "standard error, sigma = 0.5")
    assert len(table.rows) == 1


def refusal(folder, rest):
    with pytest.raises(ConfigError) as refused:
        check(made(folder, {}, rest=NOISE + rest, axes=AXES).plan)
    return str(refused.value).partition(": figures.f")[2] or str(refused.value).partition(": tables.t")[2]


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ("at: {samples: 10}", ".x: the axis 'samples' is held at one label, and cannot be shown as well"),
        (
            "facets: {rows: samples}",
            ".x: the axis 'samples' is repeated over, and cannot be shown as well",
        ),
        (
            "facets: {rows: sigma}, at: {sigma: 1}",
            ".facets: the label of the axis 'sigma' is held by 'at'",
        ),
        ("facets: {rows: sgma}", ".facets.rows: there is no axis 'sgma'; did you mean 'sigma'?"),
        ("at: {sigma: 3}", ".at.sigma: there is no label of sigma '3'"),
        ("facets: {}", ".facets: give 'rows' or 'columns', names of axes, or both"),
        ("facets: {rows: law, columns: law}", ".facets: 'rows' and 'columns' must be two axes"),
        ("size: pag", ".size: must be 'column' or 'page'; did you mean 'page'?"),
    ],
)
def test_what_cannot_be_shown_is_refused(tmp_path, fields, said):
    assert refusal(tmp_path, CURVE.format(fields=fields)).startswith(said)


def test_an_estimator_that_a_panel_lacks_is_named(tmp_path):
    rest = CURVE.format(fields="panels: [[one, two]], at: {law: other}, facets: {rows: sigma}")
    rest += "skip: [{estimator: two, sigma: 2}]\n"
    assert refusal(tmp_path, rest).startswith(
        ".panels[0][1]: the estimator 'two' is left out at law other (at sigma 2)"
    )


def test_a_panel_without_cases_stays_empty(tmp_path):
    rest = CURVE.format(fields="at: {law: other}, facets: {columns: sigma}") + "skip: [{sigma: 2}]\n"
    results = made(tmp_path, {}, rest=NOISE + rest, axes=AXES)
    check(results.plan)
    assert [axes.get_visible() for axes in drawn(results).axes] == [True, True, False]


WIDTHS = (
    "  sigma: [0.5, 1, 2]\n"
    "  width: {one: {estimators.two.bandwidth.h0: 1}, two: {estimators.two.bandwidth.h0: 2}}\n"
)
SKIPPED = "skip: [{sigma: 2, width: two}]\n"


@pytest.mark.parametrize(
    ("fields", "there"),
    [
        ("facets: {rows: sigma, columns: width}", [True, True, True, True, True, False]),
        ("at: {width: two}, facets: {columns: sigma}", [True, True, False]),
    ],
)
def test_a_skipped_panel_stays_empty_though_an_estimator_stands_there_by_other_labels(
    tmp_path, fields, there
):
    rest = CURVE.format(fields=fields) + GRID.format(fields=fields.replace("}, ", "}\n    ")) + SKIPPED
    results = made(tmp_path, {}, rest=NOISE + rest, axes=WIDTHS)
    check(results.plan)
    assert [axes.get_visible() for axes in drawn(results).axes] == there
    table = built(results)
    frame = [dict(zip(table.header, row, strict=True)) for row in table.rows]
    if "sigma" in table.header:
        assert [row["one, width = two"] for row in frame if row["sigma"] == "2"] == ["", "", ""]
    else:
        assert not any("sigma = 2" in column for column in table.header)


@pytest.mark.parametrize("sigma", [0.5, 2])
def test_titles_stand_at_the_outermost_panels_that_are_drawn(tmp_path, sigma):
    rest = CURVE.format(fields="facets: {rows: width, columns: sigma}")
    rest += f"skip: [{{sigma: {sigma}, width: [one, two]}}, {{sigma: 1, width: one}}]\n"
    figure = drawn(made(tmp_path, {}, rest=NOISE + rest, axes=WIDTHS))
    shown = [axes for axes in figure.axes if axes.get_visible()]
    other = 2.5 - sigma
    assert sorted(filter(None, (axes.get_title() for axes in shown))) == sorted(
        ["sigma = 1", f"sigma = {other:g}"]
    )
    assert [text.get_text() for axes in shown for text in axes.texts] == ["width = one", "width = two"]


def test_labels_that_are_skipped_hold_no_case(tmp_path):
    rest = CURVE.format(fields="at: {sigma: 2, width: two}") + SKIPPED
    with pytest.raises(ConfigError, match=r"figures.f.at: no case stands at these labels"):
        check(made(tmp_path, {}, rest=NOISE + rest, axes=WIDTHS).plan)


def test_an_estimator_that_is_left_out_is_not_called_one_that_no_metric_scores(tmp_path):
    rest = CURVE.format(fields="facets: {rows: sigma, columns: width}")
    rest += "skip: [{estimator: two, sigma: 2, width: two}]\n"
    with pytest.raises(
        ConfigError, match=r"figures.f.*: the estimator 'two' is left out \(at sigma 2, width two\)"
    ):
        check(made(tmp_path, {}, rest=NOISE + rest, axes=WIDTHS).plan)


@pytest.mark.parametrize(("size", "inches"), [("column", 88 / 25.4), ("page", 180 / 25.4)])
def test_a_size_is_that_of_a_column_or_a_page(tmp_path, size, inches):
    figure = drawn(results_of(tmp_path, CURVE.format(fields=f"at: {{sigma: 1, law: other}}, size: {size}")))
    assert figure.get_figwidth() == pytest.approx(inches)
    assert 1.5 < figure.get_figheight() < 4.0
    [axes] = figure.axes
    assert axes.xaxis.label.get_size() == 8
    assert axes.get_legend() is None
    assert len(figure.legends) == 1


def test_the_legend_and_the_labels_are_clear_of_the_panels(tmp_path):
    fields = "facets: {rows: sigma, columns: law}, size: column"
    figure = drawn(results_of(tmp_path, CURVE.format(fields=fields)))
    with style():
        printed(figure, ["png"])
    renderer = figure.canvas.get_renderer()
    legend = figure.legends[0].get_window_extent(renderer)
    boxes = [axes.get_tightbbox(renderer) for axes in figure.axes]
    whole = figure.bbox.padded(1.0)
    for box in boxes:
        assert not legend.overlaps(box)
        assert whole.x0 <= box.x0 < box.x1 <= whole.x1
    for i, box in enumerate(boxes):
        assert not any(box.padded(-1.0).overlaps(other.padded(-1.0)) for other in boxes[i + 1 :])


@pytest.mark.parametrize(
    ("size", "count", "remedy"),
    [
        ("size: column", 5, "in 88 mm: take 'size: page', or fewer columns)"),
        ("size: page", 9, "in 180 mm: take fewer columns)"),
    ],
)
def test_panels_that_are_too_narrow_are_not_drawn_and_said(tmp_path, size, count, remedy):
    axes = f"  sigma: {[*range(1, count + 1)]}\n"
    rest = CURVE.format(fields=f"facets: {{columns: sigma}}, {size}")
    results = made(tmp_path, {}, rest=NOISE + rest, axes=axes)
    [said] = Outputs(results.plan, tmp_path / "out").write(results, {})
    assert said.endswith(f"figures.f: cannot be drawn ({count} panels side by side are too narrow {remedy}")


def test_panels_of_a_figure_are_repeated_with_common_limits(tmp_path):
    rest = """
figures:
  f:
    kind: scatter
    facets: {rows: sigma, names: {sigma: s}}
    at: {law: other}
    panels:
      - {x: {estimator: one, metric: mise}, y: {estimator: two, metric: mise}}
      - {x: {estimator: two, metric: mise}, y: {estimator: one, metric: mise}, title: turned}
"""
    figure = drawn(results_of(tmp_path, rest))
    assert [part.get_suptitle() for part in figure.subfigs] == ["s = 0.5", "s = 1", "s = 2"]
    first = [part.axes[0] for part in figure.subfigs]
    assert len({axes.get_xlim() for axes in first}) == 1
    assert [axes.lines[0].get_xdata()[0] for axes in first] == pytest.approx([60.25, 110.25, 210.25])
    assert len(figure.legends) == 1
    assert not any(part.legends for part in figure.subfigs)


@pytest.mark.parametrize("trial", [0, 3])
def test_a_figure_of_one_trial_says_which(tmp_path, trial):
    rest = f"""
figures:
  f: {{kind: realisation, trial: {trial}, estimators: [one], interval: [-1, 1], at: [{{samples: 10}}]}}
"""
    figure = drawn(made(tmp_path, {}, rest=rest))
    assert figure.get_supxlabel() == f"trial {trial}"


def test_fields_at_their_default_are_not_written_down(tmp_path):
    results = made(tmp_path, {}, rest=CURVE.format(fields="log_y: true") + GRID.format(fields=""))
    Outputs(results.plan, tmp_path / "out").write(results, {})
    resolved = json.loads((tmp_path / "out" / "run.json").read_text())["experiment"]["resolved"]
    assert resolved["figures"]["f"].keys() == {"kind", "x", "metric", "x_label", "y_label"}
    assert not {"at", "facets"} & resolved["tables"]["t"].keys()


ALL = """
tables:
  t: {kind: rate, title: R, axis: samples, metric: mise, estimators: all, at: {law: other, sigma: 1}}
"""


@pytest.mark.parametrize(("scored", "shown"), [("", ["one", "two"]), (", estimators: [two]", ["two"])])
def test_all_estimators_are_those_that_the_metric_scores(tmp_path, scored, shown):
    own = f"  own: {{kind: mise, interval: [-1, 1]{scored}}}\n"
    rest = own + NOISE + ALL.replace("metric: mise", "metric: own")
    results = made(tmp_path, {}, rest=rest, axes=AXES)
    assert [row[0] for row in built(results).rows] == shown


PARAMETERS = """
tables:
  t: {kind: parameters, title: P, metric: a, of: [c], estimators: [linear], FIELDS}
figures:
  f: {kind: parameters, metric: a, of: [c], estimators: [linear], FIELDS}
"""


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ("mean: x", "of several cases the first: samples 10, sigma 0.5, law uniform"),
        ("at: {samples: 100, law: other}", "of several cases the first: sigma 0.5"),
        ("at: {samples: 100, law: other}, facets: {columns: sigma}", ""),
    ],
)
def test_where_one_of_several_cases_is_shown_it_says_which(tmp_path, fields, said):
    rest = "  a: {kind: value, of: [c], estimators: [linear]}\n" + NOISE
    rest += PARAMETERS.replace(", FIELDS", "" if fields == "mean: x" else f", {fields}")
    linear = "  linear: {kind: least_squares, order: 1}\n"
    results = made(tmp_path, {}, rest=rest, axes=AXES, estimators=linear)
    check(results.plan)
    assert drawn(results).get_supxlabel() == said
    assert built(results).notes == ((f"{said[0].upper()}{said[1:]}.",) if said else ())
