"""A page for each component of the register, one for each family, and one for the keys of a file."""

from __future__ import annotations

import inspect
import re
import sys
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from hident.config.describe import fields
from hident.config.reference import plain
from hident.config.spec import PLURALS, Component, Family, Spec, components, own_docstring
from hident.engine.experiment import Experiment
from hident.engine.trial import digest
from hident.plugins import is_from_file
from hident.reports.site import bibliography, examples
from hident.reports.site.markdown import code, document
from hident.reports.site.needs import facts
from hident.reports.site.pages import (
    COMPONENTS,
    FILE_PAGE,
    Page,
    Part,
    Passage,
    Sources,
    component_page,
    family_page,
    key_anchor,
    run_page,
)
from hident.reports.site.uses import named

Uses = Mapping[tuple[str, str], list[tuple[str, str, Mapping[str, Any]]]]
"""By family and kind: the name and the title of a run that names it, and the fields that stand there."""

_FAMILIES: Mapping[str, tuple[str, str]] = {
    "estimators": ("Methods", "Estimators: what is fitted to a record."),
    "systems": ("Systems", "The true systems that are simulated."),
    "linears": ("Linear blocks", "Blocks of systems, filters of excitations, and models of noise."),
    "nonlinearities": ("Nonlinearities", "Blocks of systems, and known functions of methods."),
    "excitations": ("Excitations", "What is applied to the input."),
    "noises": ("Noises", "What happens to the output on its way to the record."),
    "streams": ("Random numbers", "Where the random numbers of a run come from."),
    "metrics": ("Metrics", "Scores of an estimate."),
    "bases": ("Bases", "Orthonormal functions of series estimates."),
    "blocks": ("Blocks of a chain", "What prediction_error can fit."),
    "tables": ("Tables", "What table.md shows of the trials."),
    "figures": ("Figures", "What is drawn of the trials, or of one of them."),
}
_ROLE = re.compile(r":(?:mod|class|func|meth|attr):`([^`]*)`")
_LINED = re.compile(r"^(=+ +=+)\n(.*?)\n\1$", re.MULTILINE | re.DOTALL)


def parts(sources: Sources) -> Iterator[Part]:
    """One part for the file's own keys, and one for all components, which link to one another and to runs."""
    known = {family: components(family) for family in PLURALS.values()}
    texts = [(family, kind, _source(cls)) for family, kinds in known.items() for kind, cls in kinds.items()]
    runs = [(run.name, run.facts.resolved) for run in sources.runs]
    yield Part("file", _file)
    works = bibliography.known(sources.experiments)
    yield Part(digest([texts, runs, works]), lambda: _pages(known, _uses(sources), works))


def _source(cls: type[Component]) -> list[Any]:
    """What the page of a plugin's component is made of; the code of hident itself is in every key."""
    if cls.__module__.startswith("hident."):
        return []
    return [cls.__name__, cls.__doc__, cls.source, _background(cls), [*map(list, fields(cls))], _code(cls)]


def _code(cls: type[Component]) -> str:
    try:
        return inspect.getsource(sys.modules[cls.__module__])
    except (KeyError, OSError, TypeError):
        # A class typed in at a prompt has no source.
        return ""


def _uses(sources: Sources) -> Uses:
    found: dict[tuple[str, str], list[tuple[str, str, Mapping[str, Any]]]] = defaultdict(list)
    for run in sources.runs:
        for family, kind, written in named(run.facts.resolved):
            found[family, kind].append((run.name, run.facts.title, written))
    return found


def _file() -> Iterator[Page]:
    keys, passages = _keys(Experiment, FILE_PAGE)
    data = {"keys": keys, "lead": _inline("The keys of a configuration. " + _LEAD, FILE_PAGE)}
    yield Page(FILE_PAGE, "Keys of a configuration", "Components", "keys.html", data, passages=passages)


_LEAD = "Where a key holds a component, such as a system, that component's own keys stand on its page."


def _pages(
    known: Mapping[Family, Mapping[str, type[Component]]], uses: Uses, works: Mapping[str, str]
) -> Iterator[Page]:
    families = []
    for plural, family in PLURALS.items():
        name, about = _FAMILIES[plural]
        listed = [
            (
                component_page(family, kind),
                kind,
                _inline(plain(cls.summary()), family_page(family)),
                _count(uses, cls),
            )
            for kind, cls in known[family].items()
        ]
        families.append((plural, family_page(family), name, about, listed))
        data = {"plural": plural, "about": about, "kinds": listed}
        yield Page(family_page(family), name, "Components", "family.html", data, about)
    yield Page(
        COMPONENTS, "Components", "Components", "components.html", {"families": families, "file": FILE_PAGE}
    )
    for kinds in known.values():
        for cls in kinds.values():
            yield _page(cls, uses, works)


def _count(uses: Uses, cls: type[Component]) -> int:
    return len({name for name, _, _ in uses.get((cls.family, cls.kind), ())})


