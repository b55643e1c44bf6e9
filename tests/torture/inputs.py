"""Bad input: the configurations of the papers, mutated; each is told what is wrong with it in time, or runs.

Mutations are of the data that a file holds, and of its text. All are given to the program's entry within this
process; some to the program itself, with little memory.
"""

from __future__ import annotations

import copy
import io
import os
import random
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from hident import cli
from hident.config.yaml12 import Reader
from tests.forked import ROOT, Forked
from tests.torture.victim import Tally

COUNT = 10_000
_SECONDS, _BYTES = 2.0, 300e6
_SOUND_SECONDS = 20.0
"""For what is sound: its first records are simulated, as those of the configuration that was mutated."""
_RUN_SECONDS = 20
CONFIGS = sorted((ROOT / "configs").glob("*.yaml"))

# fmt: off
_NUMBERS = [
    0, 1, -1, 2, 3, 7, 1e308, -1e308, 5e-324, -0.0, 0.5, 1.5, 1e-3, 1e9, -7, 10**9, 10**18, 2**63, 10**400,
    float("nan"), float("inf"), -float("inf"),
]
_EXTREMES = (1e308, -1e308, 5e-324, 1e-17, 1e17, 2**63)
_TEXTS = [
    "", " ", "x", "$", "$x", "${x}", "{x}", "{", "}", "a.b", ".", "..", "../x", "/", "\\", "é", "名",
    "\u202e", "%s",
    "null", "no", "true", "1e999", "0x1F", "12:30", "9**9**9", "2**-1", "1/0", "0**-1", "(-1)**0.5", "pi",
    "2*pi",
    "().__class__", "pi.real", "__import__('os')", "exec('1')", "lambda: 0", "[1][0]", "1 if 1 else 2",
    "f'{1}'",
    "1e308*10", "-" * 5000 + "1", "(" * 500 + "1" + ")" * 500, "1+" * 5000 + "1", "9" * 5000,
    "a" * 100_000, "x\n y",
    "kernel", "ar", "white", "samples", "mise", "all", "truth", "mean", "a_1", "trial", "estimator", "abs",
]
_ODD: list[Any] = [
    None, True, False, [], {}, [[]], [{}], {"kind": None}, {"kind": "ar"}, {"": 1}, {"<<": 1}, [None], [0],
    {"each": 1},
]
_WRITTEN = [
    "\t", "\ufeff", "\0", "\x07", "&a", "*a", "<<: *a", "!!python/object:os.system", "!x", "- ", "{", "}",
    "[", "]",
    ": ", "? ", "|", ">", "#", "---\n", "...\n", "%YAML 1.1\n", "'", '"', "\r", "\u2028", ",", "\n", "  ",
    "&a [*a]",
    "!!python/object/apply:os.system ['true']", "<<: {}", "<<: [1]", "0777", "1_000", "0b1", "=", "~",
]
# fmt: on
# The peak that the system tells of a process that ended begins at what its parent held.
_PROGRAM = """
import atexit, re, runpy, sys
peak = int(sys.argv.pop(1))
@atexit.register
def tell():
    with open("/proc/self/status") as status, open(peak, "w") as file:
        file.write(re.search(r"VmHWM:\\s*(\\d+) kB", status.read())[1])
runpy.run_module("hident", run_name="__main__", alter_sys=True)
"""
_NOT_YAML = re.compile(r"not valid|cannot be read|nested|more than|: file: |bytes")


