"""docs/scale.md says what results/bench.md holds, and what follows from it."""

import re

import pytest

from hident.engine.chunks import SECONDS
from tests.benchmarks.summary import read
from tests.documented import ROOT

PAGE = (ROOT / "docs" / "scale.md").read_text(encoding="utf-8").partition("## Throughput\n")[2]
FIGURES = read((ROOT / "results" / "bench.md").read_text(encoding="utf-8"))
OF_A_CHUNK = "milliseconds of the main process for a chunk"
RANGES = {
    f": {OF_A_CHUNK}, processes": r"processes \(h = (\S+) to (\S+) ms\)",
    f": {OF_A_CHUNK}, dask": r"Dask.* \(h = (\S+) to (\S+) ms\)",
}
"""Figures of all configurations, by the end of their names, and where the page says their range."""
MILLIONS = r"stores about\s(\S+) million in a second"
STORED = "millions of numbers stored per second of the main process"
CORE_TIMES = {
    "mzyk_table1, N = 50: milliseconds of processor time for a trial, serial": "`mzyk_table1`, N = 50",
    "wang_table1: milliseconds of processor time for a trial, serial": "`wang_table1`",
}


def written(pattern):
    """What the page says where the pattern has groups."""
    found = re.search(pattern, PAGE)
    assert found is not None, f"docs/scale.md does not say: {pattern}"
    return found.groups()


def said(pattern):
    """The same as numbers."""
    return [float(number) for number in written(pattern)]


def rows(header):
    """The rows of the table whose first column is called so."""
    [table] = [part for part in PAGE.split("\n\n") if part.startswith(f"| {header} |")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()[2:]]


def figures(ending):
    return [figure for name, figure in FIGURES.items() if name.endswith(ending)]


@pytest.mark.parametrize("ending", RANGES)
def test_a_range_holds_all_medians_and_is_no_wider_than_their_spread(ending):
    low, high = said(RANGES[ending])
    # As exact as it is written.
    digits = len(written(RANGES[ending])[0].partition(".")[2])
    step = 10.0**-digits
    assert figures(ending)
    assert low <= round(min(figure.value for figure in figures(ending)), digits)
    assert high >= round(max(figure.value for figure in figures(ending)), digits)
    assert low > min(figure.low for figure in figures(ending)) - step
    assert high < max(figure.high for figure in figures(ending)) + step


def test_what_the_main_process_is_busy_follows_from_what_a_chunk_costs():
    least, of_each = said(r"c = max\((\S+) s, (\S+) s \* n\)")
    assert least == SECONDS
    costs = [said(pattern) for pattern in RANGES.values()]
    for workers, chunk, *busy in rows("workers"):
        count, taken = int(workers), float(chunk.removesuffix(" s"))
        exact = max(least, of_each * count)
        assert taken == pytest.approx(exact, rel=0.03)
        for range_, milliseconds in zip(busy, costs, strict=True):
            shares = [float(share) for share in range_.removesuffix(" %").split(" to ")]
            shares = shares * 2 if len(shares) == 1 else shares
            assert shares == pytest.approx([0.1 * count * h / exact for h in milliseconds], abs=0.51)


def test_what_the_main_process_can_store_is_what_was_measured():
    [millions] = said(MILLIONS)
    figure = FIGURES[STORED]
    assert round(figure.low) <= millions <= round(figure.high)


def test_the_workers_that_the_store_can_serve_follow_from_it():
    [millions] = said(MILLIONS)
    stated = [
        [float(number) for number in found]
        for found in re.findall(r"(\d+) numbers in (\S+) ms\),?\sgives? (\d+) on a\score", PAGE)
    ]
    assert len(stated) == len(CORE_TIMES)
    for name, (per_trial, milliseconds, of_a_core) in zip(CORE_TIMES, stated, strict=True):
        assert of_a_core == pytest.approx(1e3 * per_trial / milliseconds, rel=0.03)
        if name in FIGURES:
            assert FIGURES[name].low - 0.01 < milliseconds < FIGURES[name].high + 0.01
    (*_, few), (*_, many) = stated
    [share, workers] = said(
        r"1024 cores bring\s(\d+) %[^:]*? about (\d+) cores bring all".replace(" ", r"\s")
    )
    assert share == pytest.approx(1e-4 * 1024 * few / millions, rel=0.05)
    assert workers == pytest.approx(1e6 * millions / many, rel=0.05)


@pytest.mark.parametrize("name", [name for name in CORE_TIMES if name in FIGURES])
def test_a_core_time_is_what_was_measured(name):
    [row] = [row for row in rows("10^6 trials of") if row[0] == CORE_TIMES[name]]
    digits = len(row[1].removesuffix(" min").partition(".")[2])
    # A millisecond for a trial is 1000 s for all.
    low, high = (round(of_trial / 0.06, digits) for of_trial in (FIGURES[name].low, FIGURES[name].high))
    assert low <= core_time(row) <= high


def test_the_time_on_many_cores_follows_from_that_of_one():
    for row in rows("10^6 trials of"):
        for cores, cell in zip((64, 1024), row[2:], strict=True):
            stated = float(cell.removesuffix(" s and the rest"))
            assert stated == pytest.approx(60.0 * core_time(row) / cores, abs=0.51)


def core_time(row):
    return float(row[1].removesuffix(" min"))
