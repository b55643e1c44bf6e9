"""Markdown as HTML, by markdown-it: no HTML of a text comes through, and links lead to pages of the site."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Callable, Iterator, MutableMapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from html import escape
from itertools import groupby, pairwise
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import unquote

from hident.reports.site.notation import formula, in_words
from hident.reports.site.pages import (
    COMPONENTS,
    Passage,
    handbook_page,
    paper_page,
    relative,
    run_file,
    run_page,
)

if TYPE_CHECKING:
    from markdown_it import MarkdownIt
    from markdown_it.token import Token

_SHELLS = ("console", "sh", "shell")
_PLAIN = ("", "text")


class Heading(NamedTuple):
    """A heading below the title."""

    level: int
    anchor: str
    title: str


@dataclass(frozen=True)
class Document:
    """A text as HTML."""

    title: str
    """Its first heading; empty if there is none."""
    body: str
    headings: tuple[Heading, ...]
    """Those of the second and third level."""
    passages: tuple[Passage, ...]
    """What stands under each of these headings, for the search."""


def html(text: str, page: str, folder: str, exists: Callable[[str], bool]) -> str:
    """A text as HTML for a page; see :func:`document`."""
    return document(text, page, folder, exists).body


def document(
    text: str, page: str, folder: str, exists: Callable[[str], bool], *, formulas: bool = False
) -> Document:
    """A text as HTML for a page.

    ``folder`` is that of its file, from the root of the project; a link to a file that has no page in the
    site, by ``exists``, is left out, and its text stays. The name of a run in backticks leads to its page.
    With ``formulas`` an indented block is a formula, as in docstrings, and no code.
    """
    parser = _parser()
    tokens = parser.parse(text)
    for token in tokens:
        if token.children:
            token.children = list(_linked(token.children, page, folder, exists))
    _number_headings(tokens)
    body = str(parser.renderer.render(tokens, parser.options, {"formulas": formulas}))
    found = [
        Heading(int(opening.tag[1]), str(opening.attrs["id"]), "".join(_texts(content)))
        for opening, content in pairwise(tokens)
        if opening.type == "heading_open"
    ]
    title = next((heading.title for heading in found if heading.level == 1), "")
    below = tuple(heading for heading in found if heading.level in (2, 3))
    return Document(title, body, below, tuple(_passages(tokens, title)))


def code(text: str, language: str) -> str:
    """A block of code with its words marked for the stylesheet; plain where the language is not known.

    Examples
    --------
    >>> code("a < b", "text")
    '<pre><code>a &lt; b</code></pre>\\n'
    """
    return f"<pre><code{_class(language)}>{_marked(text, language)}</code></pre>\n"


def slug(heading: str) -> str:
    """The anchor of a heading, as code hosts make it.

    Examples
    --------
    >>> slug("Alternatives and mutation score")
    'alternatives-and-mutation-score'
    """
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def site_path(path: str) -> str | None:
    """Where a file of the project stands in the site; None if nowhere.

    Examples
    --------
    >>> site_path("results/mzyk_table1/table.md")
    'runs/mzyk_table1.html'
    """
    match path.split("/"):
        case ["results", "bench.md"]:
            return handbook_page("bench")
        case ["results", name, "table.md"]:
            return run_page(name)
        case ["results", "power", name, *_]:
            return run_page(name)
        case ["results", name, file]:
            return run_file(name, file)
        case ["configs", file] if file.endswith(".yaml"):
            return run_page(file.removesuffix(".yaml"))
        case ["experiments", paper] | ["experiments", paper, "README.md"]:
            return paper_page(paper)
        case ["docs", "reference.md"]:
            return COMPONENTS
        case ["README.md"]:
            return handbook_page("README")
        case ["docs", file] if file.endswith(".md"):
            return handbook_page(file.removesuffix(".md"))
        case ["docs", file] | [file]:
            return f"handbook/{file}"
    return None


def _address(link: str, page: str, folder: str, exists: Callable[[str], bool]) -> str | None:
    """The address of what a link means, on a page; None if the site does not hold it."""
    if re.match(r"[a-z][a-z0-9+.-]*:|//|#", link, re.IGNORECASE):
        return link
    path, mark, anchor = link.partition("#")
    target = site_path(posixpath.normpath(posixpath.join(folder, unquote(path))))
    return relative(f"{target}{mark}{anchor}", page) if target and exists(target) else None


def _linked(
    tokens: Sequence[Token],
    page: str,
    folder: str,
    exists: Callable[[str], bool],
) -> Iterator[Token]:
    """The tokens of a line with addresses of the site; links and pictures that lead nowhere become words."""
    from markdown_it.token import Token

    inside: list[bool] = []
    for token in tokens:
        match token.type:
            case "link_open":
                address = _address(str(token.attrs.get("href", "")), page, folder, exists)
                inside.append(address is not None)
                if address is not None:
                    token.attrs["href"] = address
                    yield token
            case "link_close":
                if inside.pop():
                    yield token
            case "image":
                address = _address(str(token.attrs.get("src", "")), page, folder, exists)
                if address is None:
                    yield from token.children or ()
                else:
                    token.attrs |= {"src": address, "loading": "lazy"}
                    yield token
            case "code_inline" if not inside and exists(target := run_page(_stem(token.content))):
                yield Token("link_open", "a", 1, {"href": relative(target, page)})
                yield token
                yield Token("link_close", "a", -1)
            case _:
                yield token


def _stem(name: str) -> str:
    """The name of a configuration, where its file is meant."""
    return name.removeprefix("configs/").removesuffix(".yaml")


def _number_headings(tokens: Sequence[Token]) -> None:
    """Give each heading its anchor."""
    seen: dict[str, int] = {}
    for opening, content in pairwise(tokens):
        if opening.type == "heading_open":
            anchor = slug("".join(_texts(content)))
            seen[anchor] = seen.get(anchor, -1) + 1
            opening.attrs["id"] = f"{anchor}-{seen[anchor]}" if seen[anchor] else anchor


def _passages(tokens: Sequence[Token], title: str) -> Iterator[Passage]:
    anchor, name, said = "", title, list[str]()
    for before, token in pairwise([tokens[0], *tokens] if tokens else ()):
        if token.type == "heading_open" and token.tag in ("h2", "h3"):
            yield Passage(anchor, name, " ".join(said))
            anchor, said = str(token.attrs["id"]), []
        elif before.type == "heading_open" and before.tag in ("h1", "h2", "h3"):
            name = "".join(_texts(token))
        elif token.type == "inline":
            said.append("".join(_texts(token)))
        elif token.type in ("fence", "code_block"):
            said.append(" ".join(token.content.split()))
    yield Passage(anchor, name, " ".join(said))


def _texts(token: Any) -> Iterator[str]:
    for child in token.children or ():
        if child.type in ("text", "code_inline"):
            yield child.content
        elif child.type in ("softbreak", "hardbreak"):
            yield " "


@cache
def _parser() -> MarkdownIt:
    from markdown_it import MarkdownIt

    # HTML is parsed, so that comments can be left out, and then shown as it is written.
    parser = MarkdownIt("commonmark", {"html": True}).enable("table")
    for name, rule in _RULES.items():
        parser.add_render_rule(name, rule)
    return parser


def _written(
    renderer: Any, tokens: Sequence[Token], i: int, options: Any, env: MutableMapping[str, Any]
) -> str:
    content = tokens[i].content
    return "" if re.fullmatch(r"\s*<!--.*?-->\s*", content, re.DOTALL) else escape(content)


def _words(
    renderer: Any, tokens: Sequence[Token], i: int, options: Any, env: MutableMapping[str, Any]
) -> str:
    return in_words(tokens[i].content)


def _fence(
    renderer: Any, tokens: Sequence[Token], i: int, options: Any, env: MutableMapping[str, Any]
) -> str:
    return code(tokens[i].content, unquote(tokens[i].info).strip().partition(" ")[0])


def _indented(
    renderer: Any, tokens: Sequence[Token], i: int, options: Any, env: MutableMapping[str, Any]
) -> str:
    content = tokens[i].content.rstrip("\n")
    return f'<div class="formula">{formula(content)}</div>\n' if env["formulas"] else code(content, "text")


def _heading(
    renderer: Any, tokens: Sequence[Token], i: int, options: Any, env: MutableMapping[str, Any]
) -> str:
    """The end of a heading, with a link to itself for who wants to point at it."""
    opening = next(token for token in reversed(tokens[:i]) if token.type == "heading_open")
    if opening.tag == "h1":
        return "</h1>\n"
    anchor = escape(str(opening.attrs["id"]))
    link = f' <a class="anchor" href="#{anchor}" aria-label="Link to this section">#</a>'
    return f"{link}</{opening.tag}>\n"


def _table(
    renderer: Any, tokens: Sequence[Token], i: int, options: Any, env: MutableMapping[str, Any]
) -> str:
    if tokens[i].nesting < 0:
        return "</table></div>\n"
    env["tables"] = number = env.get("tables", 0) + 1
    return f'<div class="scroll" role="region" aria-label="Table {number}" tabindex="0"><table>\n'


_RULES = {
    "html_block": _written,
    "html_inline": _written,
    "text": _words,
    "fence": _fence,
    "code_block": _indented,
    "heading_close": _heading,
    "table_open": _table,
    "table_close": _table,
}


def _class(language: str) -> str:
    return "" if language in _PLAIN else f' class="language-{escape(language)}"'


def _marked(text: str, language: str) -> str:
    """The text, escaped, with the few words that the stylesheet sets apart in spans."""
    from pygments.util import ClassNotFound

    text = text.rstrip("\n")
    if language in _PLAIN:
        return escape(text, quote=False)
    try:
        lexer = _lexer(language)
    except ClassNotFound:
        return escape(text, quote=False)
    return "".join(
        f'<span class="{name}">{said}</span>' if name else said
        for name, words in groupby(lexer.get_tokens(text), lambda token: _look(token[0]))
        for said in [escape("".join(word for _, word in words), quote=False)]
    ).rstrip("\n")


@cache
def _look(kind: Any) -> str:
    from pygments import token as t

    looks = {
        "comment": (t.Comment,),
        "string": (t.String,),
        "keyword": (t.Keyword, t.Name.Tag, t.Operator.Word),
        "prompt": (t.Generic.Prompt,),
        "output": (t.Generic.Output,),
    }
    return next((name for name, kinds in looks.items() if any(kind in one for one in kinds)), "")


@lru_cache
def _lexer(language: str) -> Any:
    from pygments.lexers import get_lexer_by_name

    return get_lexer_by_name("bash" if language in _SHELLS else language, stripnl=False)
