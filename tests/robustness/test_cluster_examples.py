"""The scripts of docs/scale.md for clusters that are not here: what they would submit can be started."""

from __future__ import annotations

import shlex
import subprocess
import sys
from typing import Any

import pytest

from tests.documented import blocks
from tests.forked import GUARD_SECONDS


def _script(name: str) -> str:
    """A script of the page up to where it runs trials, as code to execute."""
    [code] = [block for block in blocks("docs/scale.md", "python") if block.startswith(f"# {name}\n")]
    assert "    with Client(cluster) as client:\n" in code
    return code.partition("    with Client(cluster) as client:\n")[0]


def _starts(command: list[str]) -> None:
    """A command of a worker or a scheduler, but for its place and its name, is one that can be started."""
    done = subprocess.run(
        [sys.executable, *command[1:], "--help"],
        capture_output=True,
        text=True,
        timeout=GUARD_SECONDS,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "Usage" in done.stdout


def test_what_is_submitted_to_slurm() -> None:
    pytest.importorskip("dask_jobqueue")
    code = _script("on_slurm.py").replace("cluster.scale(jobs=4)", "print(cluster.job_script())")
    # Dask's threads are not for this process, which later tests fork.
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=GUARD_SECONDS, check=True
    )
    lines = done.stdout.strip().splitlines()
    assert {"#SBATCH -A my-account", "#SBATCH -p standard", "#SBATCH --cpus-per-task=32"} <= {*lines}
    command = shlex.split(lines[-1])
    assert command[:5] == [sys.executable, "-m", "hident.pinned", "-m", "distributed.cli.dask_worker"]
    assert command[command.index("--nthreads") + 1] == "1"
    assert command[command.index("--nworkers") + 1] == "32"
    _starts(command[:5])


def test_what_is_submitted_to_kubernetes(monkeypatch: pytest.MonkeyPatch) -> None:
    operator = pytest.importorskip("dask_kubernetes.operator")
    client = pytest.importorskip("kubernetes.client")
    monkeypatch.setattr(operator, "KubeCluster", lambda custom_cluster_spec: custom_cluster_spec)
    found: dict[str, Any] = {"__name__": "__main__"}
    exec(_script("on_kubernetes.py"), found)
    spec = found["cluster"]["spec"]
    assert spec["worker"]["replicas"] == 64
    read = client.ApiClient()._ApiClient__deserialize
    pods = {part: read({"spec": spec[part]["spec"]}, "V1Pod") for part in ("worker", "scheduler")}
    for pod in pods.values():
        [container] = pod.spec.containers
        assert container.image == "registry.example.org/me/hident:1"
        assert container.resources.limits == {"cpu": "1", "memory": "1Gi"}
        _starts([part for part in container.args if part not in ("--name", "$(DASK_WORKER_NAME)")])
