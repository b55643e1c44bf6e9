"""Trial by trial: what another arithmetic may do, what it may not, and that real changes are seen."""

from __future__ import annotations

import copy
import hashlib
import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from hident import plugins
from hident.engine.experiment import load
from hident.engine.results import Results, Series
from hident.engine.run_files import TIMING
from hident.engine.runner import run
from hident.engine.store import MemoryStore
from hident.engine.trial import digest
from hident.errors import ConfigError
from hident.ledger.accept import accept
from hident.ledger.compare import Comparison, compare
from hident.ledger.sensitivity import Count, Sensitivity
from hident.ledger.trial_values import TrialValues
from hident.reports.output import Outputs

if TYPE_CHECKING:
    from hident.arrays import Array
    from tests.conftest import Lab

plugins.load()
_UNIT = "tiny: samples 50, estimator 'iv': "


def _with(series: Series, values: Array) -> Series:
    return Series(series.unit, series.metric, values, series.reasons)


class Bench:
    """A run of a small experiment, accepted; ``again`` writes another run of it."""

    def __init__(self, lab: Lab) -> None:
        self._store = MemoryStore()
        self._move(lab)
        self.plain = self.run()
        self.write(self.plain)

    def _move(self, lab: Lab) -> None:
        self._lab = lab
        self._lab.configure(trials=40)
        self.out, self.results = lab.folder / "out", lab.folder / "results"

    def copied(self, lab: Lab) -> Bench:
        """The same run in another laboratory."""
        other = copy.copy(self)
        other._move(lab)
        shutil.copytree(self.out, other.out)
        return other

    def run(self, **changes: Any) -> Results:
        self._lab.configure(**changes)
        plan = load(self._lab.folder / "tiny.yaml")
        return run(plan, store=self._store)

    def write(self, results: Results) -> None:
        Outputs(results.plan, self.out / "tiny").write(results, {})

    def accept(self, moved: int = 0, perturbed: int = 80) -> None:
        """Accept the run, as if so many of the perturbed estimates of each unit had moved."""

        def measured(values: TrialValues) -> Sensitivity:
            return Sensitivity(values.axes, dict.fromkeys(values.units, Count(40, perturbed, moved)))

        accept(self.out / "tiny", self.results, measured)

    def again(self, change: Callable[[Array], None], *, foreign: bool) -> None:
        """Write the run with a change to the trials of the second series, on another arithmetic or not."""
        series = list(self.plain.series)
        values = series[1].values.copy()
        change(values)
        series[1] = _with(series[1], values)
        self.write(replace(self.plain, series=tuple(series)))
        if foreign:
            self.foreign()

    def foreign(self) -> None:
        _rewrite(self.out / "tiny", lambda run: run["provenance"].update(arithmetic={"identity": "other"}))

    def compare(self, **options: Any) -> Comparison:
        return compare(self.out, self.results, **options)


def _rewrite(folder: Path, change: Callable[[dict[str, Any]], None], *names: str) -> None:
    """Change run.json, and make its hashes and those of the named files right again."""
    run = json.loads((folder / "run.json").read_text())
    change(run)
    hashes = run["provenance"].pop("sha256")
    hashes |= {"run.json": digest(run)}
    hashes |= {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in names}
    run["provenance"]["sha256"] = hashes
    (folder / "run.json").write_text(json.dumps(run))


@pytest.fixture(scope="module")
def first(make_lab: Callable[[Path], Lab], tmp_path_factory: pytest.TempPathFactory) -> Bench:
    return Bench(make_lab(tmp_path_factory.mktemp("first")))


@pytest.fixture
def bench(first: Bench, lab: Lab) -> Bench:
    return first.copied(lab)


def _branch(*trials: int) -> Callable[[Array], None]:
    def change(values: Array) -> None:
        values[list(trials)] += 0.3

    return change


def test_equal_runs_differ_in_nothing(bench: Bench) -> None:
    bench.accept()
    assert bench.compare() == Comparison((), 1, ())
    bench.foreign()
    assert bench.compare() == Comparison((), 1, ())


