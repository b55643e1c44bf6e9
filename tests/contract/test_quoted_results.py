"""What the pages quote from results/ stands there, in the place that they name.

A quotation is a link to a file of results/: ``[1.73 %][fig5 ours]`` with
``[fig5 ours]: ../../results/chen_fig5/table.md "three-segment; linear"``, or both at once. Its title says
where the numbers stand, in parts that semicolons separate:

- in a table, a cell of the row (``noise = 2`` is the cell 2 of the column noise), the head of a column, or
  words of the heading above;
- in a line of text, words of it or of the heading.

All numbers of one quotation must stand there with the same digits: in the row, or in its named columns; if no
cell of a row is named, in the named columns of one table, as for a range over its rows. In a line of text,
and of so many of so many anywhere, what stands from the first number to the last must stand word by word ("13
of 100"). A title that names several places wants the numbers in each of them.
"""

import re
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import pytest

from tests.documented import ROOT

PAGES = [ROOT / "README.md", *sorted((ROOT / "experiments").glob("*/README.md"))]
DOCS = sorted((ROOT / "docs").glob("*.md"))
_LINK = re.compile(r'(?<!!)\[([^][]+)\](?:\[([^][]+)\]|\(([^()\s]+)(?:\s+"([^"]+)")?\))')
_TARGET = re.compile(r'^\[([^][]+)\]: (\S+)(?: "([^"]+)")?$', re.MULTILINE)
_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w]|\.\d)")
_CELLS = re.compile(r"(?<!\\)\|")


def numbers(text: str) -> set[str]:
    return set(_NUMBER.findall(text))


@dataclass(frozen=True)
class Quotation:
    words: str
    target: str
    title: str = ""


@dataclass(frozen=True)
class Line:
    """A line of a file; of a row of a table also its cells and the heads of its columns."""

    text: str
    heading: str
    table: int = 0
    heads: tuple[str, ...] = ()
    cells: tuple[str, ...] = ()


def label(name: str) -> str:
    """The name of a target as Markdown compares them: a line may end in it, and capitals do not count."""
    return " ".join(name.split()).casefold()


def quotations(text: str) -> list[Quotation]:
    """The links that lead to text files of results/ and hold numbers."""
    targets = {label(name): (target, title) for name, target, title in _TARGET.findall(text)}
    links = [
        Quotation(words, *(targets.get(label(name), (name, "")) if name else (target, title)))
        for words, name, target, title in _LINK.findall(text)
    ]
    return [
        link
        for link in links
        if re.search(r"(^|/)results/.*\.(md|csv)$", link.target) and numbers(link.words)
    ]


@cache
def lines(text: str) -> list[Line]:
    """The lines of a Markdown file with the headings that they stand under."""
    found: list[Line] = []
    heading, heads, table = "", tuple[str, ...](), 0
    for line in text.splitlines():
        if line.startswith("#"):
            heading = line.lstrip("# ")
        cells = tuple(cell.strip().replace("\\|", "|") for cell in _CELLS.split(line)[1:-1])
        if not cells:
            heads = ()
            found.append(Line(line, heading))
        elif not heads:
            heads, table = cells, table + 1
        elif set("".join(cells)) - set("-: "):
            found.append(Line(line, heading, table, heads, cells))
    return found


def _holds(text: str, words: str) -> bool:
    return re.search(rf"(?<![\w.]){re.escape(words)}(?![\w]|\.\d)", text) is not None


def place(line: Line, title: str) -> tuple[str, str] | None:
    """What a title names of a line: a "row", a "column" alone or "text", and what it holds; else None."""
    parts = [part for part in (part.strip() for part in title.split(";")) if part]
    by_head = [f"{head} = {cell}" for head, cell in zip(line.heads, line.cells, strict=True)]
    rows = [part for part in parts if part in (*line.cells, *by_head)]
    columns = [part for part in parts if part not in rows and part in line.heads]
    rest = [part for part in parts if part not in rows and part not in columns]
    if not all(_holds(line.heading, part) or (not line.cells and _holds(line.text, part)) for part in rest):
        return None
    cells = zip(line.heads, line.cells, strict=True)
    held = " | ".join(cell for head, cell in cells if head in columns) if columns else line.text
    return "text" if not line.cells else "column" if columns and not rows else "row", held


@cache
def places(text: str, title: str) -> tuple[str, list[str]]:
    """The places of a text that a title names: its rows, else its columns, else its lines of text."""
    found: dict[str, dict[int, str]] = {"row": {}, "column": {}, "text": {}}
    for index, line in enumerate(lines(text)):
        if (one := place(line, title)) is not None:
            kind, held = one
            of_kind, key = found[kind], line.table if kind == "column" else index
            of_kind[key] = f"{of_kind[key]} | {held}" if key in of_kind else held
    return next(((kind, list(held.values())) for kind, held in found.items() if held), ("", []))


def missing(text: str, quotation: Quotation) -> set[str]:
    """What of a quotation stands not in every place that its title names; all of it, if there is none."""
    wanted = numbers(quotation.words)
    kind, held = places(text, quotation.title)
    absent = set().union(*(wanted - numbers(words) for words in held)) if held else wanted
    phrase = re.sub(r"^\D*?(?=-?\d)|\D*$", "", " ".join(quotation.words.split()))
    verbatim = kind == "text" or " of " in phrase
    if verbatim and not absent and not all(_holds(words, phrase) for words in held):
        return {phrase}
    return absent


