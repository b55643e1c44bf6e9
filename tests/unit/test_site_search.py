"""The index that the site's search looks through, and the list of all pages."""

import json
from dataclasses import asdict

from hident.reports.site.pages import Passage, Written
from hident.reports.site.search import INDEX, files
from tests.unit.test_site_components import Read

PAGES = [
    Written("index.html", "What was reproduced", "Ledger", "<html>", "all   of\nit"),
    Written("runs/a b.html", 'A "run" </script> \u2028', "Runs", "<html>", "plantedword"),
    Written(
        "handbook/x.html",
        "Ünder",
        "Handbook",
        "<html>",
        passages=[Passage("", "Ünder", "first words"), Passage("part-2", "Part 2", "second words")],
    ),
    Written("papers/x.html", "No section", "", "<html>", ""),
]


def index(pages=PAGES):
    script = files(pages)[INDEX].decode()
    assert script.startswith("window.hidentIndex=")
    assert script.endswith(";\n")
    return json.loads(script.removeprefix("window.hidentIndex=").removesuffix(";\n"))


def test_every_page_stands_in_the_index_with_its_words():
    found = index()
    assert found["pages"][1] == ["runs/a b.html", 'A "run" </script> \u2028', "Runs"]
    assert found["passages"][0] == [0, "", "What was reproduced", "all of it"]
    assert found["passages"][1] == [1, "", 'A "run" </script> \u2028', "plantedword"]


def test_a_page_of_several_pieces_is_found_by_each():
    pieces = [passage for passage in index()["passages"] if passage[0] == 2]
    assert pieces == [[2, "", "Ünder", "first words"], [2, "part-2", "Part 2", "second words"]]


def test_pieces_that_were_read_from_a_file_are_lists():
    kept = [Written(**json.loads(json.dumps(asdict(page)))) for page in PAGES]
    assert index(kept) == index()


def test_lines_of_tables_are_left_out_of_the_words():
    written = Written("a.html", "A", "Runs", "", "| N | |x| - 1 |\n| ---: | :-- |\n| 50 | 31.6 |")
    assert index([written])["passages"] == [[0, "", "A", "N |x| - 1 50 31.6"]]


def test_the_same_index_comes_out_again():
    assert files(PAGES) == files(PAGES)


def test_without_a_script_all_pages_are_listed_by_section():
    page = Read(files(PAGES)["search.html"].decode())
    for target, title in (
        ("index.html", "What was reproduced"),
        ("runs/a%20b.html", 'A "run" </script>'),
        ("handbook/x.html", "Ünder"),
        ("papers/x.html", "No section"),
    ):
        assert target in page.links
        assert title in page.words
    assert page.words.index("Ledger") < page.words.index("Others")


def test_the_field_of_the_search_stands_on_every_page_and_works_without_a_script():
    html = files(PAGES)["search.html"].decode()
    assert '<form class="search" role="search" action="search.html">' in html
    assert 'name="q"' in html
    assert 'role="status"' in html
