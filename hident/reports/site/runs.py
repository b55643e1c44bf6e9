"""A page for each run: what the paper printed, what we get, how sure that is, and which command shows it."""

from __future__ import annotations

import csv
import json
import lzma
import math
import re
import shlex
import struct
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from types import MappingProxyType
from typing import Any

from hident.config.spec import components
from hident.engine.run_files import (
    CRASHES,
    PAGE,
    RUN,
    SENSITIVITY,
    TABLE,
    TIMING,
    TRIALS,
    VERDICTS,
    drawn_file,
    is_drawn,
    is_vector,
    unpacked,
    vector_file,
)
from hident.engine.trial import digest
from hident.errors import ConfigError
from hident.ledger.judged import as_number, judged, key_of
from hident.ledger.published import PUBLISHED, REASONS
from hident.ledger.trial_values import Key, TrialValues
from hident.ledger.verdicts import LEVEL
from hident.reports.failures import failures_of, records
from hident.reports.page import Page as Content
from hident.reports.site import bibliography, configuration, drawings, glossary, tables
from hident.reports.site.facts import WORDS, Facts
from hident.reports.site.markdown import html
from hident.reports.site.numbers import MARKS, MEANINGS, Number, chance, numbers_of
from hident.reports.site.pages import (
    Page,
    Part,
    Run,
    Sources,
    component_page,
    paper_page,
    run_file,
    run_page,
)
from hident.reports.site.remarks import Remarks
from hident.reports.site.truths import truths
from hident.reports.style import PIXELS
from hident.reports.tables.writing import SIGNS, written

_PICTURES = (".svg", ".png", ".pdf")
_POINTS = re.compile(rb'<svg [^>]*width="([\d.]+)pt" height="([\d.]+)pt"')
_MOST_ROWS = 100
"""Rows of alternatives and of failures that a page shows."""
NO_REASON = "No reason is given yet."
_SECTIONS = {
    "estimators": "estimator",
    "metrics": "metric",
    "tables": "table",
    "figures": "figure",
}


def parts(sources: Sources) -> Iterator[Part]:
    """A part for each run, with its files."""
    known = {
        path: sha256(path.read_bytes()).hexdigest()
        for pattern in (f"*/{REASONS}", f"*/{PUBLISHED}", "*/*.bib")
        for path in sources.experiments.glob(pattern)
    }
    explained = [list(one) for one in glossary.words_of(sources)]
    kinds = [[family, *components(family)] for family in ("estimator", "metric", "table", "figure")]
    told, elsewhere = _told_in(sources), _elsewhere(sources)
    for run in sources.runs:
        files = {run_file(run.name, name): run.folder.path / name for name in run.files}
        shows = _shows(sources.configs / f"{run.facts.config}.yaml")
        papers = told.get(run.facts.config, [])
        key = digest(
            [
                run.name,
                run.hashes,
                run.facts.faults,
                _linked(shows, sources),
                papers,
                [vars(one) for one in elsewhere[run.name]],
                kinds,
                explained,
                [[str(p), h] for p, h in known.items()],
                [sources.named(run.facts.config), _is_accepted(run, sources)],
                _bytes_of(sources.configs / f"{run.facts.config}.yaml") if run.facts.tables else "",
            ]
        )
        yield Part(key, partial(_page, run, sources, shows, papers, elsewhere[run.name]), files)


def _bytes_of(file: Path) -> str:
    """SHA-256 of a file; empty where it cannot be read."""
    try:
        return sha256(file.read_bytes()).hexdigest()
    except OSError:
        return ""


def _told_in(sources: Sources) -> dict[str, list[tuple[str, str]]]:
    """The pages under experiments/ that speak of each configuration: their paths and titles."""
    found: dict[str, list[tuple[str, str]]] = {}
    for file in sorted(sources.experiments.glob("*/README.md")):
        text = file.read_text(encoding="utf-8", errors="replace")
        title = text.partition("\n")[0].lstrip("# ")
        for run in sources.runs:
            if re.search(rf"\b{re.escape(run.facts.config)}\b", text) or file.parent.name == run.facts.config:
                found.setdefault(run.facts.config, []).append((paper_page(file.parent.name), title))
    return found


