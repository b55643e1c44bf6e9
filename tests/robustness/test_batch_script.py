"""The batch script of docs/scale.md, with a `srun` that starts its tasks on this machine."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.documented import ROOT, blocks
from tests.forked import GUARD_SECONDS

if TYPE_CHECKING:
    from tests.conftest import Lab

pytest.importorskip("distributed")
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(sys.platform != "linux", reason="signals and /proc"),
    pytest.mark.skipif(not Path(sys.executable).with_name("dask").exists(), reason="no `dask` beside python"),
]

_TASKS = 2
# Its options come first; told to end, the real one ends its tasks too, those that linger by SIGKILL.
_SRUN = f"""#!/bin/bash
while [[ $1 == --* ]]; do shift; done
trap 'kill -KILL $(jobs -p); wait' TERM
for task in $(seq {_TASKS}); do "$@" & done
wait
"""


@pytest.fixture
def job(lab: Lab) -> Lab:
    """A folder with hident.sbatch, my.yaml, and a home that has an environment."""
    lab.configure(name="my", trials=7)
    [script] = [block for block in blocks("docs/scale.md", "bash") if "#SBATCH" in block]
    assert script.count("--trials 100000") == 1
    (lab.folder / "hident.sbatch").write_text(script.replace("--trials 100000", "--trials 20"))
    environment = lab.folder / "home/hident-env/bin"
    environment.mkdir(parents=True)
    programs = [str(Path(sys.executable).parent), str(lab.folder / "bin")]
    (environment / "activate").write_text(f"export PATH={os.pathsep.join(programs)}:$PATH\n")
    (lab.folder / "bin").mkdir()
    (lab.folder / "bin/srun").write_text(_SRUN)
    (lab.folder / "bin/srun").chmod(0o755)
    return lab


def _submit(lab: Lab) -> subprocess.Popen[bytes]:
    with (lab.folder / "log.txt").open("wb") as log:
        return subprocess.Popen(
            ["bash", "hident.sbatch"],
            cwd=lab.folder,
            env=os.environ
            | {
                "HOME": str(lab.folder / "home"),
                "SLURM_JOB_ID": "17",
                "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
            },
            stdout=log,
            stderr=log,
            start_new_session=True,
        )


def _files(lab: Lab) -> list[bytes]:
    return [(lab.folder / "out/my" / name).read_bytes() for name in ("table.csv", "trials.csv.xz")]


def test_a_job_gives_what_one_process_gives_and_ends(job: Lab) -> None:
    assert _submit(job).wait(GUARD_SECONDS) == 0, job.log
    assert "warning" not in job.log
    job.await_alone()
    assert not [*job.folder.glob("scheduler-*")]
    assert {"out", ".hident", "log.txt"} <= {path.name for path in job.folder.iterdir()}
    found = _files(job)
    job.forget()
    job.hident("run", "my.yaml", "--trials", "20", "--jobs", "1", "-q")
    assert _files(job) == found


def test_what_is_wrong_with_a_configuration_is_the_jobs_exit_code(job: Lab) -> None:
    (job.folder / "my.yaml").write_text("version: 1\ntitle: Nothing\n")
    assert _submit(job).wait(GUARD_SECONDS) == 2
    assert "error: my.yaml" in job.log
    job.await_alone()
