"""The site of our results, as a visitor has it: every page, by mouse and by keyboard, in light and dark."""

from __future__ import annotations

import io
import json
import os
import threading
from collections.abc import Iterator
from dataclasses import asdict
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote, urldefrag, urlsplit

import numpy as np
import pytest
from filelock import FileLock
from matplotlib.image import imread

from hident import plugins
from hident.reports.site.build import build
from tests.accepted import RESULTS, ROOT
from tests.browser.visiting import NARROWEST, PICTURES, Visit, program, visited, watched

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

KINDS = (
    "index.html",
    "differences.html",
    "search.html",
    "runs/index.html",
    "runs/mzyk_table1.html",
    "runs/chen_table1.html",
    "runs/compare_hammerstein.html",
    "runs/data_example.html",
    "papers/mzyk2009.html",
    "components/index.html",
    "components/estimator/kernel.html",
    "components/figure/curve.html",
    "handbook/index.html",
    "handbook/verdicts.html",
)
"""A page of each kind."""
RUNS = sorted(f"runs/{path.parent.name}.html" for path in RESULTS.glob("*/run.json"))
WIDTHS = (400, 1400)
SERIOUS = ("serious", "critical")


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    chromium = program()
    from playwright.sync_api import sync_playwright

    # Playwright's loop belongs to this thread, and must be gone before other tests have loops of their own.
    with sync_playwright() as playwright:
        # As root, Chromium does not start with its sandbox.
        arguments = ["--no-sandbox"] if os.geteuid() == 0 else []
        browser = playwright.chromium.launch(executable_path=chromium, args=arguments)
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that all workers of a session share."""
    own = tmp_path_factory.getbasetemp()
    return own.parent if "PYTEST_XDIST_WORKER" in os.environ else own


@pytest.fixture(scope="session")
def site(shared: Path) -> Path:
    """The site of results/, built once in a session."""
    program()
    folder = shared / "site"
    with FileLock(shared / "site.lock"):
        if not (folder / "index.html").exists():
            plugins.load()
            build(
                [RESULTS],
                folder,
                experiments=ROOT / "experiments",
                configs=ROOT / "configs",
                docs=ROOT / "docs",
            )
    return folder


@pytest.fixture(scope="module")
def visits(site: Path, shared: Path, browser: Browser) -> dict[str, Visit]:
    """What is found on every page, by its path in the site; they are opened once in a session."""
    file = shared / "visits.json"
    with FileLock(shared / "visits.lock"):
        if not file.exists():
            found = {name: asdict(visit) for name, visit in visited(site, browser)}
            file.write_text(json.dumps(found), encoding="utf-8")
    known = json.loads(file.read_text(encoding="utf-8"))
    return {name: Visit(**visit) for name, visit in known.items()}


@pytest.fixture
def page(browser: Browser, site: Path) -> Iterator[Page]:
    """A page in a window of 1400 pixels, on which nothing may go wrong."""
    page = browser.new_page(viewport={"width": 1400, "height": 900})
    faults = watched(page)
    yield page
    page.close()
    assert not faults


@pytest.fixture(scope="session")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the pictures of pages."""
    named = os.environ.get(PICTURES)
    folder = Path(named) if named else tmp_path_factory.mktemp("pictures")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


# Every page


def test_every_page_opens_without_a_fault(visits: dict[str, Visit]) -> None:
    assert {*KINDS, *RUNS} <= {*visits}
    assert not {name: visit.faults for name, visit in visits.items() if visit.faults}
    assert not [name for name, visit in visits.items() if visit.headings != 1 or visit.shown < 50]


def test_no_page_scrolls_sideways_in_a_narrow_window(visits: dict[str, Visit]) -> None:
    assert not {name: visit.width for name, visit in visits.items() if visit.width > NARROWEST}


def test_no_link_and_no_picture_is_dead(visits: dict[str, Visit], site: Path) -> None:
    anchors = {name: {*visit.ids} for name, visit in visits.items()}
    dead = [
        f"{name}: {link}"
        for name, visit in visits.items()
        for link in dict.fromkeys([*visit.links, *visit.sources])
        if not _leads(link, site, anchors)
    ]
    assert not dead, "\n".join(dead[:40])


