"""A label of an axis can set an estimator to null, which leaves it out of the cases there."""

from __future__ import annotations

from pathlib import Path

import pytest

from hident.commands.exporting import export
from hident.engine.experiment import Plan
from hident.engine.runner import run
from hident.engine.store import Store
from hident.errors import ConfigError
from hident.ledger.accept import accept
from hident.ledger.published import check_published
from hident.reports.output import Outputs, check
from tests.unit.plans import planned

CONFIG = """\
version: 1
title: An estimator left out of one case
trials: 3
system: {kind: hammerstein, nonlinearity: identity, linear: {kind: fir, b: [1, 0]}}
excitation: {kind: iid, distribution: uniform, low: -1, high: 1}
cases:
  samples: [60, 120]
  excitation:
    iid: {}
    prbs: {excitation: {kind: prbs, order: 7}, estimators.two-stage: null}
estimators:
  two-stage: {kind: two_stage, lags: 2, delay: 0, degree: 2}
  kernel: {kind: kernel, kernel: gaussian, bandwidth: {h0: 0.2, alpha: 1/5}}
metrics:
  mise: {kind: mise, interval: [-1, 1]}
  b: {kind: value, of: [b_1], estimators: [two-stage]}
"""
GRID = """\
tables:
  errors:
    kind: grid
    title: Errors
    rows: samples
    columns: [{estimator: two-stage, metric: mise}, {estimator: kernel, metric: mise}]
  rates: {kind: rate, title: Rates, axis: samples, metric: mise, estimators: [two-stage, kernel]}
figures:
  errors: {kind: curve, x: samples, metric: mise, x_label: N, y_label: e, panels: [[two-stage, kernel]]}
  fits:
    kind: static_fit
    x_label: u
    y_label: v
    panels:
      - interval: [-1, 1]
        curves: [{estimator: two-stage, at: {excitation: iid}}, {estimator: kernel}]
"""
PUBLISHED = """\
paper: someone2001
published:
  paper_trials: 1
  cells: [{table: T, row: "{excitation} {samples}", quantity: e, estimator: two-stage, metric: mise}]
"""


@pytest.fixture
def plan(tmp_path: Path):
    def plan(text: str = CONFIG, *assignments: str, **options: int) -> Plan:
        paper = tmp_path / "experiments" / "someone2001"
        paper.mkdir(parents=True, exist_ok=True)
        (paper / "published.csv").write_text(
            "table,row,quantity,printed,note\nT,iid 60,e,0.1,\nT,iid 120,e,0.1,\n"
        )
        found = planned(tmp_path, text, *assignments, **options)
        check_published(found)
        check(found)
        return found

    return plan


@pytest.fixture
def refused(plan, tmp_path: Path):
    def lines(text: str, *assignments: str) -> list[str]:
        with pytest.raises(ConfigError) as caught:
            plan(text, *assignments)
        return str(caught.value).replace(f"{tmp_path}/", "").splitlines()

    return lines


def units(plan: Plan) -> list[tuple[str, str, int]]:
    return [(u.name, str(u.labels["excitation"]), int(u.labels["samples"])) for u in plan.units]


def test_the_combination_has_no_units(plan) -> None:
    assert sorted(units(plan())) == [
        ("kernel", "iid", 60),
        ("kernel", "iid", 120),
        ("kernel", "prbs", 60),
        ("kernel", "prbs", 120),
        ("two-stage", "iid", 60),
        ("two-stage", "iid", 120),
    ]


def test_the_first_label_may_leave_an_estimator_out(plan) -> None:
    first = CONFIG.replace("iid: {}", "none: {estimators.two-stage: null}")
    first = first.replace(", estimators.two-stage: null}", "}")
    assert {label for name, label, _ in units(plan(first)) if name == "two-stage"} == {"prbs"}


def test_what_other_axes_set_of_it_does_not_count_there(plan) -> None:
    other = "  lags: {two: {}, three: {estimators.two-stage.lags: 3}, none: {estimators.two-stage: null}}\n"
    first, last = "cases:\n", "\nestimators:\n"
    for text in (CONFIG.replace(first, first + other), CONFIG.replace(last, f"\n{other}estimators:\n")):
        found = [u.labels for u in plan(text).units if u.name == "two-stage"]
        assert {(u["excitation"], u["lags"]) for u in found} == {("iid", "two"), ("iid", "three")}


