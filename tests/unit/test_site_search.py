"""The index that the site's search looks through, and the list of all pages."""

import json
import os
from dataclasses import asdict
from urllib.parse import quote

import pytest

from hident.reports.site.build import build
from hident.reports.site.pages import Passage, Written
from hident.reports.site.rendering import STATIC
from hident.reports.site.search import INDEX, files
from tests.accepted import RESULTS, ROOT
from tests.browser.visiting import program
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
    return read(files(pages)[INDEX].decode())


def read(script):
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


def test_the_printed_numbers_of_a_run_are_found_with_their_rows(tmp_path):
    found = read(built(tmp_path, RESULTS / "wang_table1"))
    rows = next(text for _, anchor, _, text in found["passages"] if anchor == "numbers")
    assert "mean loss L(b,a,W) 223.2076 0.0302" in rows.split("; ")
    assert "mean b1 0.4473" in rows.split("; ")


def test_a_component_is_found_by_what_its_module_tells(tmp_path):
    found = read(built(tmp_path, RESULTS / "wang_table1"))
    pages = [path for path, _, _ in found["pages"]]
    told = [
        text
        for number, _, title, text in found["passages"]
        if pages[number] == "components/estimator/two_stage.html" and "background" in title
    ]
    assert "bilinear parameters" in " ".join(told)
    assert "<" not in " ".join(told)


def test_a_text_does_not_repeat_the_titles_above_it():
    written = Written("runs/x_1.html", "A title", "Runs", "", "x_1 A title\nA titled passage")
    assert index([written])["passages"] == [[0, "", "A title", "A titled passage"]]


def test_without_a_script_it_is_said_where_all_pages_are_listed():
    html = files(PAGES)["search.html"].decode()
    said = html.partition("<noscript>")[2].partition("</noscript>")[0]
    assert "needs JavaScript" in said
    assert 'href="search.html#all"' in said
    assert 'id="all"' in html


def built(folder, run):
    """The index of the site of a run, as its build writes it."""
    build([run], folder / "site", results=RESULTS, experiments=ROOT / "experiments", configs=ROOT / "configs")
    return (folder / "site" / INDEX).read_text(encoding="utf-8")


# In a browser, from files

SITE = [
    Written("a.html", "Wiener systems", "Handbook", "", "a neutralisation of the pH, its VIF is 1.5"),
    Written("b.html", "Two stages", "Components", "", "by singular value decomposition of matrices"),
    Written("c.html", "Cite", "Handbook", "", "persistently exciting; modelling in colour. 223.2076"),
    Written("runs/tanks.html", "Tanks by prediction error", "Runs", "", "a model and another"),
    Written("components/prediction_error.html", "prediction_error", "Components", "", "a method"),
    Written("d.html", "Others", "Runs", "", "system var delta; Weierstrass; one excitation; to tell how"),
]


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    chromium = program()
    from playwright.sync_api import sync_playwright

    site = tmp_path_factory.mktemp("searched")
    (site / "static").mkdir()
    for path in STATIC.iterdir():
        (site / "static" / path.name).write_bytes(path.read_bytes())
    for name, content in files(SITE).items():
        (site / name).write_bytes(content)
    with sync_playwright() as playwright:
        arguments = ["--no-sandbox"] if os.geteuid() == 0 else []
        browser = playwright.chromium.launch(executable_path=chromium, args=arguments)
        opened = browser.new_page()
        opened.goto((site / "search.html").as_uri())
        yield opened
        browser.close()


def sought(page, query):
    """What the page of the search says of a query, and the titles of what is found."""
    page.goto(page.url.partition("?")[0] + "?q=" + quote(query))
    page.locator("#found-heading").wait_for()
    return page.inner_text("#found-heading"), page.locator("#found .title").all_inner_texts()


@pytest.mark.parametrize(
    ("query", "titles"),
    [
        ("VIFs", ["Wiener systems"]),
        ("pH neutralization", ["Wiener systems"]),
        ("neutraliz", ["Wiener systems"]),
        ("matrix", ["Two stages"]),
        ("SVD", ["Two stages"]),
        ("svd", ["Two stages"]),
        ("how to cite", ["Cite"]),
        ("modeling", ["Cite"]),
        ("color", ["Cite"]),
        ("223.2076", ["Cite"]),
        ("how", ["Others"]),
    ],
)
def test_words_are_found_in_other_forms(page, query, titles):
    said, found = sought(page, query)
    assert found == titles
    assert said == f"1 result for “{query}”"


@pytest.mark.parametrize("query", ["prediction error", "prediction_error", "Prediction Error"])
def test_the_page_of_a_name_comes_first_whether_its_words_are_joined_or_not(page, query):
    _, found = sought(page, query)
    assert found[0] == "prediction_error"


@pytest.mark.parametrize("query", ["Weiner", "Wienr", "Wieener", "Wiemer"])
def test_a_word_with_one_wrong_letter_leads_to_the_right_one(page, query):
    said, found = sought(page, query)
    assert found == ["Wiener systems"]
    assert said == f"Nothing was found for “{query}”. Did you mean “Wiener”? 1 result for “Wiener”"


@pytest.mark.parametrize("query", ["223.2077", "Wiemerr", "xyz"])
def test_what_is_not_near_is_not_found(page, query):
    assert sought(page, query) == (f"Nothing was found for “{query}”", [])


def test_where_no_passage_has_all_words_those_with_some_are_found(page):
    said, found = sought(page, "persistent excitation")
    assert sorted(found) == ["Cite", "Others"]
    assert said.startswith("No passage has all of these words: those with some. 2 results")


def test_other_forms_are_marked(page):
    sought(page, "vifs neutralization")
    assert page.locator("#found mark").all_inner_texts() == ["neutralisation", "VIF"]


def test_the_right_word_can_be_chosen_from_the_list(page):
    page.locator("#search").fill("Weiner")
    page.locator("#search-results [role=option]").first.wait_for()
    assert "Did you mean “Wiener”?" in page.locator("#search-results [role=option]").first.inner_text()
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    page.locator("#search-results .title").first.wait_for()
    assert page.input_value("#search") == "Wiener"
    assert page.locator("#search-results [role=option]").count() == 1