def _page(cls: type[Component], uses: Uses, works: Mapping[str, str]) -> Page:
    path = component_page(cls.family, cls.kind)
    plural = next(plural for plural, family in PLURALS.items() if family == cls.family)
    in_use = uses.get((cls.family, cls.kind), ())
    fields_of_example = examples.written(cls, [written for _, _, written in in_use])
    keys, passages = _keys(cls, path)
    text = _in_markdown(own_docstring(cls))
    background = _background(cls)
    runs = dict.fromkeys((run_page(name), name, title) for name, title, _ in in_use)
    data = {
        "cls": cls,
        "family": (family_page(cls.family), _FAMILIES[plural][0]),
        "plural": plural,
        "about": document(text, path, "", _nowhere, formulas=True).body,
        "background": document(background, path, "", _nowhere, formulas=True).body if background else "",
        "works": [works[key] for key in bibliography.cited(f"{cls.source}; {own_docstring(cls)}", works)],
        "keys": keys,
        "facts": [(term, _inline(said, path)) for term, said in _facts(cls, fields_of_example)],
        "yaml": fields_of_example is not None and code(examples.as_yaml(cls, fields_of_example), "yaml"),
        "python": examples.in_python(cls) and code(examples.in_python(cls), "pycon"),
        "plugin": _plugin(cls),
        "module": cls.__module__ if cls.__module__.startswith("hident.") else "",
        "runs": [*runs],
        "everywhere": _is_default(cls),
    }
    first = Passage("", cls.kind, f"{own_docstring(cls)} {cls.source} {cls.__name__}")
    title = f"{cls.kind} ({cls.family})"
    return Page(path, title, "Components", "component.html", data, passages=[first, *passages])


def _plugin(cls: type[Component]) -> str:
    """What a command must name besides, for a component from the file of a plugin."""
    file = getattr(sys.modules.get(cls.__module__), "__file__", None)
    return f" --plugin {Path(file).name}" if file and is_from_file(cls.__module__) else ""


def _facts(cls: type[Component], fields_of_example: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    if fields_of_example is None:
        return []
    try:
        return facts(cls(**fields_of_example))
    except Exception:
        # A plugin may answer anything, or less than its base asks for: its page stays.
        return []


def _is_default(cls: type[Component]) -> bool:
    """Whether a configuration that names nothing in its place has it."""
    defaults = (field.get_default(call_default_factory=True) for field in Experiment.model_fields.values())
    return any(isinstance(default, cls) for default in defaults)


def _keys(spec: type[Spec], page: str) -> tuple[list[dict[str, Any]], list[Passage]]:
    """The rows of the table of keys, and what the search finds of them."""
    rows: list[dict[str, Any]] = []
    passages: list[Passage] = []
    seen: set[str] = set()
    for key, holds, default, meaning in fields(spec):
        anchor = key_anchor(key)
        # Several specs that can stand in one place may share a key: the first keeps the anchor.
        is_new = bool(holds) and anchor not in seen
        seen.add(anchor)
        rows.append(
            {
                "key": key,
                "anchor": anchor if is_new else "",
                "holds": _holds(holds),
                "default": default,
                "meaning": _inline(plain(meaning), page),
                "depth": key.count("."),
            }
        )
        if is_new:
            passages.append(Passage(anchor, f"{key} (key)", meaning))
    return rows, passages


def _holds(holds: str) -> list[tuple[str, str]]:
    """What a field holds, word by word, with the page of each family that it names."""
    pages: dict[str, str] = {family: family_page(family) for family in PLURALS.values()}
    signs = holds.replace(">=", "≥").replace("<=", "≤")
    words = re.split(r"(\W+)", re.sub("([<>≥≤]) ", "\\1\N{NO-BREAK SPACE}", signs))
    return [(word, pages.get(word, "")) for word in words]


def _background(cls: type[Component]) -> str:
    """What the module of a component tells besides its first line: symbols, and how the method works."""
    module = sys.modules.get(cls.__module__)
    text = inspect.cleandoc(module.__doc__ or "") if module else ""
    _, _, more = text.partition("\n\n")
    for name in re.findall(r"Symbols are in :mod:`([\w.]+)`|symbols are in :mod:`([\w.]+)`", text):
        other = sys.modules.get("".join(name))
        more += "\n\n" + inspect.cleandoc(other.__doc__ or "") if other else ""
    return _in_markdown(more.strip())


def _in_markdown(text: str) -> str:
    """A docstring as Markdown: its tables of symbols and what it says of modules."""
    return plain(_LINED.sub(_table, _ROLE.sub(r"``\1``", text)))


def _table(match: re.Match[str]) -> str:
    ruler, rows = match[1], match[2]
    second = ruler.index(" =") + 1
    cells: list[list[str]] = []
    for line in rows.splitlines():
        if line[:second].strip():
            cells.append([line[:second].strip(), line[second:].strip()])
        elif cells:
            cells[-1][1] += f" {line.strip()}"
    lines = ["| symbol | meaning |", "| --- | --- |"]
    return "\n".join(
        [*lines, *(f"| {' | '.join(c.replace('|', chr(92) + '|') for c in row)} |" for row in cells)]
    )


def _inline(text: str, page: str) -> str:
    """A sentence as HTML."""
    body = document(text, page, "", _nowhere).body
    return body if body.count("<p>") > 1 else re.sub(r"^<p>|</p>\n?$", "", body)


def _nowhere(path: str) -> bool:
    return False
