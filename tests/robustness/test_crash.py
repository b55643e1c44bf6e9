"""Crashes of trials, and of the processes that run them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.conftest import Lab

# Some trials with 80 samples crash: those whose input begins above zero.
_CRASH = """
if len(record) == 80 and record.u[0] > 0:
    raise ValueError("a crash\\nof two lines")
"""


def _probed(lab: Lab, case: int) -> int:
    return sum(unit == "probe" and str(case) in described for unit, described, _ in lab.trials())


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_crash_is_told_kept_out_and_repaired(lab: Lab, jobs: str) -> None:
    lab.probe(_CRASH)
    said = lab.run("--jobs", jobs, code=3)
    lines = said.splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("error: "))
    assert lines[at].startswith("error: tiny: trial ")
    assert "of estimator 'probe' at samples 80 crashed" in lines[at]
    assert lines[at].endswith(": ValueError: a crash")
    assert lines[at + 1 :] == [
        "of two lines",
        "All finished trials are kept; a run after the repair resumes.",
        "Tracebacks: out/tiny/crashes.txt",
    ]
    tracebacks = (lab.folder / "out/tiny/crashes.txt").read_text()
    assert "Traceback (most recent call last)" in tracebacks
    assert 'raise ValueError("a crash' in tracebacks
    assert [path.name for path in (lab.folder / "out/tiny").iterdir()] == ["crashes.txt"]
    assert _probed(lab, 50) == 6
    assert _probed(lab, 80) < 6


def test_keep_going_finishes_the_rest_and_a_repair_needs_the_rest_only(lab: Lab) -> None:
    # The file stands for what a repair changes without changing a number.
    lab.probe("if not Path('repaired').exists():" + _CRASH.replace("\n", "\n    "))
    said = lab.run("--keep-going", code=3)
    crashed = 12 - _probed(lab, 50) - _probed(lab, 80)
    assert 0 < crashed < 6
    assert f"crashed (and {crashed - 1} more): ValueError" in said
    tracebacks = (lab.folder / "out/tiny/crashes.txt").read_text()
    assert tracebacks.count("Traceback") == crashed
    assert not (lab.folder / "out/tiny/table.csv").exists()
    before = lab.trials()

    (lab.folder / "repaired").touch()
    assert f"24 trials, {24 - crashed} of them stored" in lab.run()
    assert before.items() <= lab.trials().items()
    assert not (lab.folder / "out/tiny/crashes.txt").exists()
    resumed = lab.table
    lab.forget()
    lab.run()
    assert lab.table == resumed


def test_crash_stops_the_configurations_that_follow_unless_told_to_keep_going(lab: Lab) -> None:
    lab.probe(_CRASH)
    lab.configure("zfine", cases={"samples": [50]})
    said = lab.hident("run", "tiny.yaml", "zfine.yaml", "-j1", code=3).stderr
    assert "zfine" not in said
    said = lab.hident("run", "tiny.yaml", "zfine.yaml", "-j1", "--keep-going", code=3).stderr
    assert "zfine: wrote out/zfine" in said


def _deadly(lab: Lab, end: str) -> None:
    """Let the estimate of trial 2 with 80 samples end its process; a file counts how often."""
    noted = 'with open("inputs", "a") as file:\n    print(len(record), float(record.u[0]), file=file)'
    lab.probe(noted)
    lab.run("-q")
    inputs = [line.split() for line in (lab.folder / "inputs").read_text().splitlines()]
    [at] = [first for samples, first in inputs if samples == "80"][2:3]
    lab.forget()
    lab.probe(f"""
        if len(record) == 80 and record.u[0] == {at}:
            with open("deaths", "ab") as file:
                file.write(b".")
            {end}
    """)


_ENDED = (
    "error: tiny: trial 2 of estimator 'probe' at samples 80 crashed: its worker process ended abruptly "
    "({how})\nAll finished trials are kept; a run after the repair resumes.\n"
    "Tracebacks: out/tiny/crashes.txt\n"
)


@pytest.mark.parametrize(
    ("end", "how"),
    [
        ("os._exit(9)", "exit code 9"),
        ("os.kill(os.getpid(), 9)", "signal 9"),
        ("os.kill(os.getpid(), 11)", "signal 11"),
    ],
)
def test_a_trial_that_ends_three_workers_is_a_crash_and_the_rest_is_kept(
    lab: Lab, end: str, how: str
) -> None:
    _deadly(lab, end)
    assert lab.run("--jobs", "2", "--keep-going", code=3).endswith(_ENDED.format(how=how))
    assert (lab.folder / "deaths").stat().st_size == 3
    assert (_probed(lab, 50), _probed(lab, 80), len(lab.trials())) == (6, 5, 23)
    assert [path.name for path in (lab.folder / "out/tiny").iterdir()] == ["crashes.txt"]
    lab.await_alone()


def test_a_trial_that_ends_its_workers_ends_the_run_without_keep_going(lab: Lab) -> None:
    _deadly(lab, "os.kill(os.getpid(), 9)")
    assert lab.run("--jobs", "2", code=3).endswith(_ENDED.format(how="signal 9"))
    assert _probed(lab, 50) == 6
    lab.await_alone()


def test_workers_that_are_killed_once_or_twice_are_replaced(lab: Lab) -> None:
    """As for want of memory: the trial is sent again, in the end alone, and then succeeds."""
    _deadly(lab, 'if Path("deaths").stat().st_size < 3: os.kill(os.getpid(), 9)')
    lab.run("-q", "--jobs", "2")
    assert (lab.folder / "deaths").stat().st_size == 3
    lab.await_alone()
    killed = lab.table
    lab.forget()
    lab.probe()
    lab.run("-q")
    assert lab.table == killed


def test_exit_called_in_an_estimator_is_a_crash(lab: Lab) -> None:
    lab.probe("sys.exit('enough')")
    assert "of estimator 'probe' at samples 50 crashed: SystemExit: enough\n" in lab.run(code=3)


def test_plugin_that_cannot_be_imported_by_workers(lab: Lab) -> None:
    lab.probe()
    plugin = lab.folder / "probe.py"
    plugin.write_text(
        plugin.read_text() + "\nimport multiprocessing\n"
        "if multiprocessing.parent_process():\n    raise RuntimeError('not here')\n"
    )
    said = lab.run("--jobs", "2", code=2)
    assert "error: plugin probe.py cannot be loaded: RuntimeError: not here" in said


def test_plugin_that_cannot_be_sent_to_workers(lab: Lab) -> None:
    lab.probe()
    plugin = lab.folder / "probe.py"
    before, after = plugin.read_text().split("@component", maxsplit=1)
    inner = "".join(f"    {line}\n" for line in ("@component" + after).splitlines())
    plugin.write_text(f"{before}def hidden():\n{inner}\nhidden()\n")
    said = lab.run("--jobs", "2", code=2)
    assert "error: a component cannot be sent to worker processes" in said
    assert "define its class at the top level of its module, or run with --jobs 1" in said
    lab.run("--jobs", "1")


def test_what_an_estimator_does_to_its_process_does_not_disturb_the_run(lab: Lab) -> None:
    lab.probe()
    lab.run("-q")
    undisturbed = lab.table
    lab.forget()
    lab.probe("os.chdir('/')\nsys.stdout.close()\nsys.stderr.close()")
    done = lab.hident("run", "tiny.yaml", "-j1")
    assert done.stdout.startswith("# Tiny")
    assert "tiny: wrote out/tiny" in done.stderr
    assert lab.table == undisturbed


def test_an_interrupt_that_an_estimator_raises_is_a_crash_in_a_worker(lab: Lab) -> None:
    lab.probe("if len(record) == 80:\n    raise KeyboardInterrupt")
    said = lab.run("--keep-going", "--jobs", "2", code=3)
    assert "at samples 80 crashed (and 5 more): KeyboardInterrupt" in said
    assert _probed(lab, 50) == 6