def _shows(config: Path) -> str:
    """What a configuration says of itself: the comment that it begins with."""
    try:
        lines = config.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return ""
    said = []
    for line in lines:
        if not line.startswith("#"):
            break
        if not line.startswith("# yaml-language-server"):
            said.append(line.lstrip("# "))
    return " ".join(said)


def _linked(text: str, sources: Sources) -> list[tuple[str, str]]:
    """A text in pieces, each with the page that it leads to: a README under experiments/ that is there."""
    there = {file.parent.name for file in sources.experiments.glob("*/README.md")}
    pieces = re.split(r"\b(experiments/\w+/README\.md)\b", text)
    names = [piece.split("/")[1] if i % 2 else "" for i, piece in enumerate(pieces)]
    return [
        (piece, paper_page(name) if name in there else "") for piece, name in zip(pieces, names, strict=True)
    ]


@dataclass(frozen=True)
class Elsewhere:
    """Another run that stands beside printed numbers of this one."""

    page: str
    name: str
    title: str
    numbers: int
    """How many printed numbers both stand beside."""
    otherwise: int
    """How many of them have another verdict there."""
    rejects_ours: tuple[str, ...]
    """The tables that reject our reading there as a whole."""


def _elsewhere(sources: Sources) -> dict[str, list[Elsewhere]]:
    """For each run the others that stand beside the same printed numbers."""
    words = {run.name: _words(run) for run in sources.runs}
    found: dict[str, list[Elsewhere]] = {}
    for run in sources.runs:
        found[run.name] = []
        for other in sources.runs:
            both = words[run.name].keys() & words[other.name].keys()
            if other.name != run.name and other.facts.paper == run.facts.paper and both:
                rejected = [state.table for state in other.facts.tables if state.joint_p < LEVEL]
                found[run.name].append(
                    Elsewhere(
                        run_page(other.name),
                        other.name,
                        other.facts.title,
                        len(both),
                        sum(words[run.name][key] != words[other.name][key] for key in both),
                        tuple(rejected),
                    )
                )
    return found


def _words(run: Run) -> dict[tuple[str, ...], set[str]]:
    """The verdicts of a run on each printed number that counts."""
    found: dict[tuple[str, ...], set[str]] = {}
    for row in run.facts.counted:
        found.setdefault(key_of(row), set()).add(row["verdict"])
    return found


@dataclass(frozen=True)
class Figure:
    """A figure of a run."""

    name: str
    picture: str
    """The file that a page shows; empty where there is none to show."""
    files: tuple[str, ...]
    data: str
    """The file of the numbers that it draws; empty where there is none."""
    size: tuple[int, int] | None
    """Its width and height on the page."""
    about: str
    kind: str


