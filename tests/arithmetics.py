"""The configurations under other arithmetics than that of the accepted results.

Runs each configuration with the libraries' other kernels, in processes of their own, and compares it with
results/ on the trials that both have, as ``hident compare --partial`` does. Without ``--only``, ``--check``
and names of configurations, it writes the table in docs/reproducibility.md; results/ stays as it is.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from hident import arithmetic
from hident.engine.run_files import RUN, SENSITIVITY, TRIALS
from hident.errors import HidentError
from hident.ledger.compare import Comparison, compare
from hident.ledger.sensitivity import RTOL
from hident.ledger.trial_comparison import TrialComparison
from hident.ledger.trial_values import TrialValues
from hident.run_folder import RunFolder

ROOT = Path(__file__).parents[1]
DOCUMENT = ROOT / "docs" / "reproducibility.md"
BEGIN, END = "<!-- arithmetics: begin -->", "<!-- arithmetics: end -->"
LAST_BITS = ("<!-- last bits: begin -->", "<!-- last bits: end -->")
"""The marks around :func:`last_bits`."""
# Together they hold every kind of estimator that a configuration holds, at the least cost.
CHECKED = (
    "brouri_bla",
    "chen_efficiency",
    "chen_fig5",
    "chen_fig8",
    "chen_table3",
    "compare_selection",
    "mzyk_dynamics",
    "mzyk_table1_grid",
    "mzyk_variance",
    "pem_against_two_stage",
    "pem_recovery",
    "wang_efficiency",
)


def _without_avx512() -> str:
    """The names of numpy's loops above AVX2."""
    return arithmetic.pinned({}, {"avx512f"}, version("numpy"))["NPY_DISABLE_CPU_FEATURES"]


def _without_avx2() -> str:
    later = tuple(map(int, version("numpy").split(".")[:2])) >= (2, 4)
    return f"{'X86_V3' if later else 'AVX2 FMA3'} {_without_avx512()}"


@dataclass(frozen=True)
class Arithmetic:
    """A set of kernels: what the table calls it, how it is asked for, and what the processor needs for it."""

    title: str
    settings: Mapping[str, str]
    needs: frozenset[str]

    @property
    def environment(self) -> dict[str, str]:
        """The environment of a process that computes with it."""
        chosen = ("OPENBLAS_CORETYPE", "NPY_DISABLE_CPU_FEATURES", "NPY_ENABLE_CPU_FEATURES")
        kept = {name: value for name, value in os.environ.items() if name not in chosen}
        return {**kept, arithmetic.VARIABLE: "native", **self.settings}

    def hindrance(self) -> str:
        """Why it cannot be had here; empty if it can."""
        if lacking := self.needs - arithmetic.features():
            return f"the processor has no {', '.join(sorted(lacking))}"
        probe = "import json; from hident import arithmetic; print(json.dumps(arithmetic.in_use()))"
        done = subprocess.run(
            [sys.executable, "-c", probe], env=self.environment, capture_output=True, text=True, check=False
        )
        if done.returncode:
            return f"numpy and scipy do not load: {done.stderr.strip().rpartition(chr(10))[2]}"
        use = json.loads(done.stdout)
        kernels = {f"{blas['library']} {blas['kernel']}" for blas in use["blas"]}
        wanted = self.settings.get("OPENBLAS_CORETYPE")
        if wanted and kernels != {f"openblas {wanted}"}:
            return f"BLAS computes with {', '.join(sorted(kernels)) or 'unknown kernels'}"
        loops = set(self.settings.get("NPY_DISABLE_CPU_FEATURES", "").split()) & set(use["simd"])
        return f"numpy still has the loops {', '.join(sorted(loops))}" if loops else ""


_AVX2 = frozenset({"avx2", "fma"})
_AVX512 = frozenset({"avx512f"})
ARITHMETICS = {
    "nehalem": Arithmetic("Nehalem", {"OPENBLAS_CORETYPE": "Nehalem"}, frozenset()),
    "sandybridge": Arithmetic("Sandybridge", {"OPENBLAS_CORETYPE": "Sandybridge"}, frozenset()),
    "haswell": Arithmetic("Haswell", {"OPENBLAS_CORETYPE": "Haswell"}, _AVX2),
    "skylakex": Arithmetic("SkylakeX", {"OPENBLAS_CORETYPE": "SkylakeX"}, _AVX512),
    "no-avx512": Arithmetic("no AVX-512 loops", {"NPY_DISABLE_CPU_FEATURES": _without_avx512()}, _AVX512),
    "no-avx2": Arithmetic("no AVX2 loops", {"NPY_DISABLE_CPU_FEATURES": _without_avx2()}, _AVX2),
}