def test_tables_figures_and_exports_do_without_it(plan, tmp_path: Path) -> None:
    found = plan(CONFIG + GRID + PUBLISHED)
    store = Store(tmp_path / "store")
    with store.writing() as writer:
        results = run(found, store=writer)
    out = tmp_path / "out" / "a"
    Outputs(found, out).write(results, {})
    table = (out / "table.md").read_text()
    rows = [
        [cell.strip() for cell in line.split("|")] for line in table.splitlines() if line.startswith("| ")
    ]
    # A rate of two cases with equal estimates has no slope to show either.
    assert [row[1] for row in rows if "-" in row and row[1] != "kernel"] == ["60, prbs", "120, prbs"]
    assert (out / "verdicts.csv").read_text().count("\nT,") == 2
    assert (
        "3 trials" in str(export(found, tmp_path / "store", tmp_path / "a.csv"))
        or (tmp_path / "a.csv").read_text().count("two-stage,") == 2 * 3 * 2
    )
    assert str(accept(out, tmp_path / "results")) == "a: new"


def test_an_estimator_left_out_of_every_case_is_refused(refused) -> None:
    assert refused(CONFIG, "cases.excitation.iid={estimators.two-stage: null}")[0] == (
        "a.yaml:12: estimators.two-stage: is left out of every case"
    )


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        (
            "estimators={kernel: null}",
            "estimators.kernel: must be an estimator; only a label of an axis can set it to null, "
            "to leave it out (got null)",
        ),
        ("noise=null", "noise: must be a noise or a list of them; write [] for none (got null)"),
        ("system=null", "system: must be a mapping with 'kind:' (allowed: "),
        ("metrics={mise: null}", "metrics.mise: must be a mapping with 'kind:' (allowed: "),
        ("cases.system=[null]", "system: must be a mapping with 'kind:' (allowed: "),
        (
            "cases.metrics.mise=[null]",
            "cases.metrics.mise: a case cannot change 'metrics.mise', only settings of the metric",
        ),
        ("cases.estimators.kernel=[3, 4]", "estimators.kernel: must be a mapping with 'kind:' (allowed: "),
        (
            "cases.x={a: {estimators.kernel: [1]}}",
            "estimators.kernel: must be a mapping with 'kind:' (allowed",
        ),
        ("cases.x={a: {}, b: {estimators.kernel: 3}}", "estimators.kernel: must be a mapping with 'kind:' ("),
        ("cases.x={a: {}, b: {metrics.mise.interval: 3}}", "metrics.mise.interval: must be a list (got 3)"),
        (
            "cases.x={a: {}, b: {estimators.kernel.bandwidth: null}}",
            "estimators.kernel.bandwidth: must be a mapping with 'h0' and 'alpha', or a rule: ",
        ),
    ],
)
def test_other_nulls_and_what_is_no_component_are_refused(refused, assignment: str, message: str) -> None:
    found = refused(CONFIG, assignment)
    assert any(line.startswith(f"--set {assignment}: {message}") for line in found), found


FIT = "figures:\n  f: {kind: static_fit, x_label: u, y_label: v, panels: [{interval: [-1, 1], curves: %s}]}\n"
SCATTER = "figures:\n  f: {kind: scatter, panels: [{x: %s, y: {estimator: kernel, metric: mise}}]}\n"
REALISATION = (
    "figures:\n  f: {kind: realisation, interval: [-1, 1], estimators: [%s], at: [{excitation: prbs}]}\n"
)
LIMIT = """\
tables:
  t: {kind: limit, title: T, x: level, along: samples, metric: mise, below: 1, estimators: [%s]}
"""
LEVEL = "  level: {1: {}, 2: {estimators.two-stage: null}}\n"


@pytest.mark.parametrize(
    ("rest", "message"),
    [
        (
            FIT % "[{estimator: two-stage, at: {excitation: prbs}}]",
            "figures.f.panels[0].curves[0].estimator: "
            "the estimator 'two-stage' is left out at excitation prbs",
        ),
        (
            REALISATION % "two-stage",
            "figures.f.estimators[0]: the estimator 'two-stage' is left out at excitation prbs",
        ),
        (
            SCATTER % "{estimator: two-stage, metric: mise, at: {excitation: prbs}}",
            "figures.f.panels[0].x.estimator: the estimator 'two-stage' is left out at excitation prbs",
        ),
        (
            LIMIT % "kernel, two-stage",
            "tables.t.estimators[1]: the estimator 'two-stage' is left out at level 2, samples 60",
        ),
    ],
)
def test_what_shows_the_combination_itself_is_refused(refused, rest: str, message: str) -> None:
    text = CONFIG.replace("cases:\n", f"cases:\n{LEVEL}") + rest
    assert any(line.endswith(message) for line in refused(text)), refused(text)
