"""Standard streams that are closed, full, left by their reader or poor in letters end no program."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from hident.config.load import read
from tests.forked import Forked

if TYPE_CHECKING:
    from tests.conftest import Lab

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="descriptors of POSIX")

# Each verb in one process, as a process for each would take most of the time to start.
_ALL_VERBS = """
import sys
from pathlib import Path
from hident import cli

def main():
    codes = {}
    for line in Path("verbs.txt").read_text().splitlines():
        sys.argv = ["hident", *line.split()]
        try:
            cli.main()
        except SystemExit as end:
            codes[line] = int(end.code)
    Path("codes.txt").write_text(repr(codes))


# Worker processes import this file.
if __name__ == "__main__":
    main()
"""
_VERBS = {
    "--help": 0,
    "list": 0,
    "list estimators kernel": 0,
    "validate tiny.yaml --plugin probe.py": 0,
    "run tiny.yaml --plugin probe.py --jobs {jobs}": 0,
    "status tiny.yaml --plugin probe.py": 0,
    "accept tiny --plugin probe.py --jobs 1 --perturbations 1": 0,
    "compare": 0,
    "verify": 4,
    "schema": 0,
    "export tiny.yaml trials.csv --plugin probe.py": 0,
    "doctor": 0,
    "validate none.yaml": 2,
    "frobnicate": 2,
}


@pytest.fixture
def quick(lab: Lab) -> Lab:
    """A laboratory whose trials need no library that is slow to import."""
    lab.probe()
    return lab


def _sh(lab: Lab, command: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """A command of the shell, in which $H is the program, and the exit code that of its first part."""
    program = f"{sys.executable} -m hident"
    return subprocess.run(
        ["bash", "-c", f'set -o pipefail; H="{program}"; {command}'],
        cwd=lab.folder,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_run_whose_reader_goes_away_writes_everything(quick: Lab, unbuffered: str) -> None:
    run = "$H run tiny.yaml --plugin probe.py -j1"
    done = _sh(quick, f"{run} 2>&1 | head -n 1", PYTHONUNBUFFERED=unbuffered)
    assert (done.returncode, done.stdout, done.stderr) == (0, "tiny: 24 trials\n", "")
    written = {path.name for path in (quick.folder / "out/tiny").iterdir()}
    assert {"table.csv", "table.md", "run.json"} <= written


@pytest.mark.parametrize(
    ("streams", "jobs", "environment"),
    [
        ("<&- >&- 2>&-", 2, {}),
        (">out.txt 2>err.txt", 1, {"PYTHONIOENCODING": "ascii"}),
        (">out.txt 2>err.txt", 1, {"PYTHONIOENCODING": "cp1252:strict", "LC_ALL": "C"}),
    ],
)
def test_every_verb_works(quick: Lab, streams: str, jobs: int, environment: dict[str, str]) -> None:
    verbs = {verb.format(jobs=jobs): code for verb, code in _VERBS.items()}
    quick.configure(title="Étude ∂ → 𝄞")
    (quick.folder / "all.py").write_text(_ALL_VERBS)
    (quick.folder / "verbs.txt").write_text("\n".join(verbs))
    done = _sh(quick, f"{sys.executable} all.py {streams}", **environment)
    assert done.returncode == 0
    assert (quick.folder / "codes.txt").read_text() == repr(verbs)
    for name in ("out.txt", "err.txt"):
        if (quick.folder / name).exists():
            assert b"Traceback" not in (quick.folder / name).read_bytes()
    # No file of the run was mistaken for a stream.
    assert read(quick.folder / "tiny.yaml").data["title"] == "Étude ∂ → 𝄞"
    assert json.loads((quick.folder / "out/tiny/run.json").read_text())["experiment"]["trials"] == 6


@pytest.mark.parametrize("encoding", ["ascii", "cp1252", "utf-8"])
def test_the_schema_is_sound_in_every_encoding(lab: Lab, encoding: str) -> None:
    (lab.folder / "p.py").write_text(
        "from hident.config.spec import component\nfrom hident.estimators.base import EstimatorSpec\n"
        "@component('estimator', 'odd')\nclass Odd(EstimatorSpec):\n"
        "    '''Odd.'''\n    size: int = 1\n    '''é ∂ 𝄞'''\n",
        encoding="utf-8",
    )
    with (lab.folder / "schema.json").open("wb") as file:
        environment = os.environ | {"PYTHONIOENCODING": encoding}
        assert Forked(["schema", "--plugin", "p.py"], lab.folder, file, file, environment).wait() == 0
    schema = json.loads((lab.folder / "schema.json").read_text(encoding=encoding))
    assert "é ∂ 𝄞" in json.dumps(schema, ensure_ascii=False)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_is_told_apart_from_a_reader_that_has_gone(quick: Lab) -> None:
    done = _sh(quick, "$H validate tiny.yaml --plugin probe.py > /dev/full")
    said = "error: standard output cannot be written (no space left on device)\n"
    assert (done.returncode, done.stderr) == (2, said)
    done = _sh(quick, "$H run tiny.yaml --plugin probe.py -j1 > /dev/full 2> /dev/full")
    assert done.returncode == 2
    assert (quick.folder / "out/tiny/run.json").exists()


# The exceptions are raised one after the other in one process.
_ALL_FAULTS = """
import sys, tempfile
from pathlib import Path
from hident import cli
from hident.commands import listing