def test_between_equal_arithmetics_no_trial_may_move(bench: Bench) -> None:
    bench.accept(moved=70)
    bench.again(_branch(5), foreign=False)
    found = bench.compare()
    unit, files = found.differences
    assert unit.splitlines()[0] == (
        f"{_UNIT}1 of 40 trials differ (5), though the arithmetic is the same; "
        "all others equal to the last bit"
    )
    assert re.fullmatch(r"    a a_1: mean \S+ \(reference \S+\), std .*", unit.splitlines()[1])
    assert files == "tiny: table.md: as these trials give"
    assert found.allowed == ()


@pytest.mark.parametrize("foreign", [False, True])
def test_a_tolerance_of_zero_asks_for_every_bit(bench: Bench, foreign: bool) -> None:
    def change(values: Array) -> None:
        values[5] = np.nextafter(values[5], np.inf)

    bench.accept(moved=70)
    bench.again(change, foreign=foreign)
    assert bench.compare().differences == ()
    unit = next(text for text in bench.compare(rtol=0.0).differences if text.startswith(_UNIT))
    reason = (
        "; how many may is known at a relative tolerance of 1e-06, and not at 0"
        if foreign
        else ", though the arithmetic is the same"
    )
    first, *cells = unit.splitlines()
    assert first == f"{_UNIT}1 of 40 trials differ (5){reason}; all others equal to the last bit"
    # Numbers that are said to differ are seen to differ.
    for one, other in re.findall(r"\w+ (\S+) \(reference (\S+)\)", "".join(cells)):
        assert one != other
    assert bench.compare(rtol=0.0).allowed == ()


@pytest.mark.parametrize("side", ["out", "results"])
@pytest.mark.parametrize("provenance", [None, {}, {"git_commit": "abc"}])
def test_a_run_that_lost_what_says_so_is_a_difference(bench: Bench, side: str, provenance: object) -> None:
    bench.accept()
    file = bench.out.parent / side / "tiny" / "run.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), "provenance": provenance}))
    whose = "the reference " if side == "results" else ""
    assert bench.compare().differences == (
        f"tiny/run.json: {whose}lacks provenance.key and provenance.sha256, which every run writes",
    )


def test_on_another_arithmetic_as_many_trials_may_move_as_are_likely(bench: Bench) -> None:
    bench.accept(moved=4)
    bench.again(_branch(5, 17, 31), foreign=True)
    found = bench.compare()
    assert found.differences == ()
    unit, files = found.allowed
    likely = Count(40, 80, 4).likely(40, 0.01 / 4)
    assert unit.startswith(
        f"{_UNIT}3 of 40 trials took another branch (5, 17, 31); "
        f"the stored share, 4 of 80, makes up to {likely} likely; all others equal to the last bit\n"
    )
    assert files == "tiny: table.md: as these trials give"


@pytest.mark.parametrize(("moved", "trials"), [(0, range(8)), (4, range(20)), (20, range(35))])
def test_more_trials_than_are_likely_are_a_difference(bench: Bench, moved: int, trials: range) -> None:
    bench.accept(moved=moved)
    bench.again(_branch(*trials), foreign=True)
    found = bench.compare()
    assert found.differences[0].startswith(f"{_UNIT}{len(trials)} of 40 trials took another branch (0, 1, ")
    assert found.allowed == ()


def test_what_each_unit_might_may_be_more_than_all_together_may(bench: Bench) -> None:
    def of_all(results: Results, count: int) -> Results:
        series = [_with(s, s.values + 0.3 * (np.arange(len(s.values)) < count)) for s in results.series]
        return replace(results, series=tuple(series))

    bench.accept(perturbed=40)
    alone = Count(40, 40, 0).likely(40, 0.01 / 4)
    bench.write(of_all(bench.plain, alone))
    bench.foreign()
    found = bench.compare()
    together = Count(160, 160, 0).likely(160, 0.01 / 4)
    assert 4 * alone > together
    assert len([text for text in found.differences if "took another branch" in text]) == 4
    assert (
        f"the stored share, 0 of 40, makes up to {alone} likely; in all units {4 * alone} of 160 did, and "
        f"the stored share, 0 of 160, makes up to {together} likely"
    ) in found.differences[0]


