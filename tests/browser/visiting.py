"""Pages of a site as a browser finds them.

Playwright drives the Chromium of the system: its package brings a driver, and needs no browser of its own.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

PROGRAM = "HIDENT_BROWSER"
"""Names the browser, if it is none of those that are looked for."""
PICTURES = "HIDENT_SCREENSHOTS"
"""Names the folder of the pictures of pages."""
_PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
NARROWEST = 360

_LOOK = """() => ({
    links: [...document.querySelectorAll("a[href], area[href]")].map(one => one.href),
    sources: [...document.querySelectorAll("[src], link[href], object[data], use[href], image[href]")]
        .map(one => one.currentSrc || one.src || one.data || (one.href.baseVal
            ? new URL(one.href.baseVal, document.baseURI).href : one.href)),
    ids: [...document.querySelectorAll("[id]")].map(one => one.id),
    width: document.documentElement.scrollWidth,
    headings: document.querySelectorAll("h1").length,
    shown: document.body.innerText.length,
})"""


@dataclass
class Visit:
    """What was found on a page, opened from its file in a narrow window."""

    faults: list[str] = field(default_factory=list)
    """Errors of the console, of scripts, and what could not be loaded."""
    links: list[str] = field(default_factory=list)
    sources: list[str] = field(default_factory=list)
    ids: list[str] = field(default_factory=list)
    width: int = 0
    headings: int = 0
    shown: int = 0


def program() -> str:
    """The program; without one the tests are skipped, and say how to get one."""
    pytest.importorskip("playwright", reason="playwright is not installed: make setup")
    named = os.environ.get(PROGRAM)
    found = named or next(filter(None, map(shutil.which, _PROGRAMS)), None)
    if found is None:
        pytest.skip(f"no browser is here: apt-get install chromium, or name one by {PROGRAM}")
    return found


def visited(site: Path, browser: Browser) -> Iterator[tuple[str, Visit]]:
    page = browser.new_page(viewport={"width": NARROWEST, "height": 800})
    faults = watched(page)
    for path in sorted(site.rglob("*.html")):
        faults.clear()
        page.goto(path.as_uri(), wait_until="load")
        yield path.relative_to(site).as_posix(), Visit(list(faults), **page.evaluate(_LOOK))
    page.close()


def watched(page: Page) -> list[str]:
    """A list to which everything that goes wrong on a page is added."""
    faults: list[str] = []
    page.on("console", lambda said: faults.append(said.text) if said.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.on("requestfailed", lambda request: _note_failed(faults, request))
    page.on("response", lambda answer: _note(faults, answer))
    return faults


def _note_failed(faults: list[str], request: Any) -> None:
    # What a page still loads when it is left is given up.
    if request.failure != "net::ERR_ABORTED":
        faults.append(f"{request.url} cannot be loaded ({request.failure})")


def _note(faults: list[str], answer: Any) -> None:
    if answer.status >= 400:
        faults.append(f"{answer.url}: {answer.status}")