def _page(
    run: Run, sources: Sources, shows: str, told: Sequence[tuple[str, str]], elsewhere: Sequence[Elsewhere]
) -> Iterator[Page]:
    facts, path = run.facts, run_page(run.name)
    trials, astray = _trials(run)
    remarks = sources.remarks[facts.paper]
    known = truths(sources.configs / f"{facts.config}.yaml", facts.resolved) if facts.tables else {}
    numbers, unreadable = _numbers(run, trials, remarks, known)
    differing = _differing(numbers, facts, remarks)
    page_text = _text_of(run, PAGE)
    content = Content.read(page_text) if page_text else None
    said = "\n\n".join(_said(content)) if content else ""
    data: dict[str, Any] = {
        "run": run,
        "facts": facts,
        "show_name": shlex.quote(f"out/{facts.config}"),
        "faults": [*facts.faults, *astray, *unreadable],
        "shows": _linked(shows, sources),
        "told": told,
        "elsewhere": elsewhere,
        "misprinted": Counter(one.judged.printed.table for one in numbers if one.is_misprint),
        "chance": chance,
        "file": partial(run_file, run.name),
        "grids": tables.grids(numbers[: tables.MOST_NUMBERS]),
        "most_numbers": tables.MOST_NUMBERS,
        "more_numbers": max(len(numbers) - tables.MOST_NUMBERS, 0),
        "states": {state.table: state for state in facts.tables},
        "drawings": drawings,
        "signs": SIGNS,
        "meanings": MEANINGS,
        "marks": MARKS,
        "words": WORDS,
        "differing": differing,
        "written": written,
        "figures": list(_figures(run)),
        "tables": tables.all_shown(content.tables) if content else [],
        "said": html(said, path, "", lambda target: False) if said else "",
        "statistics": [*dict.fromkeys(one.statistic for one in numbers if one.statistic)],
        "alternatives": _alternatives(facts),
        "stale": facts.verdicts.stale if facts.verdicts else (),
        "failures": failures_of(run.folder),
        "most_rows": _MOST_ROWS,
        "timing": tables.timing(run.folder.path / TIMING) if TIMING in run.files else None,
        "machine": list(_machine(facts)),
        "moved": _moved(run),
        "provenance": list(_provenance(facts)),
        "seconds": list(_pairs(facts.provenance.get("seconds"))),
        "configuration": configuration.lines(facts.resolved),
        "commands": list(_commands(run, sources)),
        "name": shlex.quote(sources.named(facts.config)),
        "citations": list(_citations(facts, sources.experiments)),
        "files": [
            (shown, size, _about(shown))
            for shown, size in {unpacked(name): _bytes(run, name) for name in run.files}.items()
        ],
    }
    headings = [part for table in content.tables for part in (table.title, *table.header)] if content else []
    notes = [note for table in content.tables for note in table.notes] if content else []
    shown = [facts.title, shows, said, *headings, *notes, *(one.about for one in data["figures"])]
    data["explained"] = glossary.used(glossary.words_of(sources), " ".join(shown))
    kinds = [kind for section in _SECTIONS for kind in facts.kinds(section)]
    told_of = [reason for reason, _ in differing]
    words = " ".join([facts.config, facts.title, shows, said, *told_of, *dict.fromkeys(headings), *kinds])
    yield Page(path, facts.title, "Runs", "run.html", data, words)


def _trials(run: Run) -> tuple[TrialValues | None, list[str]]:
    """The values of the trials, where a number stands beside them; and what is wrong with their file."""
    if run.facts.verdicts is None or TRIALS not in run.files:
        return None, []
    try:
        return TrialValues.decoded((run.folder.path / TRIALS).read_bytes()), []
    except (OSError, ValueError, EOFError, csv.Error) as error:
        return None, [f"{TRIALS} cannot be read ({error})"]


def _said(content: Content) -> Iterator[str]:
    """What table.md says of the run as a whole, but for what the page shows elsewhere."""
    yield from map(tables.without_folders, content.above[1:])
    inside = False
    for paragraph in content.below:
        # The numbers that differ stand as a list below their reason.
        inside = paragraph.startswith("Differs:") or (inside and paragraph.startswith("- "))
        if not inside and not paragraph.startswith("Printed numbers:"):
            yield paragraph


def _numbers(
    run: Run,
    trials: TrialValues | None,
    remarks: Remarks,
    known: Mapping[Key, float] = MappingProxyType({}),
) -> tuple[list[Number], list[str]]:
    """The printed numbers of a run; and what is wrong with their file."""
    verdicts = run.facts.verdicts
    if verdicts is None:
        return [], []
    try:
        rows = judged(run.folder.path / VERDICTS, verdicts.resolved, trials)
        return list(numbers_of(rows, verdicts.power, trials, remarks, known)), []
    except ConfigError as error:
        return [], [str(error).replace(f"{run.folder.path}/", "")]


def _text_of(run: Run, name: str) -> str:
    if name not in run.files:
        return ""
    return (run.folder.path / name).read_text(encoding="utf-8", errors="replace")


def differing(run: Run, remarks: Remarks) -> list[tuple[str, list[Number]]]:
    """The numbers of a run that count and differ, those of one reason together."""
    trials, _ = _trials(run)
    numbers, _ = _numbers(run, trials, remarks)
    return _differing([one for one in numbers if one.judged.counts], run.facts, remarks)