@dataclass(frozen=True)
class Outcome:
    """Of one configuration under one arithmetic: estimates that moved, those compared, and what is wrong."""

    moved: int
    compared: int
    wrong: tuple[str, ...] = ()


def outcome(ours: Path, accepted: Path) -> Outcome:
    """Compare a result folder with the accepted one on the trials that both have."""
    try:
        found: Comparison = compare(ours, accepted, partial=True)
        mine, theirs = (TrialValues.decoded((folder / TRIALS).read_bytes()) for folder in (ours, accepted))
    except (HidentError, OSError, ValueError) as error:
        return Outcome(0, 0, (str(error),))
    moved = compared = 0
    for series in TrialComparison(mine, theirs, RTOL, None).units.values():
        which = [difference.moved for difference in series.values()]
        moved += int(sum(any(of_trial) for of_trial in zip(*which, strict=True)))
        compared += len(which[0])
    return Outcome(moved, compared, found.differences)


def computed(
    config: str, kernels: Arithmetic, folder: Path, accepted: Path, trials: int, jobs: int | None
) -> Outcome:
    """Run a configuration with an arithmetic in a process of its own, and compare."""
    run = RunFolder(accepted / config).run()
    if run is None:
        return Outcome(0, 0, (f"there is no {accepted / config / RUN}",))
    wanted = min(trials, int(run["experiment"]["trials"]))
    command = [sys.executable, "-m", "hident", "run", config, "--quiet", "--trials", str(wanted)]
    command += ["--out", str(folder / "out"), "--store", str(folder / "store")]
    command += ["--jobs", str(jobs)] if jobs else []
    done = subprocess.run(
        command, cwd=ROOT, env=kernels.environment, capture_output=True, text=True, check=False
    )
    if done.returncode:
        return Outcome(0, 0, (f"hident run ends with {done.returncode}: {done.stderr.strip()}",))
    ours = folder / "out" / config
    # A run that ends well and writes nothing has left out a configuration whose record is not here.
    return outcome(ours, accepted / config) if ours.exists() else Outcome(0, 0)


Table = Mapping[str, Mapping[str, Outcome]]
"""The outcomes by configuration and arithmetic; an arithmetic that cannot be had is missing."""


def markdown(table: Table, names: Iterable[str]) -> str:
    """The table: how many estimates each configuration compares, and how many moved by each arithmetic."""
    names = list(names)
    lines = [
        " | ".join(("| configuration", "estimates", *(ARITHMETICS[name].title for name in names))) + " |",
        "| --- |" + " ---: |" * (len(names) + 1),
    ]
    for config, outcomes in table.items():
        compared = max((one.compared for one in outcomes.values()), default=0)
        cells = [_cell(outcomes.get(name)) for name in names]
        lines.append(f"| `{config}` | {compared} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _cell(one: Outcome | None) -> str:
    if one is None:
        return "-"
    return f"**{one.moved}**" if one.wrong else str(one.moved)


def section(table: Table, trials: int, missing: Mapping[str, str]) -> str:
    """The table with a sentence on what was measured, where and how."""
    dashes = "; ".join(f"{ARITHMETICS[name].title}: {why}" for name, why in missing.items())
    wrong = any(one.wrong for outcomes in table.values() for one in outcomes.values())
    return "\n\n".join(
        (
            "Estimates of which some metric differs from the accepted one by more than 1e-6, so that they "
            f"took another branch, under `{arithmetic.VARIABLE}=native` with OpenBLAS's other kernels, and "
            "with some of numpy's loops off. Each estimate of each of the first "
            f"{trials} trials (of all where there are fewer) is one. "
            f"Made by `make arithmetics TRIALS={trials}` on {_processor()}"
            + (f"; a dash where that cannot be had ({dashes})." if dashes else ".")
            + (" In bold: more than the stored sensitivity makes likely." if wrong else ""),
            markdown(table, ARITHMETICS),
        )
    )


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        lines = []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.processor() or platform.machine())


