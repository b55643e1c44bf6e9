"""Full disks, folders that are read-only, files where folders belong; with room again, a run ends well."""

from __future__ import annotations

import ctypes
import os
import random
import resource
import signal
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

from tests.torture.victim import Lost, Tally, Victim, new_victim

COUNT = 20
_TRIALS = 500
_DAC_OVERRIDE, _DAC_READ_SEARCH = 1, 2


def torture(tally: Tally, rng: random.Random, count: int) -> None:
    """Limit the size of files ``count`` times, that of a disk a quarter as often; each other fault once."""
    with new_victim(_TRIALS) as victim:
        for _ in range(count):
            size = int(10 ** rng.uniform(2.5, 5.5))
            with tally.fault("files no longer than a limit", f"{size} bytes"):
                _then_room(victim, lambda: _limited(victim, size), ("0", "2"))  # noqa: B023
        for folder in (".hident", "out"):
            for _ in range(max(1, count // 4)):
                with tempfile.TemporaryDirectory() as name:
                    mounted = subprocess.run(
                        ["mount", "-t", "tmpfs", "tmpfs", name], capture_output=True, check=False
                    )
                    if mounted.returncode:
                        tally.notes.append("no disks were filled: mounting is not allowed here")
                        return
                    subprocess.run(["umount", name], check=True)
                size = int(10 ** rng.uniform(3.7, 5.3))
                with tally.fault(f"full disk for {folder}", f"{size} bytes"):
                    _on_small_disk(victim, folder, size)
        for folder in (".hident", "out", "out/tiny"):
            with tally.fault("read-only folder", folder):
                _read_only(victim, folder)
            with tally.fault("a file where a folder belongs", folder):
                _a_file(victim, folder)


def _then_room(victim: Victim, disturbed: Callable[[], int], codes: tuple[str, ...] = ("2",)) -> None:
    victim.forget()
    code = disturbed()
    assert str(code) in codes, f"exit code {code}"
    _with_room(victim)


def _with_room(victim: Victim) -> None:
    stored = victim.stored()
    made = victim.check_ending()
    if made > victim.units - stored:
        raise Lost(f"{stored} of {victim.units} were stored, and {made} computed after that")


def _limited(victim: Victim, size: int) -> int:
    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    return _code(victim, limit)


def _code(victim: Victim, prepare: Callable[[], object] = lambda: None) -> int:
    done = victim.hident("run", "tiny.yaml", "-j1", "-q", code=None, preexec_fn=prepare)
    assert done.returncode == 0 or done.stderr.startswith("error: "), done.stderr
    assert done.stderr.count("\n") <= 2, done.stderr
    return done.returncode


def _on_small_disk(victim: Victim, folder: str, size: int) -> None:
    victim.forget()
    place = victim.folder / folder
    place.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", place], check=True)
    try:
        code = _code(victim)
        assert code in (0, 2), f"exit code {code}"
        subprocess.run(["mount", "-o", "remount,size=64m", place], check=True)
        _with_room(victim)
    finally:
        subprocess.run(["umount", place], check=True)


def _read_only(victim: Victim, folder: str) -> None:
    victim.forget()
    place = victim.folder / folder
    place.mkdir(parents=True)
    place.chmod(0o555)
    try:
        code = _code(victim, _without_override)
        assert code == 2, f"exit code {code}"
    finally:
        place.chmod(0o755)
    _with_room(victim)


def _without_override() -> None:
    """Root too may then write only where the mode of the folder says so."""
    if os.geteuid() != 0:
        return
    version, kept = 0x20080522, 0xFFFFFFFF & ~(1 << _DAC_OVERRIDE | 1 << _DAC_READ_SEARCH)
    header = (ctypes.c_uint32 * 2)(version, 0)
    data = (ctypes.c_uint32 * 6)()
    libc = ctypes.CDLL(None, use_errno=True)
    libc.capget(header, data)
    for i in (0, 1, 2):
        data[i] &= kept
    if libc.capset(header, data):
        raise OSError(ctypes.get_errno(), "capset")


def _a_file(victim: Victim, folder: str) -> None:
    victim.forget()
    place = victim.folder / folder
    place.parent.mkdir(exist_ok=True)
    place.write_text("something else")
    code = _code(victim)
    assert code == 2, f"exit code {code}"
    assert place.read_text() == "something else"
    Path(place).unlink()
    _with_room(victim)