def _differing(numbers: Sequence[Number], facts: Facts, remarks: Remarks) -> list[tuple[str, list[Number]]]:
    """The numbers that differ, those of one reason together; the reasons are those of today."""
    found: dict[str, list[Number]] = {}
    for one in numbers:
        it = one.judged
        if it.word == "differs":
            today = remarks.reason(facts.config, it.key)
            said = (today.reason if today else it.reason) or MARKS.get(it.mark, "").capitalize() or NO_REASON
            found.setdefault(said, []).append(one)
    return list(found.items())


def _figures(run: Run) -> Iterator[Figure]:
    """The figures of a run, by the names of its configuration and then by those of its files."""
    asked = run.facts.resolved.get("figures")
    asked = asked if isinstance(asked, Mapping) else {}
    sound = {unpacked(name) for name in run.files if not _is_broken(run, name)}
    there = {name.rpartition(".")[0] for name in sound if name.endswith(_PICTURES)}
    known = components("figure")
    for name in dict.fromkeys([*asked, *sorted(there)]):
        files = tuple(f"{name}{end}" for end in _PICTURES if f"{name}{end}" in sound)
        shown = next((file for file in files if not file.endswith(".pdf")), "")
        data = unpacked(drawn_file(name)) if drawn_file(name) in run.files else ""
        spec = asked.get(name)
        kind = str(spec.get("kind", "")) if isinstance(spec, Mapping) else ""
        about = known[kind].summary() if kind in known else ""
        size = _size(run, shown)
        yield Figure(name, shown, files, data, size, about, component_page("figure", kind) if about else "")


def _is_broken(run: Run, name: str) -> bool:
    """Whether a packed drawing cannot be unpacked."""
    return is_vector(name) and _vector(run, name) is None


def _vector(run: Run, name: str) -> bytes | None:
    try:
        return lzma.decompress((run.folder.path / name).read_bytes())
    except (OSError, lzma.LZMAError):
        return None


def _size(run: Run, shown: str) -> tuple[int, int] | None:
    """Width and height of a picture, as large as the pixels of a PNG are; None if it does not say."""
    if shown.endswith(".png"):
        with (run.folder.path / shown).open("rb") as content:
            head = content.read(24)
        if len(head) == 24 and head.startswith(b"\x89PNG"):
            width, height = struct.unpack(">II", head[16:24])
            return int(width), int(height)
    packed = vector_file(shown.removesuffix(".svg"))
    if packed in run.files and (found := _POINTS.search(_vector(run, packed) or b"")):
        return round(float(found[1]) * PIXELS / 72), round(float(found[2]) * PIXELS / 72)
    return None


def _alternatives(facts: Facts) -> list[dict[str, Any]]:
    """For each table the alternatives, what each changes, and what the table makes of it."""
    power = facts.verdicts.power if facts.verdicts else None
    changes = facts.resolved.get("alternatives")
    changes = changes if isinstance(changes, Mapping) else {}
    if power is None:
        return []
    return [
        {
            "state": state,
            "rows": [(one, _changes(changes.get(one.alternative))) for one in power.of_table(state.table)],
        }
        for state in facts.tables
        if power.of_table(state.table)
    ]


def _changes(change: Any) -> list[str]:
    """What an alternative changes, a line for each key path."""
    if not isinstance(change, Mapping):
        return []
    return [f"{path}: {json.dumps(value, ensure_ascii=False)}" for path, value in change.items()]


def _moved(run: Run) -> tuple[int, int] | None:
    """How many trials a last bit moved, of how many; None where it was not measured."""
    rows = records(run.folder.path / SENSITIVITY) if SENSITIVITY in run.files else []
    counts = [(as_number(row.get("perturbed", "")), as_number(row.get("moved", ""))) for row in rows]
    if not counts or any(math.isnan(one) for pair in counts for one in pair):
        return None
    return int(sum(moved for _, moved in counts)), int(sum(of for of, _ in counts))