def full(*arguments, **options):
    raise OSError(28, "no room")

codes = []
for raised in Path("faults.txt").read_text().splitlines():
    def broken(*arguments):
        if raised.endswith("# no room"):
            tempfile.NamedTemporaryFile = full
        raise eval(raised)
    listing.print_listing = broken
    sys.argv = ["hident", "list", "estimators"]
    try:
        cli.main()
    except SystemExit as end:
        codes.append(int(end.code))
print(codes)
"""
_FAULTS = {
    "ValueError('half a pair: \\ud800,\\ntwo lines')": "ValueError: half a pair: \\ud800, two lines",
    "BrokenPipeError(32, 'of a worker')": "BrokenPipeError: [Errno 32] of a worker",
    "EOFError()": "EOFError",
    "type('Odd', (BaseException,), {'__str__': None})()": "Odd: <exception str() failed>",
}


def test_an_unforeseen_exception_has_its_own_exit_code_and_a_file(lab: Lab) -> None:
    (lab.folder / "all.py").write_text(_ALL_FAULTS)
    (lab.folder / "faults.txt").write_text(
        "\n".join(
            [
                *_FAULTS,
                "KeyboardInterrupt",
                "OSError(24, 'Too many')",
                "MemoryError()",
                "KeyError('a')  # no room",
            ]
        )
    )
    done = _sh(lab, f"{sys.executable} all.py", TMPDIR=str(lab.folder))
    assert done.stdout == "[70, 70, 70, 70, 130, 2, 2, 70]\n"
    lines = done.stderr.splitlines()
    for line, said in zip(lines, _FAULTS.values(), strict=False):
        start = f"error: unforeseen, a fault of hident: {said}; the traceback is in "
        assert line.startswith(start)
        file = Path(line.removeprefix(start))
        assert file.parent == lab.folder
        text = file.read_text(encoding="utf-8")
        assert "Traceback (most recent call last)" in text
        assert "['list', 'estimators']" in text
    for line, said in zip(lines[4:6], ("Too many", "out of memory"), strict=True):
        assert line.startswith(f"error: the system gives this program no more ({said}): raise its limits")
    # Without a file the traceback itself is shown.
    assert lines[6] == "error: unforeseen, a fault of hident: KeyError: 'a'; the traceback:"
    assert lines[7] == "Traceback (most recent call last):"
    assert "KeyError: 'a'" in lines[-1] or "KeyError: 'a'" in lines[-2]


def test_workers_start_where_the_temporary_folder_has_a_long_name(quick: Lab) -> None:
    long = quick.folder / ("x" * 110)
    long.mkdir()
    assert _sh(quick, "$H run tiny.yaml --plugin probe.py -j2 -q", TMPDIR=str(long)).returncode == 0
    assert (quick.folder / "out/tiny/run.json").exists()


def test_an_unknown_arithmetic_is_refused(lab: Lab) -> None:
    done = _sh(lab, "$H list", HIDENT_ARITHMETIC="fast")
    said = "error: HIDENT_ARITHMETIC must be pinned or native (got 'fast')\n"
    assert (done.returncode, done.stdout, done.stderr) == (2, "", said)
