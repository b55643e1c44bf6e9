"""Tables and figures that cannot show a plan are refused before it runs."""

import re

import pytest

from hident.errors import ConfigError, EstimationError
from hident.reports.figures.curve import Curve
from hident.reports.mathematics import typeset
from hident.reports.output import Outputs, check, markdown
from tests.unit.results_maker import made

LABELLED = "  size:\n    small: {noise: {kind: white, std: 1}}\n    large: {noise: {kind: white, std: 2}}\n"


def curve(**fields):
    return _spec("figures", {"kind": "curve", "metric": "mise", "x_label": "N", "y_label": "e", **fields})


def rate(**fields):
    return _spec("tables", {"kind": "rate", "title": "R", "metric": "mise", "estimators": ["one"], **fields})


def _spec(family, fields):
    return f"{family}:\n  f: {{{', '.join(f'{key}: {value}' for key, value in fields.items())}}}\n"


LINEAR = "  linear: {kind: least_squares, order: 1}\n"
ONLY_ONE = (
    "  only: {kind: mise, interval: [-1, 1], estimators: [one]}\n"
    "  a: {kind: value, of: [c], estimators: [linear]}\n"
)


@pytest.mark.parametrize(
    ("rest", "axes", "message"),
    [
        (
            curve(x="size"),
            LABELLED,
            "figures.f.x: the labels of the axis 'size' must be numbers, not small, large",
        ),
        (rate(axis="size"), LABELLED, "tables.f.axis: the labels of the axis 'size' must be numbers"),
        (
            curve(x="samples", panels="[[two]]", metric="only"),
            "",
            r"figures.f.panels\[0\]\[0\]: the metric 'only' does not score the estimator 'two'",
        ),
        (
            _spec(
                "tables",
                {
                    "kind": "grid",
                    "title": "G",
                    "rows": "samples",
                    "columns": "[{estimator: two, metric: only}]",
                },
            ),
            "",
            r"tables.f.columns\[0\].metric: the metric 'only' does not score the estimator 'two'",
        ),
        (
            _spec("figures", {"kind": "realisation", "estimators": "[linear]", "interval": "[-1, 1]"}),
            "",
            r"figures.f.estimators\[0\]: the estimator 'linear' does not give a nonlinearity",
        ),
    ],
)
def test_a_misfit_is_named(tmp_path, rest, axes, message):
    extra = ONLY_ONE + rest
    results = made(tmp_path, {}, rest=extra, axes=axes, estimators=LINEAR)
    with pytest.raises(ConfigError, match=message):
        check(results.plan)


@pytest.mark.parametrize(
    "rest",
    [
        _spec("tables", {"kind": "grid", "title": "G", "rows": "samples", "columns": "[]"}),
        rate(axis="samples", estimators="[]"),
        curve(x="samples", panels="[[]]"),
        _spec("figures", {"kind": "realisation", "estimators": "[]", "interval": "[-1, 1]"}),
        _spec("figures", {"kind": "realisation", "estimators": "[one]", "interval": "[-1, 1]", "at": "[]"}),
        _spec("figures", {"kind": "realisation", "estimators": "[one]", "interval": "[1, -1]"}),
    ],
)
def test_empty_lists_and_intervals_are_refused(tmp_path, rest):
    with pytest.raises(ConfigError, match=r"at least|low < high"):
        made(tmp_path, {}, rest=rest)


def _two_figures(label="N"):
    other = curve(x="samples").replace("figures:\n  f:", "  g:")
    return curve(x="samples", x_label=f"'{label}'") + other


def test_an_estimate_that_says_nothing_where_a_figure_asks_is_named(tmp_path, monkeypatch):
    results = made(tmp_path, {}, rest=_two_figures())

    def draw(self, results, verdicts):
        raise EstimationError("7 of 9 points lie outside the domain of the basis")

    monkeypatch.setattr(Curve, "draw", draw)
    said = Outputs(results.plan, tmp_path / "out").write(results, {})
    assert [line.partition("figures.")[2] for line in said] == [
        f"{name}: cannot be drawn (7 of 9 points lie outside the domain of the basis)" for name in "fg"
    ]


def test_a_label_that_is_no_mathematics_is_named_and_withholds_nothing_else(tmp_path):
    results = made(tmp_path, {}, rest=_two_figures("$\\foo$"))
    outputs = Outputs(results.plan, tmp_path / "out")
    (said,) = outputs.write(results, {})
    assert re.fullmatch(r".*some\.yaml: figures\.f: cannot be drawn \(.*\)", said)
    assert {path.name for path in outputs.folder.iterdir()} == {
        *(
            "run.json",
            "table.csv",
            "table.md",
            "timing.csv",
            "trials.csv.xz",
            "g.png",
            "g.svg.xz",
            "g.data.csv.xz",
        )
    }
    assert outputs.state() == "incomplete"
    repaired = made(tmp_path, {}, rest=_two_figures())
    outputs = Outputs(repaired.plan, tmp_path / "out")
    assert outputs.write(repaired, {}) == ()
    assert outputs.state() == "up to date"
    assert (outputs.folder / "f.png").exists()


@pytest.mark.parametrize(
    ("label", "drawn"),
    [
        ("Costs $5 & 7% of $10", r"Costs \$5 & 7% of \$10"),
        ("5$ {x}_{, $\\sigma$ = 0.1", r"5\$ {x}_{, $\sigma$ = 0.1"),
        ("50% & $$a_1$$", r"50% & \$$a_1$\$"),
        ("$x_$ of R^-1", r"\$x_\$ of $R^{-1}$"),
        ("$x$ of R^-1", "$x$ of R^-1"),
        (r"\$5 and \$6", r"\$5 and \$6"),
    ],
)
def test_dollars_are_mathematics_where_they_pair_around_some(label, drawn):
    from matplotlib.figure import Figure

    figure = Figure()
    axes = figure.add_subplot(xlabel=label)
    axes.set_yticks([0.0], [label])
    typeset(figure)
    figure.draw_without_rendering()
    assert axes.get_xlabel() == drawn
    assert axes.get_yticklabels()[0].get_text() == drawn.replace("$R^{-1}$", "R^-1")


def test_a_fault_in_a_figure_is_raised_when_all_else_is_written(tmp_path, monkeypatch):
    results = made(tmp_path, {}, rest=_two_figures())
    outputs, draw = Outputs(results.plan, tmp_path / "out"), Curve.draw

    def faulty(spec, results, verdicts):
        if spec is results.plan.experiment.figures["f"]:
            raise KeyError("a slip")
        return draw(spec, results, verdicts)

    monkeypatch.setattr(Curve, "draw", faulty)
    with pytest.raises(KeyError, match="a slip"):
        outputs.write(results, {})
    assert (outputs.folder / "g.png").exists()
    assert outputs.state() == "incomplete"


def test_without_tables_all_statistics_are_shown(tmp_path):
    text = markdown(made(tmp_path, {("one", "10"): [1.0, 3.0]}), (), {})
    assert "| samples | estimator | metric | trials | failed | mean |  std | median |" in text
    assert "|      10 | one       | mise   |      2 |      0 | 2.00 | 1.41 |   2.00 |" in text
