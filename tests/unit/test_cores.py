"""Usable cores: a container's quota of processor time counts, under both versions of control groups."""

import os

import pytest

from hident.engine.cores import cpu_quota, usable_cores

ALL = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()


@pytest.fixture
def machine(tmp_path):
    """Writes files of a pretended machine, and returns its root."""

    def write(files):
        for name, text in files.items():
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        return tmp_path

    return write


V2 = {"proc/self/cgroup": "0::/a/b\n"}
V1 = {"proc/self/cgroup": "11:cpu,cpuacct:/docker/c\n3:memory:/docker/c\n1:name=systemd:/x\n"}
GROUP = "sys/fs/cgroup"


@pytest.mark.parametrize(
    ("files", "quota"),
    [
        ({}, None),
        (V2, None),
        (V2 | {f"{GROUP}/a/b/cpu.max": "max 100000\n"}, None),
        (V2 | {f"{GROUP}/a/b/cpu.max": "150000 100000\n"}, 1.5),
        # The limit of a group around it holds too.
        (V2 | {f"{GROUP}/a/b/cpu.max": "max 100000\n", f"{GROUP}/a/cpu.max": "50000 100000\n"}, 0.5),
        # Inside a container its group is the root.
        ({"proc/self/cgroup": "0::/\n", f"{GROUP}/cpu.max": "200000 100000\n"}, 2.0),
        ({"proc/self/cgroup": "0::/../..\n", f"{GROUP}/cpu.max": "200000 100000\n"}, 2.0),
        (
            V1
            | {
                f"{GROUP}/cpu,cpuacct/docker/c/cpu.cfs_quota_us": "250000\n",
                f"{GROUP}/cpu,cpuacct/docker/c/cpu.cfs_period_us": "100000\n",
            },
            2.5,
        ),
        # The path is the one outside of the container.
        (
            V1
            | {
                f"{GROUP}/cpu,cpuacct/cpu.cfs_quota_us": "100000\n",
                f"{GROUP}/cpu,cpuacct/cpu.cfs_period_us": "100000\n",
            },
            1.0,
        ),
        (
            V1
            | {
                f"{GROUP}/cpu,cpuacct/docker/c/cpu.cfs_quota_us": "-1\n",
                f"{GROUP}/cpu,cpuacct/docker/c/cpu.cfs_period_us": "100000\n",
            },
            None,
        ),
        (V2 | {f"{GROUP}/a/b/cpu.max": "nonsense\n"}, None),
        (V2 | {f"{GROUP}/a/b/cpu.max": "1 0\n"}, None),
        ({"proc/self/cgroup": "nonsense\n"}, None),
    ],
)
def test_quota(machine, files, quota):
    assert cpu_quota(machine(files)) == quota


@pytest.mark.parametrize(
    ("limit", "cores"), [("10000 100000", 1), ("1000000000 100000", ALL), ("max 1", ALL)]
)
def test_usable_cores_are_those_of_the_quota_and_at_least_one(machine, limit, cores):
    assert usable_cores(machine(V2 | {f"{GROUP}/a/b/cpu.max": limit})) == cores


@pytest.mark.skipif((ALL or 1) < 2, reason="one core")
def test_a_part_of_a_core_is_one_more_worker(machine):
    assert usable_cores(machine(V2 | {f"{GROUP}/a/b/cpu.max": "110000 100000"})) == 2