def _provenance(facts: Facts) -> Iterator[tuple[str, str]]:
    """What decides the numbers, and where they come from."""
    known = facts.provenance
    yield "configuration", facts.config
    if facts.seed is not None:
        yield "seed", str(facts.seed)
    if facts.trials is not None:
        yield "trials of each estimator and case", str(facts.trials)
    yield from (("measured record", tables.without_folders(record)) for record in facts.records)
    if known.get("hident"):
        yield "hident", str(known["hident"])
    if commit := known.get("git_commit"):
        changed = ", and changes to it that were not committed then" if known.get("git_dirty") else ""
        yield "commit", f"{commit}{changed}"
    if key := known.get("key"):
        yield "key of the files", f"{key}, a hash of the code and of all else that they depend on"
    if known.get("python"):
        yield "Python", str(known["python"])
    if libraries := [f"{name} {version}" for name, version in _pairs(known.get("libraries"))]:
        yield "libraries", ", ".join(libraries)
    arithmetic = known.get("arithmetic")
    if isinstance(arithmetic, Mapping) and arithmetic.get("identity"):
        yield "arithmetic", str(arithmetic["identity"])
    yield from _machine(facts)
    if known.get("finished"):
        yield "finished", str(known["finished"])


def _machine(facts: Facts) -> Iterator[tuple[str, str]]:
    """The machine of the run."""
    for name in ("platform", "cpu", "workers"):
        if facts.provenance.get(name):
            yield name, str(facts.provenance[name])


def _pairs(value: Any) -> Iterator[tuple[str, str]]:
    if isinstance(value, Mapping):
        yield from ((str(name), str(inner)) for name, inner in value.items())


def _is_accepted(run: Run, sources: Sources) -> bool:
    return (sources.results / run.facts.config / RUN).is_file()


def _commands(run: Run, sources: Sources) -> Iterator[tuple[str, str]]:
    """The commands that make the run and its parts again, and what each does."""
    facts, name = run.facts, shlex.quote(sources.named(run.facts.config))
    yield f"hident run {name}", "computes the trials and writes all that stands here to out/"
    if _is_accepted(run, sources):
        yield "hident compare out results", "holds them against the accepted results, trial by trial"
    shown = shlex.quote(f"out/{facts.config}")
    yield f"hident show {shown}", "prints this page in a terminal"
    if facts.resolved.get("alternatives"):
        yield f"hident power {name}", "runs the alternatives"
    yield f"hident show {name} --trial 0", "makes one trial again: its record, estimates, scores and a figure"
    yield f"hident show {name} --failed", "lists the trials that failed, with their reasons"
    yield f"hident export {name} values.csv", "writes the scores of all trials, one in a row"


def _citations(facts: Facts, experiments: Path) -> Iterator[tuple[str, str]]:
    """BibTeX of hident, the paper and what the configuration uses, each once, and what it is for."""
    known = bibliography.known(experiments)
    uses: dict[str, list[str]] = {bibliography.OURS: ["hident itself"]}
    if facts.paper in known:
        uses[facts.paper] = ["the paper"]
    for section, family in _SECTIONS.items():
        registered = components(family)  # type: ignore[arg-type]
        for kind in facts.kinds(section):
            source = registered[kind].source if kind in registered else ""
            for key in bibliography.cited(source, known):
                uses.setdefault(key, []).append(f"{family} {kind}")
    for key, what in uses.items():
        yield ", ".join(dict.fromkeys(what)), known[key]


def _bytes(run: Run, name: str) -> int | None:
    """The size of a file; None of one that the site unpacks."""
    return None if unpacked(name) != name else (run.folder.path / name).stat().st_size


def _about(name: str) -> str:
    """What a file of a run is."""
    told = {
        RUN: "the configuration, the seed and where the files come from",
        TABLE: "all statistics, one row for each estimator, case and metric",
        PAGE: "the tables as text",
        VERDICTS: "the verdicts on the printed numbers",
        TRIALS: "the value of every trial (pandas.read_csv reads it)",
        TIMING: "the seconds of a fit, on the machine of the run: no comparison reads them",
        SENSITIVITY: "how many trials a last bit moves",
        CRASHES: "what crashed",
    }
    if name in told:
        return told[name]
    if is_drawn(name):
        return "the numbers that a figure draws"
    return "a table by itself" if name.endswith(".csv") else "a figure" if name.endswith(_PICTURES) else ""