def wrong(page: Path, text: str) -> list[tuple[str, str, set[str]]]:
    """The quotations of a page that do not stand where they say."""
    found = [
        (link.words, link.title, missing((page.parent / link.target).read_text(encoding="utf-8"), link))
        for link in quotations(text)
    ]
    return [each for each in found if each[2]]


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("page", [*PAGES, *DOCS], ids=name_of)
def test_every_number_stands_where_its_link_says(page):
    text = page.read_text(encoding="utf-8")
    assert wrong(page, text) == []
    assert [(link.words, link.target) for link in quotations(text) if not link.title] == []


@pytest.mark.parametrize(
    ("page", "least"),
    [("chen2009", 150), ("mzyk2009", 40), ("brouri", 80), ("wang2009", 40), ("comparisons", 60)],
)
def test_the_pages_quote(page, least):
    found = quotations((ROOT / "experiments" / page / "README.md").read_text(encoding="utf-8"))
    assert sum(len(numbers(link.words)) for link in found) >= least


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_name_of_a_target_is_one_and_is_used(page):
    text = page.read_text(encoding="utf-8")
    used = {label(name) for _, name, _, _ in _LINK.findall(text)} - {""}
    assert sorted(label(name) for name, _, _ in _TARGET.findall(text)) == sorted(used)


@pytest.mark.parametrize(
    ("page", "right", "planted"),
    [
        (".", "[178, 2463,", "[871, 2463,"),
        (".", "[44.8, 0.325,", "[178, 0.325,"),
        ("chen2009", "[13 of 100][fig8 fails]", "[0 of 100][fig8 fails]"),
        ("chen2009", "[41 of 100][linear 0.2]", "[4 of 100][linear 0.2]"),
        ("chen2009", "[1.5][fig9 0.1]", "[4][fig9 0.1]"),
        ("chen2009", "[93.0 to 96.0 %][eff H 2]", "[94.0 to 96.0 %][eff H 2]"),
        ("wang2009", "[72.0 %][tr random rest]", "[2.0 %][tr random rest]"),
        ("wang2009", "[0.721, 0.752 and 0.761]", "[0.839, 0.752 and 0.761]"),
        ("brouri", "[8 of 9][phases 0.5]", "[9 of 9][phases 0.5]"),
        ("mzyk2009", "[5.48][ar1 1000]", "[19.4][ar1 1000]"),
        ("comparisons", "[0.1532][all 1000 cv]", "[0.1909][all 1000 cv]"),
    ],
)
def test_a_planted_error_is_found(page, right, planted):
    path = ROOT / ("README.md" if page == "." else f"experiments/{page}/README.md")
    text = path.read_text(encoding="utf-8")
    assert right in text
    assert wrong(path, text) == []
    assert wrong(path, text.replace(right, planted, 1)) != []


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_nearly_every_other_number_of_the_same_file_is_found_in_place_of_the_quoted_one(page):
    planted = unseen = 0
    for link in quotations(page.read_text(encoding="utf-8")):
        text = (page.parent / link.target).read_text(encoding="utf-8")
        for number in numbers(link.words):
            for other in numbers(text) - {number}:
                words = re.sub(rf"(?<![\w.]){re.escape(number)}(?![\w]|\.\d)", other, link.words)
                planted += 1
                unseen += not missing(text, replace(link, words=words))
    assert unseen <= 0.03 * planted


TABLES = """# Errors of two methods

## Errors, percent

| D, sigma | ours | \\|Voros\\| |
| -------- | ---: | ------: |
| 0.1, 1.5 | 1.73 [0.505, 3.76] | -31.3 |
| 0.1, 4   | 4.47 [1.93, 5.26]  | 135 |

13 of 100 trials of ours at sigma 4 failed.

41 of 100 trials of Voros at sigma 4 failed.

## Coverage, percent

| noise | samples | ours |
| ----: | ------: | ---: |
|     2 |     100 | 94.0 |
|   100 |       2 | 32.0 |
"""


@pytest.mark.parametrize(
    ("words", "title", "absent"),
    [
        ("1.73 % [0.505, 3.76]", "0.1, 1.5; ours", set()),
        ("1.73 % [0.505, 3.76]", "", {"1.73", "0.505", "3.76"}),
        ("1.7 %", "0.1, 1.5; ours", {"1.7"}),
        ("1.73", "0.1, 4; ours", {"1.73"}),
        ("1.73", "0.1, 1.5; |Voros|", {"1.73"}),
        ("31.3", "0.1, 1.5; |Voros|", {"31.3"}),
        ("1.73 and 4.47", "0.1, 1.5; ours", {"4.47"}),
        ("1.73 to 4.47", "Errors; ours", set()),
        ("1.73 to 4.47", "ours", {"1.73", "4.47"}),
        ("94.0", "noise = 2; ours", set()),
        ("94.0", "noise = 100; ours", {"94.0"}),
        ("94.0", "2; 100; ours", {"94.0"}),
        ("13 of 100", "trials of ours", set()),
        ("4 of 100", "trials of ours", {"4 of 100"}),
        ("41 of 100", "sigma 4", {"41"}),
        ("41 of 100", "no such words", {"41", "100"}),
    ],
)
def test_the_place_that_a_title_names(words, title, absent):
    assert missing(TABLES, Quotation(words, "table.md", title)) == absent