def torture(tally: Tally, rng: random.Random, count: int, *, timed: bool = True) -> None:
    """Validate ``count`` mutations, one in a hundred of them afresh; run up to 3 % of the sound ones.

    Up to a quarter of ``count`` besides, each key's number at its extremes.
    """
    with tempfile.TemporaryDirectory(prefix="t") as name:
        folder = Path(name)
        (folder / "experiments").symlink_to(ROOT / "experiments")
        sound: list[bytes] = []
        _validate_many(tally, rng, count, folder, timed, sound)
        _validate_extremes(tally, rng, count, folder, timed)
        for path, content in bombs(folder):
            with tally.fault("bombs, by the program itself", path.name):
                path.write_bytes(content)
                _validate_afresh(path, timed)
                path.unlink()
        _run_some(tally, rng, max(3, 3 * count // 100), folder, sound)


def _validate_many(
    tally: Tally, rng: random.Random, count: int, folder: Path, timed: bool, sound: list[bytes]
) -> None:
    kinds = {"data": _mutated_data, "text": _mutated_text}
    path = folder / "mutated.yaml"
    base = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    for i in range(count):
        kind, config = rng.choice(sorted(kinds)), rng.choice(CONFIGS)
        content = kinds[kind](config, rng)
        path.write_bytes(content)
        afresh = i % 100 == 99
        where = "the program itself" if afresh else "its entry"
        with tally.fault(f"mutated {kind}, by {where}", config.name), _kept(content):
            if afresh:
                _validate_afresh(path, timed)
            elif _validate(path, timed, base) == 0:
                sound.append(content)


def _validate_extremes(tally: Tally, rng: random.Random, count: int, folder: Path, timed: bool) -> None:
    """Each number of each kind of component, at the first place where the configurations have it."""
    places: dict[tuple[Any, ...], tuple[Path, tuple[Any, ...]]] = {}
    for config in CONFIGS:
        data = _read(config)
        for place in _numbers(data):
            within = _at(data, place[:-1])
            kind = within.get("kind") if isinstance(within, dict) else None
            named = [key for key in place if isinstance(key, str)]
            places.setdefault((named[0], kind, named[-1]), (config, place))
    path = folder / "extreme.yaml"
    base = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    tried = [(*where, number) for where in places.values() for number in _EXTREMES]
    for config, place, number in rng.sample(tried, min(count // 4, len(tried))):
        data = _read(config)
        _at(data, place[:-1])[place[-1]] = number
        content = _written(data)
        path.write_bytes(content)
        with (
            tally.fault("extreme numbers, by its entry", f"{config.name}, {place}: {number}"),
            _kept(content),
        ):
            _validate(path, timed, base)


def _numbers(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where numbers stand."""
    if isinstance(value, dict | list):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _numbers(inner, (*at, key))
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield at


def _at(value: Any, place: tuple[Any, ...]) -> Any:
    for key in place:
        value = value[key]
    return value


@contextmanager
def _kept(content: bytes) -> Iterator[None]:
    """Where an assertion fails, the input is kept and named."""
    try:
        yield
    except AssertionError as error:
        with tempfile.NamedTemporaryFile(prefix="hident-torture-", suffix=".yaml", delete=False) as file:
            file.write(content)
        raise AssertionError(f"{file.name}: {error}") from None


# Mutations


def _mutated_data(config: Path, chance: random.Random) -> bytes:
    data = _read(config)
    for _ in range(chance.choice((1, 1, 1, 2, 4))):
        _mutate(data, chance)
    return _written(data)


def _read(config: Path) -> Any:
    return Reader(config.name, numbered=True).read(config.read_text(encoding="utf-8"))


def _written(data: Any) -> bytes:
    return yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=1000).encode()


def _containers(value: Any) -> Iterator[Any]:
    if isinstance(value, dict | list) and value:
        yield value
        for inner in value.values() if isinstance(value, dict) else value:
            yield from _containers(inner)


def _mutate(data: Any, chance: random.Random) -> None:
    containers = [*_containers(data)]
    if not containers:
        return
    at = chance.choice(containers)
    keys = [*at] if isinstance(at, dict) else [*range(len(at))]
    key = chance.choice(keys)
    match chance.randrange(10):
        case 0:
            del at[key]
        case 1 if isinstance(at, dict) and key:
            place = chance.randrange(len(key))
            at[key[:place] + chance.choice("abcxyz_ .$") + key[place + 1 :]] = at.pop(key)
        case 2:
            other = chance.choice(containers)
            at[key] = copy.deepcopy(
                chance.choice([*(other.values() if isinstance(other, dict) else other), other])
            )
        case 3:
            at[key] = [at[key]] * chance.choice((1, 2, 3, 250))
        case 4:
            for _ in range(chance.choice((1, 5, 60))):
                at[key] = {"x": at[key]} if chance.random() < 0.5 else [at[key]]
        case 5:
            at[key] = chance.choice(_ODD)
        case 6 | 7:
            at[key] = chance.choice(_NUMBERS)
        case 8:
            at[key] = chance.choice(_TEXTS)
        case _:
            value = at[key]
            if isinstance(value, int | float) and not isinstance(value, bool):
                at[key] = chance.choice((-value, value * 1000, value / 1000, str(value), value + 1, [value]))
            else:
                at[key] = chance.choice((str(value), list(value) if isinstance(value, dict) else [value]))


def _mutated_text(config: Path, chance: random.Random) -> bytes:
    content = config.read_bytes()
    for _ in range(chance.choice((1, 1, 2, 3))):
        if len(content) < 500:
            break
        lines = content.split(b"\n")
        line, place = chance.randrange(len(lines)), chance.randrange(len(content) + 1)
        match chance.randrange(7):
            case 0:
                lines.insert(line, chance.choice(lines))
                content = b"\n".join(lines)
            case 1:
                content = b"\n".join(lines[:line] + lines[line + 1 :])
            case 2:
                content = content[:place]
            case 3:
                content = content[:place] + bytes([chance.randrange(256)]) + content[place + 1 :]
            case 4:
                names = re.findall(rb"[A-Za-z_]\w*", content) or [b""]
                content = content.replace(chance.choice(names), chance.choice(names), 1)
            case 5:
                numbers = [*re.finditer(rb"(?<![\w.])\d+(\.\d+)?", content)]
                found, number = chance.choice(numbers), str(chance.choice(_NUMBERS)).encode()
                content = content[: found.start()] + number + content[found.end() :]
            case _:
                content = content[:place] + chance.choice(_WRITTEN).encode() + content[place:]
    return content


def bombs(folder: Path) -> Iterator[tuple[Path, bytes]]:
    """Files that are too large, or that would be."""
    layers = "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 12))
    bombs = {
        "laughs": b"a0: &a0 [x, x]\n" + layers.encode(),
        "merges": b"a0: &a0 {x: 1}\n"
        + b"".join(b"a%d: &a%d {<<: [*a%d, *a%d]}\n" % (i, i, i - 1, i - 1) for i in range(1, 40)),
        "large": b"# " + b"x" * 10**8,
        "zeros": bytes(10**8),
        "digits": b"version: 1\ntrials: " + b"9" * 10**7,
        "deep": b"[" * 200_000,
        "deeper": b"\n".join(b" " * i + b"a:" for i in range(3000)),
        "empty": b"",
        "keys": b"".join(b"k%d: 1\n" % i for i in range(25_000)),
        "itself": b"version: &a {x: *a}\ntitle: [*a, *a]",
    }
    for name, content in bombs.items():
        yield folder / f"{name}.yaml", content


# What is held against them


def _validate(path: Path, timed: bool, base: int) -> int:
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        start = time.process_time()
        code = _entered(["validate", str(path)], out.fileno(), err.fileno())
        seconds = time.process_time() - start
        said = [os.pread(file.fileno(), 10**7, 0).decode() for file in (out, err)]
    used = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - base) * 1024
    _check_said(path, code, *said)
    assert not timed or seconds < (_SECONDS if code else _SOUND_SECONDS), f"took {seconds:.1f} s"
    assert used < _BYTES, f"took {used / 1e6:.0f} MB"
    return code


def _entered(arguments: list[str], out: int, err: int) -> int:
    """The exit code of the program's entry, with streams of its own."""
    before = (
        sys.argv,
        sys.stdout,
        sys.stderr,
        signal.getsignal(signal.SIGTERM),
        signal.getsignal(signal.SIGHUP),
    )
    sys.argv = ["hident", *arguments]
    sys.stdout, sys.stderr = (
        io.TextIOWrapper(io.BufferedWriter(io.FileIO(number, "w", closefd=False)), "utf-8")
        for number in (out, err)
    )
    try:
        cli.main()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 0
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        sys.argv, sys.stdout, sys.stderr, *handlers = before
        for number, handler in zip((signal.SIGTERM, signal.SIGHUP), handlers, strict=True):
            signal.signal(number, handler)
    return 0


def _validate_afresh(path: Path, timed: bool) -> None:
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (2**32, 2**32))
        resource.setrlimit(resource.RLIMIT_CPU, (60, 60))

    with (
        tempfile.TemporaryFile() as out,
        tempfile.TemporaryFile() as err,
        tempfile.TemporaryFile() as peak,
    ):
        process = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM, str(peak.fileno()), "validate", str(path)],
            stdout=out,
            stderr=err,
            pass_fds=[peak.fileno()],
            preexec_fn=limit,  # noqa: PLW1509
        )
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        *said, kilobytes = [os.pread(file.fileno(), 10**7, 0).decode() for file in (out, err, peak)]
    _check_said(path, process.returncode, *said)
    seconds, used = usage.ru_utime + usage.ru_stime, int(kilobytes) * 1024
    most = (_SECONDS if process.returncode else _SOUND_SECONDS) + 3
    assert not timed or seconds < most, f"took {seconds:.1f} s with the start"
    assert used < _BYTES, f"took {used / 1e6:.0f} MB"


def _check_said(path: Path, code: int, out: str, err: str) -> None:
    assert code in (0, 2), f"exit code {code}: {err}"
    assert "Traceback" not in err, err
    assert "Warning" not in err, err
    if code == 0:
        # Of a record that may be absent, and is, nothing more is said.
        absent = err.startswith("left out: ") and err.count("\n") == 1
        assert absent or (": fine: " in out, err) == (True, ""), err
        return
    assert err.startswith(f"error: {path}"), err
    # A name with a line break in it is told as it is.
    for line in re.split(rf"\n(?={re.escape(str(path))})", err.removeprefix("error: ").rstrip("\n")):
        assert len(line) < 10_000, f"a line of {len(line)} letters"
        # A file, a line, a key and what is wrong there.
        named = re.match(rf"{re.escape(str(path))}(:\d+)?: .+?: .", line)
        assert named or _NOT_YAML.search(line), f"names no key: {line}"


def _run_some(tally: Tally, rng: random.Random, count: int, folder: Path, sound: list[bytes]) -> None:
    """Run two trials of some of the mutations that are sound."""
    slow = deaf = 0
    for i, content in enumerate(rng.sample(sound, min(count, len(sound)))):
        path = folder / f"run{i}.yaml"
        path.write_bytes(content)
        with tally.fault("mutated, and run", path.name), _kept(content):
            with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
                process = Forked(
                    ["run", str(path), "--trials", "2", "-j1"], folder, out, err, preexec_fn=_limit_memory
                )
                in_time = _ended(process, _RUN_SECONDS)
                if not in_time:
                    slow += 1
                    os.kill(process.pid, signal.SIGINT)
                    if not _ended(process, _RUN_SECONDS):
                        deaf += 1
                        process.kill()
                code = process.wait()
                said = os.pread(err.fileno(), 10**7, 0).decode()
            assert not in_time or code in (0, 1, 2, 3), f"exit code {code}: {said}"
            assert "Traceback" not in said, said
            assert "Warning" not in said, said
            assert code == 0 or "error: " in said or not in_time, said
    tally.notes.append(
        f"{slow} mutated runs took more than {_RUN_SECONDS} s, {deaf} of them did not end at Ctrl-C"
    )


def _limit_memory() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (2**33, 2**33))


def _ended(process: Forked, seconds: float) -> bool:
    end = time.monotonic() + seconds
    while process.poll() is None and time.monotonic() < end:
        time.sleep(0.02)
    return process.poll() is not None
