"""The entries of BibTeX: that they are whole, and that ours says what CITATION.cff does."""

import re

import pytest
import yaml

import hident
from hident.reports.site import bibliography
from tests.accepted import ROOT

FILES = [ROOT / "hident/reports/site/references.bib", *sorted((ROOT / "experiments").glob("*/paper.bib"))]
ENTRIES = {
    key: entry
    for file in FILES
    for key, entry in bibliography.entries(file.read_text(encoding="utf-8")).items()
}
_HEAD = re.compile(r"@(\w+)\{([^\s,{}]+),\s*")
_FIELD = re.compile(r"(\w+)\s*=\s*\{")


def fields(entry):
    """The type of an entry and its fields, read letter by letter; ValueError at the first that is wrong."""
    if not (head := _HEAD.match(entry)):
        raise ValueError(f"no head: {entry[:40]}")
    found, at = {}, head.end()
    while entry[at] != "}":
        if not (field := _FIELD.match(entry, at)):
            raise ValueError(f"no field: {entry[at : at + 40]}")
        begin = at = field.end()
        depth = 1
        while depth:
            depth += {"{": 1, "}": -1}.get(entry[at], 0)
            at += 1
        if field[1].lower() in found:
            raise ValueError(f"twice: {field[1]}")
        found[field[1].lower()] = entry[begin : at - 1]
        if between := re.compile(r"\s*,?\s*").match(entry, at):
            at = between.end()
    if entry[at + 1 :].strip():
        raise ValueError(f"more: {entry[at + 1 :]}")
    return head[1].lower(), found


def test_no_entry_is_overlooked():
    text = "".join(file.read_text(encoding="utf-8") for file in FILES)
    assert len(ENTRIES) == len(re.findall(r"^@", text, re.MULTILINE)) > 15


@pytest.mark.parametrize("key", ENTRIES)
def test_an_entry_parses_and_says_what_it_lacks(key):
    kind, found = fields(ENTRIES[key])
    assert kind in ("article", "book", "inproceedings", "misc", "software")
    assert all(value.strip() for value in found.values())
    for name in {"author", "title", "year"} - {*found}:
        assert name in found["note"], f"{key} does not say why it has no {name}"
    if kind == "article":
        assert {"journal", "volume"} <= {*found}
    if pages := found.get("pages"):
        assert re.fullmatch(r"\d+(--\d+)?", pages)
    if year := found.get("year"):
        assert re.fullmatch(r"\d{4}", year)
        assert not re.search(r"\d{4}$", key) or key.endswith(year)


@pytest.mark.parametrize(
    "entry",
    [
        "@book{a,\n  title = {B\n}",
        "@book{a,\n  title = B,\n}",
        "@book{a,\n  year = {1},\n  year = {2}\n}",
        "book{a,\n  year = {1}\n}",
    ],
)
def test_a_broken_entry_is_seen(entry):
    with pytest.raises((ValueError, IndexError)):
        fields(entry)


def test_our_entry_is_that_of_the_citation_file():
    said = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    _, found = fields(ENTRIES[bibliography.OURS])
    assert found["author"].strip("{}") == said["authors"][0]["name"]
    assert re.sub("[{}]", "", found["title"]) == said["title"]
    assert found["version"] == str(said["version"]) == hident.__version__
    assert found["date"] == str(said["date-released"])
    assert found["year"] == found["date"][:4]


def test_a_paper_in_the_citation_file_is_as_in_its_entry():
    said = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    known = {re.sub("[{}]", "", found["title"]): found for _, found in map(fields, ENTRIES.values())}
    for paper in said["references"]:
        entry = known[paper["title"]]
        assert entry["year"] == str(paper["year"])
        assert entry.get("doi") == paper.get("doi")