def test_where_no_share_is_stored_none_may_move(bench: Bench) -> None:
    accept(bench.out / "tiny", bench.results)
    bench.again(_branch(5), foreign=True)
    assert "no share is stored: hident accept measures it" in bench.compare().differences[0]


def test_other_trials_are_held_to_the_tolerance_and_the_largest_difference_is_said(bench: Bench) -> None:
    def change(values: Array) -> None:
        values *= 1 + 3e-9
        values[2] = np.nan

    bench.accept(moved=4)
    bench.again(change, foreign=True)
    unit = bench.compare().allowed[0]
    assert "1 of 40 trials took another branch (2)" in unit
    assert "all others equal to 1e-08" in unit
    assert "failed 1 (reference 0)" in unit


@pytest.mark.parametrize("foreign", [False, True])
@pytest.mark.parametrize(
    "change",
    [
        {"noise": {"kind": "white", "distribution": "uniform", "half_width": 0.1001}},
        {
            "system": {
                "kind": "hammerstein",
                "nonlinearity": "mzyk2009",
                "linear": {"kind": "ar", "a": [0.8008]},
            }
        },
        {"excitation": {"kind": "iid", "distribution": "uniform", "low": -6, "high": 6.006}},
    ],
)
def test_a_change_of_a_thousandth_is_seen(bench: Bench, change: dict[str, Any], foreign: bool) -> None:
    bench.accept(moved=4)
    # As if the change were in the code: the configuration says what it said.
    changed = bench.run(**change)
    series = [
        Series(p.unit, s.metric, s.values, s.reasons)
        for s, p in zip(changed.series, bench.plain.series, strict=True)
    ]
    bench.write(replace(bench.plain, series=tuple(series)))
    if foreign:
        bench.foreign()
    assert any("estimator 'iv': 40 of 40 trials" in line for line in bench.compare().differences)


def test_a_table_that_does_not_follow_from_its_trials_is_found_even_where_trials_moved(bench: Bench) -> None:
    bench.accept(moved=4)
    bench.again(_branch(5), foreign=True)
    table = bench.out / "tiny/table.csv"
    header, first, second, *rest = table.read_text().splitlines()
    cells = second.split(",")
    mean = header.split(",").index("mean")
    cells[mean] = repr(float(cells[mean]) * 1.00001)
    table.write_text("\n".join([header, first, ",".join(cells), *rest]) + "\n")
    _rewrite(bench.out / "tiny", lambda run: None, "table.csv")
    (line,) = bench.compare().differences
    assert line.startswith(
        f"tiny/table.csv: samples 50, estimator 'iv', metric a a_1: mean {cells[mean]}, and its trials give "
    )


def test_other_files_differ_only_where_trials_moved(bench: Bench) -> None:
    bench.accept(moved=4)
    file = bench.out / "tiny/table.md"
    file.write_text(file.read_text().replace("Tiny", "Other"))
    _rewrite(bench.out / "tiny", lambda run: None, "table.md")
    assert bench.compare().differences == ("tiny/table.md: line 1: '# Other', reference '# Tiny'",)


def test_a_spread_that_is_rounding_has_no_digits(bench: Bench) -> None:
    def constant(spread: float) -> Callable[[Array], None]:
        def change(values: Array) -> None:
            values[:] = 0.5 + spread * np.arange(40)

        return change

    bench.again(constant(1e-16), foreign=False)
    bench.accept()
    bench.again(constant(0.0), foreign=True)
    assert not [line for line in bench.compare().differences if "table.csv" in line]


def test_a_missing_series_is_named(bench: Bench) -> None:
    bench.accept()
    bench.write(replace(bench.plain, series=bench.plain.series[:-1]))
    assert (
        "tiny: samples 80, estimator 'iv', metric a a_1: its trials are missing"
        in bench.compare().differences
    )


