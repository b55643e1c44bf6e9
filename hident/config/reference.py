"""All keys of configurations in Markdown, as docs/reference.md holds them."""

from __future__ import annotations

from collections.abc import Iterator

from hident.config.describe import fields
from hident.config.spec import PLURALS, Component, Spec, components, own_docstring

_HEAD = """# All keys of configurations

`hident schema --markdown` writes this page from the code, with the components of plugins too.
`hident list estimators kernel` prints one entry of it; [configuration.md](configuration.md) shows how a
file is written."""
_HEADER = ("key", "holds", "default", "meaning")


def markdown(model: type[Spec]) -> str:
    """The keys of a model, then those of every registered component under its family and its kind."""
    lines = [_HEAD, "", *_contents(), "", "## The file", "", *_table(model)]
    for plural, family in PLURALS.items():
        lines += ["", f"## {plural}"]
        for kind, cls in components(family).items():
            lines += ["", f"### {kind}", "", *about(cls)]
    return "\n".join(lines) + "\n"


def _contents() -> Iterator[str]:
    for plural, family in PLURALS.items():
        yield f"- [{plural}](#{plural}): {', '.join(f'`{kind}`' for kind in components(family))}"


def about(cls: type[Component]) -> Iterator[str]:
    yield plain(own_docstring(cls))
    if cls.source:
        yield ""
        yield f"Source: {cls.source}."
    if cls.model_fields:
        yield ""
        yield from _table(cls)


def _table(spec: type[Spec]) -> Iterator[str]:
    yield f"| {' | '.join(_HEADER)} |"
    yield "| --- | --- | --- | --- |"
    for path, holds, default, meaning in fields(spec):
        cells = (f"`{path}`", holds, default, plain(meaning))
        escaped = (" ".join(cell.replace("|", r"\|").split()) for cell in cells)
        yield f"| {' | '.join(escaped)} |"


def plain(text: str) -> str:
    """A docstring's text as Markdown: code stands between single backticks there, and a star is a star.

    An indented paragraph, such as an equation, is a block of its own there, and stays as it is.
    """

    def words(paragraph: str) -> str:
        parts = paragraph.replace("``", "`").split("`")
        return "`".join(part if i % 2 else part.replace("*", r"\*") for i, part in enumerate(parts))

    paragraphs = text.split("\n\n")
    return "\n\n".join(p if p.startswith("    ") else words(p) for p in paragraphs)
