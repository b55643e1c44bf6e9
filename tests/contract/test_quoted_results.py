"""What the READMEs of the papers quote from results/ stands there.

A quotation is a link to a file of results/: ``[1.73 %][fig5]`` with ``[fig5]: ../../results/...``, or both at
once. Each number in its text must stand in that file, with the same digits.
"""

import re
from pathlib import Path

import pytest

from tests.documented import ROOT

PAGES = sorted((ROOT / "experiments").glob("*/README.md"))
_LINK = re.compile(r"\[([^][]+)\](?:\[([^][]+)\]|\(([^()\s]+)\))")
_TARGET = re.compile(r"^\[([^][]+)\]: (\S+)$", re.MULTILINE)
_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w]|\.\d)")


def quotations(text: str) -> list[tuple[str, str]]:
    """The texts and targets of the links that lead to results/."""
    targets = dict(_TARGET.findall(text))
    links = [(words, targets.get(name, name) or target) for words, name, target in _LINK.findall(text)]
    return [(words, target) for words, target in links if "/results/" in target]


def missing(page: Path, words: str, target: str) -> set[str]:
    """The numbers of a quotation that its file does not hold."""
    held = set(_NUMBER.findall((page.parent / target).read_text(encoding="utf-8")))
    return set(_NUMBER.findall(words)) - held


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.parent.name)
def test_every_number_that_leads_to_a_table_stands_there(page):
    text = page.read_text(encoding="utf-8")
    found = [(words, target, missing(page, words, target)) for words, target in quotations(text)]
    assert [quotation for quotation in found if quotation[2]] == []


@pytest.mark.parametrize(
    ("paper", "least"), [("chen2009", 41), ("mzyk2009", 4), ("brouri", 4), ("comparisons", 8)]
)
def test_the_pages_quote(paper, least):
    found = quotations((ROOT / "experiments" / paper / "README.md").read_text(encoding="utf-8"))
    assert sum(bool(_NUMBER.search(words)) for words, _ in found) >= least


def test_every_name_of_a_target_is_one_and_is_used():
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        names = [name for name, _ in _TARGET.findall(text)]
        used = {name for _, name, _ in _LINK.findall(text)} - {""}
        assert (page, sorted(names)) == (page, sorted(used))


def test_a_number_with_other_digits_is_missed(tmp_path):
    page, table = tmp_path / "README.md", tmp_path / "table.md"
    table.write_text(
        "| three-segment | 1.73 [0.505, 3.76] | -31.3 |\n13 of 100 trials failed\n", encoding="utf-8"
    )
    assert missing(page, "1.73 % [0.505, 3.76]", "table.md") == set()
    assert missing(page, "1.7 %, -31.3, 13 of 100, 0.50 and 31.3", "table.md") == {"1.7", "0.50", "31.3"}