def last_bits(results: Path) -> str:
    """What records that are a last bit away moved when each configuration was accepted."""
    counts = {}
    for path in sorted(results.glob(f"*/{SENSITIVITY}")):
        with path.open(encoding="utf-8", newline="") as file:
            rows = [*csv.DictReader(file)]
        counts[path.parent.name] = [sum(int(row[name]) for row in rows) for name in ("perturbed", "moved")]
    still = [perturbed for perturbed, moved in counts.values() if not moved]
    lines = ["| configuration | estimates | moved |", "| --- | ---: | ---: |"]
    lines += [f"| `{name}` | {every} | {moved} |" for name, (every, moved) in counts.items() if moved]
    lines.append(f"| {len(still)} others | {sum(still)} | 0 |")
    return "\n".join(lines)


def inserted(document: str, text: str, marks: tuple[str, str] = (BEGIN, END)) -> str:
    """The document with the text between its two marks.

    Raises
    ------
    ValueError
        If a mark is missing.
    """
    before, begin, rest = document.partition(marks[0])
    _, end, after = rest.partition(marks[1])
    if not (begin and end):
        raise ValueError(f"{DOCUMENT} has no {marks[0]} followed by {marks[1]}")
    return f"{before}{begin}\n\n{text}\n\n{end}{after}"


def _arguments(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.arithmetics", description=__doc__)
    parser.add_argument("configs", nargs="*", metavar="CONFIG", help="names (default: all)")
    parser.add_argument("--only", nargs="+", action="extend", choices=ARITHMETICS, help="these arithmetics")
    parser.add_argument("--check", action="store_true", help=f"{', '.join(CHECKED)}, if none is named")
    parser.add_argument("--trials", type=int, default=20, help="trials of each (default: 20)")
    parser.add_argument("--jobs", type=int, help="worker processes")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="keep what is computed, and resume")
    parser.add_argument("--last-bits", action="store_true", help="write the table of results/ alone")
    parser.add_argument("--results", type=Path, default=ROOT / "results", help="the accepted results")
    given = parser.parse_args(arguments)
    known = sorted(path.stem for path in (ROOT / "configs").glob("*.yaml"))
    given.whole = not (given.configs or given.check or given.only)
    given.configs = given.configs or list(CHECKED if given.check else known)
    if given.trials < 1:
        parser.error("--trials must be 1 or more")
    if unknown := sorted({*given.configs} - {*known}):
        parser.error(f"no configuration is named {', '.join(unknown)}")
    return given


def main(arguments: Sequence[str] | None = None) -> int:
    """Run, compare, print and (if everything was asked for) write; 1 if more moved than may."""
    given = _arguments(arguments)
    if given.last_bits:
        document = inserted(DOCUMENT.read_text(encoding="utf-8"), last_bits(given.results), LAST_BITS)
        DOCUMENT.write_text(document, encoding="utf-8", newline="\n")
        return 0
    missing: dict[str, str] = {}
    table: dict[str, dict[str, Outcome]] = {config: {} for config in given.configs}
    place = nullcontext(given.keep) if given.keep else tempfile.TemporaryDirectory()
    with place as folder:
        for name in given.only or ARITHMETICS:
            kernels = ARITHMETICS[name]
            if why := kernels.hindrance():
                missing[name] = why
                print(f"{name}: cannot be had here: {why}", flush=True)
                continue
            for config in given.configs:
                one = computed(
                    config, kernels, Path(folder).absolute() / name, given.results, given.trials, given.jobs
                )
                table[config][name] = one
                print(f"{name}: {config}: {one.moved} of {one.compared} estimates moved", flush=True)
                for line in one.wrong:
                    print(f"    {line}", flush=True)
    if given.whole:
        text = section(table, given.trials, missing)
        document = DOCUMENT.read_text(encoding="utf-8")
        DOCUMENT.write_text(inserted(document, text), encoding="utf-8", newline="\n")
        print(f"wrote {DOCUMENT}")
    else:
        print(markdown(table, given.only or ARITHMETICS))
    wrong = any(one.wrong for outcomes in table.values() for one in outcomes.values())
    if not any(table.values()):
        print("none of these arithmetics can be had here", file=sys.stderr)
    return int(wrong)


if __name__ == "__main__":
    sys.exit(main())
