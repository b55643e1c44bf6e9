"""Pages as HTML: jinja2 with everything escaped."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import hident
from hident.reports.site import notation
from hident.reports.site.pages import COMPONENTS, FRONT, Page, Written, relative

if TYPE_CHECKING:
    import jinja2

TEMPLATES = Path(__file__).parent / "templates"
STATIC = Path(__file__).parent / "static"
POLICY = (
    "default-src 'none'; script-src 'self' file:; style-src 'self' file: 'unsafe-inline'; "
    "img-src 'self' file:; form-action 'self' file:; base-uri 'none'"
)
"""What a page may load: files of the site alone, which to some browsers a page in a file is not part of."""
NAVIGATION = {
    "Ledger": FRONT,
    "Runs": "runs/index.html",
    "Components": COMPONENTS,
    "Handbook": "handbook/index.html",
    "Index": "search.html",
}
"""The sections of the site, and the page of each that is seen first."""


def rendered(page: Page) -> Written:
    """The page with its HTML."""

    def to(target: str) -> str:
        return relative(target, page.path)

    template = _environment().get_template(page.template)
    html = template.render(
        {
            **page.data,
            "page": page,
            "to": to,
            "navigation": NAVIGATION,
            "policy": POLICY,
            "version": hident.__version__,
        }
    )
    return Written(page.path, page.title, page.section, html, page.text, page.passages)


@cache
def _environment() -> jinja2.Environment:
    import jinja2
    import markupsafe

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["default_counts"] = _every_word
    environment.filters["typeset"] = lambda text: markupsafe.Markup(notation.in_words(str(text)))
    return environment


def _every_word(counts: Mapping[str, int], words: Sequence[str]) -> dict[str, int]:
    """The counts of all words, with 0 where there is none."""
    return {word: counts.get(word, 0) for word in words}