def test_another_number_of_trials_is_a_difference_unless_the_common_ones_are_asked_for(bench: Bench) -> None:
    bench.accept()
    bench.write(bench.run(trials=15))
    assert bench.compare().differences == ("tiny: 15 trials, reference 40: --partial compares those of both",)
    assert bench.compare(partial=True) == Comparison((), 1, ())
    bench.again(_branch(5), foreign=True)
    few = replace(bench.plain, plan=bench.plain.plan.changed(trials=15), series=tuple(
        _with(s, s.values[:15] + (0.3 if i == 1 else 0.0)) for i, s in enumerate(bench.plain.series)
    ))  # fmt: skip
    bench.write(few)
    (unit,) = bench.compare(partial=True).differences
    assert unit.startswith(f"{_UNIT}15 of 15 trials differ (0, 1, ")


def test_every_flipped_bit_is_found_on_both_sides(bench: Bench) -> None:
    bench.accept()
    rng = np.random.default_rng(0)
    for side in (bench.out, bench.results):
        for file in sorted((side / "tiny").iterdir()):
            if file.name == TIMING:
                continue
            data = file.read_bytes()
            for at in rng.integers(0, 8 * len(data), 12):
                flipped = bytearray(data)
                flipped[at // 8] ^= 1 << (at % 8)
                file.write_bytes(flipped)
                assert bench.compare().differences, (file, at)
            file.write_bytes(data)
    assert not bench.compare().differences


def test_a_digit_too_small_for_the_tolerance_is_an_alteration(bench: Bench) -> None:
    bench.accept()
    for side, whose in ((bench.out, ""), (bench.results, "the reference was ")):
        table = side / "tiny/table.csv"
        before = table.read_text()
        digits = re.search(r"\d\.\d{14,}", before)
        assert digits
        table.write_text(before.replace(digits[0], digits[0] + "1", 1))
        assert bench.compare().differences == (f"tiny/table.csv: {whose}altered since it was written",)
        table.write_text(before)


def test_accept_refuses_a_folder_that_is_not_what_was_written(bench: Bench) -> None:
    before = (bench.out / "tiny/table.csv").read_bytes()
    few = bench.run(trials=15)
    bench.write(few)
    (bench.out / "tiny/table.csv").write_bytes(before)
    with pytest.raises(ConfigError, match=r"tiny: table\.csv was altered since the run: hident run tiny"):
        bench.accept()
    assert not bench.results.exists()


def test_accept_writes_the_sensitivity_beside_the_copy_and_its_hash_into_run_json(bench: Bench) -> None:
    bench.accept(moved=3)
    folder = bench.results / "tiny"
    assert (folder / "sensitivity.csv").read_text().splitlines()[1] == "50,known,40,80,3"
    for file in (bench.out / "tiny").iterdir():
        if file.name != "run.json":
            assert (folder / file.name).read_bytes() == file.read_bytes()
    (folder / "sensitivity.csv").write_text((folder / "sensitivity.csv").read_text().replace("80,3", "80,4"))
    assert bench.compare().differences == (
        "tiny/sensitivity.csv: the reference was altered since it was written",
    )


def test_a_stored_sensitivity_is_kept_as_long_as_the_trials_are_the_same(bench: Bench) -> None:
    asked: list[int] = []

    def measured(values: TrialValues) -> Sensitivity:
        asked.append(1)
        return Sensitivity(values.axes, dict.fromkeys(values.units, Count(40, 80, 3)))

    def accepted(repetitions: int = 2) -> int:
        accept(bench.out / "tiny", bench.results, measured, repetitions)
        return len(asked)

    assert [accepted(), accepted()] == [1, 1]
    other = bench.run(title="Another title")
    bench.write(other)
    assert accepted() == 1
    assert accepted(repetitions=3) == 2
    bench.again(_branch(5), foreign=False)
    assert accepted() == 3
    (bench.results / "tiny/sensitivity.csv").write_text("")
    assert accepted() == 4
