"""Code that is edited while a run or a notebook goes on: what is stored is of the code that computed it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.conftest import HOLD
from tests.forked import GUARD_SECONDS

if TYPE_CHECKING:
    from tests.conftest import Lab

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="signals and /proc")
# Both are exact.
_OLD, _NEW = "value *= 1.0", "value *= 2.00"
_HELD = 'Path(f"worker-{os.getpid()}").touch()\n' + HOLD + _OLD


def _edit(file: Path, old: str = _OLD, new: str = _NEW) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


def _values(lab: Lab, config: str = "tiny") -> bytes:
    return (lab.folder / "out" / config / "trials.csv.xz").read_bytes()


def _anew(lab: Lab, config: str = "tiny") -> bytes:
    """What a run without a store gives."""
    found = ("--out", "anew", "--store", "anew", "--jobs", "1", "-q")
    lab.hident("run", f"{config}.yaml", "--plugin", "other.py", *found)
    return (lab.folder / "anew" / config / "trials.csv.xz").read_bytes()


def test_a_plugin_that_is_edited_before_its_configuration_has_its_turn(lab: Lab) -> None:
    lab.probe(_HELD)
    other = (lab.folder / "probe.py").read_text().replace('"probe"', '"other"').replace('"square"', '"cube"')
    (lab.folder / "other.py").write_text(other.replace("len(record) == 80", "False"))
    lab.configure("next", estimators={"other": "other"})
    old = _anew(lab, "next")
    (lab.folder / "hold").touch()
    process = lab.start("run", "tiny.yaml", "next.yaml", "--plugin", "other.py", "--jobs", "1", "-q")
    lab.await_((lab.folder / "reached").exists)
    _edit(lab.folder / "other.py")
    (lab.folder / "hold").unlink()
    assert process.wait() == 0, lab.log
    assert _values(lab, "next") == old
    (lab.folder / "anew/trials.sqlite").unlink()
    lab.hident("run", "next.yaml", "--plugin", "other.py", "--jobs", "1", "-q")
    assert _values(lab, "next") == _anew(lab, "next") != old


def test_a_worker_that_takes_the_place_of_another_computes_with_no_newer_code(lab: Lab) -> None:
    lab.probe(_HELD)
    (lab.folder / "other.py").write_text("")
    (lab.folder / "hold").touch()
    process = lab.start("run", "tiny.yaml", "--jobs", "2", "-q")
    lab.await_((lab.folder / "reached").exists)
    _edit(lab.folder / "probe.py")
    os.kill(int(next(lab.folder.glob("worker-*")).name.partition("-")[2]), signal.SIGKILL)
    assert process.wait() == 2, lab.log
    assert f"{lab.folder / 'probe.py'} is not what the run began with: it was changed meanwhile" in lab.log
    (lab.folder / "hold").unlink()
    lab.run("-q")
    assert _values(lab) == _anew(lab)


def test_a_neighbour_that_is_edited_before_a_trial_imports_it(lab: Lab) -> None:
    lab.probe("import neighbour\n" + HOLD + "import lazy\nvalue += lazy.MORE")
    for name in ("neighbour", "lazy"):
        (lab.folder / f"{name}.py").write_text("MORE = 0\n")
    lab.configure(cases={"samples": [80]})
    (lab.folder / "hold").touch()
    process = lab.start("run", "tiny.yaml", "--jobs", "1", "-q")
    lab.await_((lab.folder / "reached").exists)
    _edit(lab.folder / "lazy.py", "0", "1000")
    (lab.folder / "hold").unlink()
    assert process.wait() == 3
    assert f"{lab.folder / 'lazy.py'} is not what the run began with" in lab.log
    assert not any(estimator == "probe" for estimator, _, _ in lab.trials())


_NOTEBOOK = """
import importlib, sys
import hident as hi
import mine, yaml

def values(made="probe"):
    experiment = yaml.safe_load(open("tiny.yaml"))
    experiment["estimators"]["probe"] = made
    found = hi.run(experiment, store=".hident").trials_frame()
    return found[found.estimator == "probe"].iloc[:, -1].tolist()

def edit(old, new):
    text = open("mine.py").read()
    open("mine.py", "w").write(text.replace(old, new))

"""
_RELOADED = """
before, made = values(), mine.Probe()
edit("value *= 1.0", "value *= 2.00")
importlib.reload(mine)
assert values() == [2 * value for value in before]
assert values(made) == [2 * value for value in before]
edit("value *= 2.00", "value *= 1.0")
importlib.reload(mine)
assert values() == before
"""
_EDITED = """
edit("value *= 1.0", "value *= 2.00")
print(repr(values()))
"""
_LATER = "print(repr([value / 2 for value in values()]))"


def _notebook(lab: Lab, code: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", _NOTEBOOK + code],
        cwd=lab.folder,
        capture_output=True,
        text=True,
        timeout=GUARD_SECONDS,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture
def notebook(lab: Lab) -> Lab:
    lab.probe(_OLD)
    (lab.folder / "probe.py").rename(lab.folder / "mine.py")
    return lab


def test_a_module_that_is_loaded_again_is_computed_anew(notebook: Lab) -> None:
    _notebook(notebook, _RELOADED)


def test_a_module_that_is_edited_and_not_loaded_again_is_stored_as_what_is_loaded(notebook: Lab) -> None:
    assert _notebook(notebook, _EDITED) == _notebook(notebook, _LATER)
