"""What the papers' pages say with a number in a link to a stored result stands in that result."""

import re

import pytest

from tests.accepted import ROOT

PAGES = ("mzyk2009", "brouri")
LINK = re.compile(r"\[([^\]]*)\]\((\.\./\.\./results/[^)]+)\)")
NUMBER = re.compile(r"(?<![\w.^])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?!\.?\w)")


def linked(paper):
    """The texts of the links to stored results, and their files."""
    folder = ROOT / "experiments" / paper
    page = " ".join((folder / "README.md").read_text(encoding="utf-8").split())
    return [(text, (folder / target).resolve()) for text, target in LINK.findall(page)]


@pytest.mark.parametrize("paper", PAGES)
def test_every_number_in_a_link_stands_in_the_result_that_it_links_to(paper):
    links = linked(paper)
    assert sum(bool(NUMBER.search(text)) for text, _ in links) >= 4
    for text, path in links:
        stands = set(NUMBER.findall(path.read_text(encoding="utf-8")))
        missing = [number for number in NUMBER.findall(text) if number not in stands]
        assert not missing, (text, path.parent.name)


def test_the_sums_of_phases_are_those_of_the_accepted_results():
    def rows(path):
        lines = path.read_text(encoding="utf-8").splitlines()
        return {" ".join(line.split()) for line in lines if re.match(r" *\| *(\d )?arg \S+ \+ ", line)}

    shown = rows(ROOT / "experiments/brouri/README.md")
    assert len(shown) == 8
    assert shown <= rows(ROOT / "results/brouri_gains/table.md")
