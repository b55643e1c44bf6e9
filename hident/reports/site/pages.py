"""What the modules of the site give: pages, in parts that are made again when their sources change."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

from hident.engine.run_files import MUTATIONS, NUMBERS, OWN, POWER, RUN, SENSITIVITY, unpacked
from hident.reports.site.facts import Facts, facts_of
from hident.reports.site.remarks import Remarks
from hident.run_folder import RunFolder

FRONT = "index.html"
"""The page that is seen first."""
COMPONENTS = "components/index.html"
"""The page that lists the components."""
DIFFERENCES = "differences.html"
"""The page that lists the printed numbers that differ; there where one does."""
FILE_PAGE = "components/file.html"
"""The page of the keys of a configuration itself, those of no component."""


class Passage(NamedTuple):
    """A piece of a page, as the search finds it."""

    anchor: str
    """Where it stands on the page; empty for its beginning."""
    title: str
    text: str


@dataclass(frozen=True)
class Page:
    """A page before it is written."""

    path: str
    """Where it stands, from the root of the site, such as 'runs/mzyk_table1.html'."""
    title: str
    section: str
    """The entry of the navigation that it belongs to, such as 'Runs'; empty for none."""
    template: str
    """The file in templates/ that writes it."""
    data: Mapping[str, Any] = field(default_factory=dict)
    """What the template shows; its names are variables there."""
    text: str = ""
    """What it says without any markup, for the search."""
    passages: Sequence[Passage] = ()
    """The same in pieces, where it has several."""


@dataclass(frozen=True)
class Written:
    """A page as it is written."""

    path: str
    title: str
    section: str
    html: str
    text: str = ""
    passages: Sequence[Passage] = ()


@dataclass(frozen=True)
class Part:
    """Pages that are made together."""

    key: str
    """A hash of all that the pages are made of, but for the code and the templates."""
    make: Callable[[], Iterable[Page]]
    """Makes the pages; not called where those of the same key are kept from an earlier build."""
    files: Mapping[str, Path] = field(default_factory=dict)
    """Files that are copied beside the pages: where to, from the root of the site, and from where."""


@dataclass(frozen=True)
class Run:
    """The folder of a run, and where what is known of it stands."""

    name: str
    folder: RunFolder
    results: Path
    """The folder of results that holds, under power/, what is known of its alternatives."""

    @property
    def power(self) -> RunFolder:
        """What its printed numbers make of its alternatives; it need not be there."""
        return RunFolder(self.results / POWER / self.facts.config)

    @cached_property
    def facts(self) -> Facts:
        """What its folder says."""
        return facts_of(self.folder, self.name, self.results)

    @cached_property
    def files(self) -> tuple[str, ...]:
        """The names of its files that are there: those that run.json lists, and those of every run."""
        listed = (name for name in self.folder.files() if posixpath.basename(name) == name)
        every = sorted({*listed, *OWN, SENSITIVITY})
        return tuple(name for name in every if (self.folder.path / name).is_file())

    @cached_property
    def hashes(self) -> dict[str, str]:
        """SHA-256 of all that is known of it: of its files, and of those of its alternatives."""
        files = {name: self.folder.path / name for name in self.files}
        files |= {f"{POWER}/{name}": self.power.path / name for name in (RUN, NUMBERS, MUTATIONS)}
        return {name: sha256(path.read_bytes()).hexdigest() for name, path in files.items() if path.is_file()}


@dataclass(frozen=True)
class Sources:
    """All that the site is made of; folders need not be there."""

    runs: tuple[Run, ...]
    experiments: Path
    """The folder of the papers: their printed numbers, reasons and bibliographies."""
    configs: Path
    docs: Path
    """The folder of the handbook."""
    results: Path = Path("results")
    """The folder of the accepted results."""

    @cached_property
    def remarks(self) -> dict[str, Remarks]:
        """What the folders of the papers of the runs say of their numbers; nothing of runs without one."""
        papers = {run.facts.paper for run in self.runs}
        return {one: Remarks.of(self.experiments / one) if one else Remarks({}, ()) for one in papers}

    @cached_property
    def titles(self) -> dict[str, str]:
        """The titles of the pages of the folders under experiments/, by the names of the folders."""
        files = sorted(self.experiments.glob("*/README.md"))
        return {file.parent.name: _first_line(file) for file in files}

    def named(self, config: str) -> str:
        """What the commands call a configuration: its name, or the path of its file where that stands aside.

        A study of `hident new` stands in a folder of its own name.
        """
        root = self.configs.parent
        # Whatever a damaged run.json calls it, no other file is looked for.
        if not re.fullmatch(r"\w[\w.-]{0,99}", config):
            return config
        if (self.configs / f"{config}.yaml").is_file() or (root / f"{config}.yaml").is_file():
            return config
        aside = root / config / f"{config}.yaml"
        return aside.relative_to(root).as_posix() if aside.is_file() else config

    @cached_property
    def documents(self) -> dict[str, Path]:
        """The files of the handbook by the names of their pages.

        The reference of all keys is none of them: the pages of the components hold it. Beside a checkout's
        docs/ stand its README and its measurements of speed.
        """
        root = self.docs.resolve().parent
        beside = [root / "README.md", root / "results" / "bench.md"]
        files = [path for path in sorted(self.docs.glob("*.md")) if path.name != "reference.md"]
        return {path.stem: path for path in (*files, *filter(Path.is_file, beside))}

    @cached_property
    def attached(self) -> dict[str, Path]:
        """Files that the handbook leads to and that are copied: where to, and from where."""
        root = self.docs.resolve().parent
        names = ("LICENSE", "CITATION.cff", "docs/notebook.ipynb", "docs/ledger.svg")
        files = [root / name for name in names if (root / name).is_file()]
        return {f"handbook/{path.name}": path for path in files}

    @cached_property
    def held(self) -> tuple[str, ...]:
        """What links in texts may lead to: the paths of pages and files of the site."""
        files = [run_file(run.name, file) for run in self.runs for file in run.files]
        papers = [paper_page(path.parent.name) for path in self.experiments.glob("*/README.md")]
        documents = [COMPONENTS, *map(handbook_page, self.documents), *self.attached]
        return tuple(sorted([*(run_page(run.name) for run in self.runs), *files, *papers, *documents]))

    def holds(self, path: str) -> bool:
        """Whether the site holds a page or a file that a text may link to."""
        return path in self._held

    @cached_property
    def _held(self) -> frozenset[str]:
        return frozenset(self.held)


def _first_line(file: Path) -> str:
    with file.open(encoding="utf-8", errors="replace") as lines:
        return lines.readline().strip().lstrip("# ")


def file_name(name: str) -> str:
    """A name as that of a file anywhere: what is no letter, digit, ``_``, ``-`` or ``.`` becomes its number.

    Examples
    --------
    >>> file_name("two_stage"), file_name("a/b"), file_name("index")
    ('two_stage', 'a~2f~b', 'index~')
    """
    safe = re.sub(r"[^A-Za-z0-9_.-]|^\.", lambda match: f"~{ord(match[0]):x}~", name)
    return f"{safe}~" if safe in ("", "index") else safe


def run_page(name: str) -> str:
    """The page of a run; its files stand in the folder of the same name."""
    return f"runs/{file_name(name)}.html"


def run_file(name: str, file: str) -> str:
    """A file of a run; the drawing of a figure and the numbers that it draws stand there unpacked.

    Examples
    --------
    >>> run_file("valve", "fit.png"), run_file("valve", "fit.data.csv.xz")
    ('runs/valve/fit.png', 'runs/valve/fit.data.csv')
    """
    return f"runs/{file_name(name)}/{file_name(unpacked(file))}"


def paper_page(paper: str) -> str:
    """The page of a paper, or of another folder under experiments/."""
    return f"papers/{file_name(paper)}.html"


def component_page(family: str, kind: str) -> str:
    """The page of a component; the family is one of those of the register, such as 'estimator'.

    Examples
    --------
    >>> component_page("estimator", "kernel")
    'components/estimator/kernel.html'
    """
    # A plugin may give its component any name, also one that is no name of a file.
    return f"components/{family}/{file_name(kind)}.html"


def family_page(family: str) -> str:
    """The page that lists the components of a family."""
    return f"components/{family}/index.html"


def key_anchor(path: str) -> str:
    """The anchor of a key on the page of its component, or on that of the file: its path, without marks.

    Examples
    --------
    >>> key_anchor("panels[].curves[].label")
    'key-panels.curves.label'
    """
    return f"key-{re.sub(r'[^A-Za-z0-9_.-]', '', path)}"


def handbook_page(stem: str) -> str:
    """The page of a document of the handbook, such as 'verdicts' for docs/verdicts.md."""
    return f"handbook/{stem}.html"


def relative(target: str, page: str) -> str:
    """The address of a file of the site as it stands on a page: both from the root of the site.

    What follows ``#`` in the target is an anchor, and kept as it is: no path holds one (:func:`file_name`).

    Examples
    --------
    >>> relative("runs/mzyk_table1.html#numbers", "components/estimator/kernel.html")
    '../../runs/mzyk_table1.html#numbers'
    """
    path, mark, anchor = target.partition("#")
    if path == page:
        return f"{mark}{anchor}" or quote(posixpath.basename(page))
    return quote(posixpath.relpath(path, posixpath.dirname(page) or ".")) + mark + anchor
