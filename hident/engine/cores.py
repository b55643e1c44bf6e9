"""How many cores this process may use: by its affinity, and by the processor time that a container has."""

from __future__ import annotations

import math
import os
from pathlib import Path


def usable_cores(root: Path = Path("/")) -> int:
    """The cores that this process may use, at least one; ``root`` is where /proc and /sys stand."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quota = cpu_quota(root)
    return cores if quota is None else max(1, min(cores, math.ceil(quota)))


def cpu_quota(root: Path = Path("/")) -> float | None:
    """How many cores' time the control groups of Linux, version 1 or 2, leave to this process.

    None where nothing limits it.
    """
    try:
        lines = (root / "proc/self/cgroup").read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        return None
    found = []
    for line in lines:
        _, _, rest = line.partition(":")
        controllers, _, path = rest.partition(":")
        mount = root / "sys/fs/cgroup" / controllers
        if controllers and "cpu" not in controllers.split(","):
            continue
        # In a container the path may be the one outside; the limit then stands at the mount itself.
        group = mount / path.lstrip("/")
        groups = [group, *group.parents[: len(group.parts) - len(mount.parts)]]
        found += [quota for at in {*groups, mount} if (quota := _quota(at)) is not None]
    return min(found, default=None)


def _quota(group: Path) -> float | None:
    """The quota of one group, in cores."""
    try:
        if (group / "cpu.max").exists():
            quota, period = (group / "cpu.max").read_text(encoding="utf-8").split()
        else:
            quota = (group / "cpu.cfs_quota_us").read_text(encoding="utf-8")
            period = (group / "cpu.cfs_period_us").read_text(encoding="utf-8")
        cores = int(quota) / int(period)
    except (OSError, ValueError, ZeroDivisionError):
        return None
    return cores if cores > 0 else None