def _leads(link: str, site: Path, anchors: dict[str, set[str]]) -> bool:
    """Whether a link leads somewhere: to a file of the site, a place of a page, or out of it."""
    address, anchor = urldefrag(link)
    if not address.startswith("file:"):
        # Nothing is loaded from elsewhere; where a text leads to is not looked at.
        return address.startswith("https://")
    path = Path(unquote(urlsplit(address).path))
    if not path.is_relative_to(site) or not path.is_file():
        return False
    return not anchor or unquote(anchor) in anchors[path.relative_to(site).as_posix()]


def test_no_page_loads_anything_from_elsewhere(visits: dict[str, Visit], site: Path) -> None:
    home = site.as_uri() + "/"
    strange = {
        name: [one for one in visit.sources if not one.startswith((home, "data:"))]
        for name, visit in visits.items()
    }
    assert not {name: found for name, found in strange.items() if found}


def test_an_anchor_stands_once_on_a_page(visits: dict[str, Visit]) -> None:
    twice = {name: {one for one in visit.ids if visit.ids.count(one) > 1} for name, visit in visits.items()}
    assert not {name: found for name, found in twice.items() if found}


@pytest.fixture(scope="module")
def served(site: Path) -> Iterator[str]:
    """The address of the site below a path of a web server."""

    class Handler(SimpleHTTPRequestHandler):
        def log_message(self, format: str, *arguments: Any) -> None:  # noqa: A002
            """Say nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(site.parent))) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/{site.name}/"
        server.shutdown()
        thread.join()


@pytest.mark.parametrize("name", KINDS)
def test_pages_work_below_any_path_of_a_server(page: Page, served: str, name: str) -> None:
    page.goto(served + name, wait_until="networkidle")
    # Those further down are loaded when they come into sight; that of the zoom, when it is opened.
    seen = """async () => {
        const all = [...document.images].filter(one => one.getAttribute("src"));
        for (const one of all) one.loading = "eager";
        const wrong = all.map(one => one.decode().then(() => [], () => [one.src]));
        return (await Promise.all(wrong)).flat();
    }"""
    assert page.evaluate(seen) == []
    assert page.locator("h1").count() == 1


@pytest.mark.parametrize("name", KINDS)
def test_pages_are_readable_without_scripts(browser: Browser, site: Path, name: str) -> None:
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto((site / name).as_uri())
    assert len(page.inner_text("main")) > 100
    # What would do nothing is not there.
    assert not page.locator("form.filters").first.is_visible()
    context.close()


def test_the_policy_of_a_page_refuses_what_is_not_of_the_site(browser: Browser, site: Path) -> None:
    page = browser.new_page()
    page.goto((site / "index.html").as_uri())
    refused = page.evaluate("""() => new Promise(done => {
        addEventListener("securitypolicyviolation", event => done(event.blockedURI));
        const script = document.createElement("script");
        script.src = "https://example.org/a.js";
        document.head.append(script);
    })""")
    assert refused == "https://example.org/a.js"
    page.close()


# Axe

# Of a file no style sheet can be fetched, which only rules on the orientation of screens would look at.
_AXE = {"resultTypes": ["violations"], "preload": False}


def _violations(page: Page) -> list[str]:
    from axe_playwright_python.sync_playwright import Axe

    found = Axe().run(page, options=_AXE).response["violations"]
    return [
        f"{one['id']} ({one['impact']}): {node['target']} {node['html'][:120]}"
        for one in found
        if one["impact"] in SERIOUS
        for node in one["nodes"][:3]
    ]


@pytest.mark.parametrize("name", sorted({*KINDS, *RUNS}))
def test_axe_finds_nothing_serious(page: Page, site: Path, name: str) -> None:
    page.goto((site / name).as_uri())
    assert not _violations(page)


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("name", KINDS)
def test_axe_finds_nothing_serious_in_the_dark(page: Page, site: Path, name: str, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 900})
    page.emulate_media(color_scheme="dark")
    page.goto((site / name).as_uri())
    assert not _violations(page)


def test_axe_finds_nothing_serious_in_an_open_cell(page: Page, site: Path) -> None:
    page.goto((site / "runs/mzyk_table1.html").as_uri())
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        page.locator("button.number").nth(3).click()
        assert page.locator("[popover]:popover-open").is_visible()
        assert not _violations(page)
        page.keyboard.press("Escape")


# Screenshots, for eyes


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_pictures_are_taken(page: Page, site: Path, pictures: Path, width: int, scheme: Any) -> None:
    page.set_viewport_size({"width": width, "height": 900})
    page.emulate_media(color_scheme=scheme)
    for name in KINDS:
        page.goto((site / name).as_uri(), wait_until="load")
        file = pictures / f"{name.removesuffix('.html').replace('/', '-')}-{width}-{scheme}.png"
        page.screenshot(path=file, full_page=True)
        assert file.stat().st_size > 10_000


# Filters


def _attributes(page: Page, name: str) -> list[str]:
    """What the rows say that are shown."""
    rows = page.locator("#tables [data-row]:visible").all()
    return [row.get_attribute(f"data-{name}") or "" for row in rows]


def test_the_ledger_is_filtered_by_mouse(page: Page, site: Path) -> None:
    page.goto((site / "index.html").as_uri())
    form = page.locator("form.filters")
    every = len(_attributes(page, "verdict"))
    form.locator("select[name=verdict]").select_option("differs")
    shown = _attributes(page, "verdict")
    assert 0 < len(shown) < every
    assert all("differs" in words.split("|") for words in shown)
    assert form.locator("output").inner_text() == f"{len(shown)} of {every} shown"
    form.locator("select[name=paper]").select_option("wang2009")
    assert {*_attributes(page, "paper")} == {"wang2009"}
    # Of the other papers no heading is left.
    assert page.locator("#tables [data-group]:visible").count() == 1
    form.get_by_role("button", name="Show all").click()
    page.wait_for_function("!document.querySelector('#tables [data-row][hidden]')")
    assert len(_attributes(page, "paper")) == every


def test_the_ledger_is_filtered_by_keyboard(page: Page, site: Path) -> None:
    page.goto((site / "index.html").as_uri())
    every = len(_attributes(page, "paper"))
    _tab_to(page, "select[name=paper]")
    page.keyboard.press("ArrowDown")
    shown = _attributes(page, "paper")
    assert 0 < len(shown) < every and len({*shown}) == 1
    page.keyboard.press("Tab")
    page.keyboard.press("Tab")
    page.keyboard.press("ArrowDown")
    assert page.evaluate("document.activeElement.value") != ""


def test_what_is_chosen_stands_in_the_address(page: Page, site: Path) -> None:
    front = (site / "index.html").as_uri()
    page.goto(front)
    every = len(_attributes(page, "paper"))
    form = page.locator("form.filters")
    form.locator("select[name=paper]").select_option("mzyk2009")
    form.locator("select[name=verdict]").select_option("exact")
    assert page.url == f"{front}#tables?paper=mzyk2009&verdict=exact"
    shown = len(_attributes(page, "paper"))
    assert 0 < shown < every
    page.go_back()
    assert page.url == f"{front}#tables?paper=mzyk2009"
    assert form.locator("select[name=verdict]").input_value() == ""
    assert shown < len(_attributes(page, "paper")) < every
    page.go_back()
    assert page.url == front
    assert len(_attributes(page, "paper")) == every
    page.go_forward()
    assert {*_attributes(page, "paper")} == {"mzyk2009"}
    form.get_by_role("button", name="Show all").click()
    page.wait_for_url(front)
    # As somebody opens it to whom the address was sent.
    page.goto("about:blank")
    page.goto(f"{front}#tables?paper=mzyk2009&verdict=exact")
    assert len(_attributes(page, "paper")) == shown
    assert form.locator("output").is_visible()
    page.goto("about:blank")
    page.goto(f"{front}#tables?paper=nobody&verdict=%3Cscript%3E")
    assert len(_attributes(page, "paper")) == every


def test_a_text_that_is_looked_for_is_one_step_back(page: Page, site: Path) -> None:
    runs = (site / "runs/index.html").as_uri()
    page.goto((site / "index.html").as_uri())
    page.goto(runs)
    page.locator("form.filters input[type=search]").press_sequentially("wang table")
    assert page.url == f"{runs}#runs?text=wang+table"
    page.go_back()
    assert page.url == (site / "index.html").as_uri()


def test_the_differences_are_filtered_and_lead_to_their_cells(page: Page, site: Path) -> None:
    page.goto((site / "differences.html").as_uri())
    page.locator("select[name=why]").select_option("misprint")
    rows = page.locator("#differences [data-row]:visible")
    assert 0 < rows.count() < page.locator("#differences [data-row]").count()
    printed = rows.first.locator("b").first.inner_text()
    rows.first.locator("a").click()
    detail = page.locator("[popover]:popover-open")
    detail.wait_for()
    assert "misprint" in detail.inner_text()
    assert printed in detail.inner_text()
    page.keyboard.press("Escape")
    # Back on the list, it is filtered as it was.
    page.go_back()
    page.wait_for_function("document.querySelector('#differences [data-row][hidden]')")
    assert page.locator("select[name=why]").input_value() == "misprint"


def test_a_number_that_differs_leads_to_its_cell_on_the_same_page(page: Page, site: Path) -> None:
    page.goto((site / "runs/mzyk_table1.html").as_uri())
    page.locator(".reason a").first.click()
    detail = page.locator("[popover]:popover-open")
    detail.wait_for()
    assert "differs" in detail.inner_text()


def test_runs_are_filtered_by_their_text(page: Page, site: Path) -> None:
    page.goto((site / "runs/index.html").as_uri())
    page.locator("form.filters input[type=search]").fill("WANG_table")
    names = page.locator("#runs [data-row]:visible th").all_inner_texts()
    assert names == ["wang_table1", "wang_table2"]


def _tab_to(page: Page, selector: str) -> None:
    """Press Tab until something has the focus."""
    for _ in range(200):
        page.keyboard.press("Tab")
        if page.evaluate("selector => document.activeElement.matches(selector)", selector):
            return
    raise AssertionError(f"{selector} is not reached by Tab")


# The details of a number


def _opened(page: Page) -> str:
    return page.locator("[popover]:popover-open").inner_text()


def test_a_number_opens_by_mouse(page: Page, site: Path) -> None:
    page.goto((site / "runs/mzyk_table1.html").as_uri())
    number = page.locator("button.number").filter(has_text="4.42")
    detail = page.locator("[popover]:popover-open")
    number.hover()
    detail.wait_for()
    said = _opened(page)
    for words in ("4.42", "2.807", "2.245 to 3.528", "N=3000", "differs", "hident "):
        assert words in said
    assert detail.locator("svg").count() == 1
    page.mouse.move(5, 5)
    detail.wait_for(state="detached")
    # A click keeps it.
    number.click()
    page.mouse.move(5, 5)
    page.wait_for_timeout(400)
    assert detail.is_visible()
    box = detail.bounding_box()
    assert box and box["x"] >= 0 and box["x"] + box["width"] <= 1400
    page.keyboard.press("Escape")
    assert detail.count() == 0


def test_a_number_opens_by_keyboard(page: Page, site: Path) -> None:
    page.goto((site / "runs/mzyk_table1.html").as_uri())
    detail = page.locator("[popover]:popover-open")
    _tab_to(page, "button.number")
    assert "37.37" in _opened(page)
    page.keyboard.press("Tab")
    page.wait_for_function("document.querySelectorAll(':popover-open').length === 1")
    first = page.evaluate("document.activeElement.getAttribute('popovertarget')")
    assert page.locator("[popover]:popover-open").get_attribute("id") == first
    page.keyboard.press("Escape")
    assert detail.count() == 0
    page.keyboard.press("Enter")
    detail.wait_for()
    page.keyboard.press("Escape")
    assert detail.count() == 0
    assert page.evaluate("document.activeElement.getAttribute('popovertarget')") == first


@pytest.mark.parametrize("width", [NARROWEST, 1400])
def test_every_number_of_a_table_opens_inside_of_the_window(page: Page, site: Path, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 700})
    page.goto((site / "runs/mzyk_table1.html").as_uri())
    numbers = page.locator("button.number")
    for i in range(numbers.count()):
        numbers.nth(i).click()
        box = page.locator("[popover]:popover-open").bounding_box()
        assert box and box["x"] >= 0 and box["x"] + box["width"] <= width
        assert box["y"] >= 0 and box["y"] + box["height"] <= 700
        page.keyboard.press("Escape")


# Figures


def test_a_figure_opens_large_and_closes(page: Page, site: Path) -> None:
    page.goto((site / "runs/mzyk_table1.html").as_uri())
    dialog = page.locator("dialog")
    page.locator("a.zoom").first.click()
    dialog.wait_for()
    width = "document.querySelector('dialog img').getBoundingClientRect().width"
    whole = page.evaluate(width)
    assert whole == 1400
    assert dialog.get_by_role("button", name="Smaller").is_disabled()
    dialog.get_by_role("button", name="Larger").click()
    page.keyboard.press("+")
    assert page.evaluate(width) == pytest.approx(4 * whole, rel=0.05)
    page.keyboard.press("-")
    dialog.locator("img").click(position={"x": 300, "y": 300})
    assert page.evaluate(width) == pytest.approx(4 * whole, rel=0.05)
    dialog.get_by_role("button", name="Smaller").click()
    page.keyboard.press("Escape")
    assert not dialog.is_visible()
    page.locator("a.zoom").nth(1).focus()
    page.keyboard.press("Enter")
    dialog.get_by_role("button", name="Close").click()
    assert not dialog.is_visible()


# The look


@pytest.mark.parametrize("width", [NARROWEST, 1400])
def test_a_shadow_stands_only_where_a_table_goes_on(page: Page, site: Path, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 900})
    page.goto((site / "runs/brouri_ambiguity.html").as_uri())
    seen: dict[bool, list[float]] = {}
    for box in page.locator(".scroll").all():
        goes_on = box.evaluate("box => box.scrollWidth > box.clientWidth + 4")
        # Of the box alone, without what stands in it.
        box.evaluate("box => { box.firstElementChild.style.visibility = 'hidden'; }")
        pixels = imread(io.BytesIO(box.screenshot()), format="png")
        # Where a pixel of the screenshot lies on the edge of the box, a line of its row may be mixed.
        seen.setdefault(goes_on, []).append(float(np.ptp(pixels[2:-2], axis=1).max()))
    assert not any(seen.get(False, [1.0]))
    assert all(spread > 0.1 for spread in seen.get(True, []))


def test_the_other_look_is_chosen_and_kept(page: Page, site: Path) -> None:
    page.goto((site / "index.html").as_uri())
    colour = "getComputedStyle(document.body).backgroundColor"
    light = page.evaluate(colour)
    page.get_by_role("button", name="Dark").click()
    dark = page.evaluate(colour)
    assert light != dark
    page.goto((site / "runs/index.html").as_uri())
    assert page.evaluate(colour) == dark


def test_a_page_is_printed_without_what_is_for_the_screen(page: Page, site: Path) -> None:
    page.goto((site / "runs/mzyk_table1.html").as_uri())
    page.emulate_media(media="print", color_scheme="dark")
    assert not page.locator("nav").first.is_visible()
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") in (
        "rgb(255, 255, 255)",
        "rgba(0, 0, 0, 0)",
    )


# The search


def test_the_search_is_reached_and_used_by_keyboard(page: Page, site: Path) -> None:
    page.goto((site / "runs/mzyk_table1.html").as_uri())
    page.keyboard.press("/")
    page.keyboard.type("mutation score")
    page.locator("#search-results [role=option]").first.wait_for()
    page.keyboard.press("ArrowDown")
    chosen = page.locator("#search-results [aria-selected=true]")
    assert chosen.count() == 1
    with page.expect_navigation():
        page.keyboard.press("Enter")
    assert "mutation score" in page.inner_text("main").lower()


def test_the_search_is_used_by_mouse(page: Page, site: Path) -> None:
    page.goto((site / "components/estimator/kernel.html").as_uri())
    page.locator("#search").click()
    page.locator("#search").fill("wang_table1")
    with page.expect_navigation():
        page.locator("#search-results [role=option]").first.click()
    assert page.url.partition("#")[0].endswith("runs/wang_table1.html")


def test_all_results_of_a_search_stand_on_its_page(page: Page, site: Path) -> None:
    page.goto((site / "index.html").as_uri())
    page.locator("#search").fill("kernel")
    page.locator("#search").press("Enter")
    page.locator("#found li a").first.wait_for()
    assert page.locator("#found li").count() > 10
    page.goto((site / "search.html").as_uri() + "?q=<b>nothing'%22")
    page.locator("#found-heading").wait_for()
    assert page.inner_text("#found-heading") == "Nothing was found for “<b>nothing'\"”"


@pytest.mark.parametrize(
    ("words", "page_of"),
    [
        ("two_stage", "components/estimator/two_stage.html"),
        ("verdicts", "handbook/verdicts.html"),
        ("chen_table1", "runs/chen_table1.html"),
        ("wiener_hammerstein", "components/system/wiener_hammerstein.html"),
    ],
)
def test_what_is_looked_for_is_found(page: Page, site: Path, words: str, page_of: str) -> None:
    page.goto((site / "search.html").as_uri() + f"?q={words}")
    page.locator("#found li a").first.wait_for()
    links = page.evaluate("[...document.querySelectorAll('#found li a')].slice(0, 5).map(one => one.href)")
    assert any(link.partition("#")[0].endswith(page_of) for link in links), links
