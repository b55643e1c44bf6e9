"""Where figures are drawn: their sizes in print, and the grid of panels that repeats a figure.

A figure asks :func:`subplots` for its axes, and knows nothing of either: without a canvas it gets what it
asks for.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from hident.reports.mathematics import typeset

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure

Size = Literal["column", "page"]
WIDTHS: dict[Size, float] = {"column": 88.0, "page": 180.0}
"""Widths in mm of a column and of the text of a page, which fit the two-column pages of most journals."""
_INCH = 25.4
# The height of the text of a page, in mm, less a caption.
_HEIGHT = 220.0
# A panel's height follows its width no further than by these factors, or it would be a strip or a tower.
_FLATTEST, _TALLEST = 0.65, 1.15
# The share of its width that a panel keeps, if panels may stand below each other.
_ROOMY = 0.6
# Inches that a panel is wide in any case.
_NARROWEST = 0.85
# Share of a number's height that is free between it and the next one of an axis.
_APART = 0.35
# Inches that a letter of a title takes, and what stands beside axes.
_LETTER, _LABELS = 0.062, 0.3
_SMALL = {
    "font.size": 8,
    "axes.labelsize": 8,
    "axes.titlesize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "legend.title_fontsize": 7,
}


class Canvas:
    """The figure of a size in print, or of rows and columns of panels, in each of which one is drawn."""

    def __init__(self, size: Size | None, rows: int = 1, columns: int = 1) -> None:
        self.size, self.rows, self.columns = size, rows, columns
        self.at = (0, 0)
        """The row and the column of the panel that is drawn."""
        self.figure: Figure | None = None
        self.cells: dict[tuple[int, int], list[Any]] = {}
        """The axes of each panel."""
        self._grid: Any = None

    @property
    def shared(self) -> bool:
        """Whether it holds several panels, which share one legend."""
        return self.rows * self.columns > 1

    @property
    def width(self) -> float | None:
        """The width in inches that is given; panels take that of a page at most."""
        return None if self.size is None else WIDTHS[self.size] / _INCH

    @property
    def room(self) -> float:
        """Inches that a panel may be wide."""
        return (self.width or WIDTHS["page"] / _INCH) / self.columns

    @property
    def can_be_wider(self) -> bool:
        """Whether another ``size`` than the one that is asked for is wider."""
        return self.width is not None and self.width < WIDTHS["page"] / _INCH

    def fits(self, height: float) -> bool:
        """Whether rows of panels of a height in inches are no higher than the page."""
        return height * self.rows * _INCH <= _HEIGHT

    def fit(self, height: float, remedy: str) -> None:
        """ValueError, with a remedy, if they are higher."""
        if not self.fits(height):
            needed = height * self.rows * _INCH
            raise ValueError(f"it would be {needed:.0f} mm high, and a page has {_HEIGHT:.0f}: {remedy}")

    def beside(self, columns: int, width: float) -> int:
        """How many of so many axes, which may stand below each other too, stand side by side."""
        room = self.width or WIDTHS["page"] / _INCH
        if self.width is None and columns * width * self.columns <= room:
            return columns
        return max(1, min(columns, int(room / self.columns / (_ROOMY * width))))

    def subplots(self, rows: int, columns: int, figsize: tuple[float, float], options: dict[str, Any]) -> Any:
        """The figure, or the part of it that the panel is, and its axes."""
        alone = rows * columns == 1
        if self.figure is None:
            self.figure = _new(self._inches(columns, figsize))
            if self.shared and alone:
                grid = self.figure.subplots(self.rows, self.columns, sharex=True, sharey=True, squeeze=False)
                self._grid = grid
            elif self.shared:
                self._grid = self.figure.subfigures(self.rows, self.columns, squeeze=False)
        if self.shared and alone:
            axes = self._grid[self.at]
            self.cells[self.at] = [axes]
            return self.figure, axes if options.get("squeeze", True) else np.array([[axes]])
        part: Figure | SubFigure = self._grid[self.at] if self.shared else self.figure
        axes = part.subplots(rows, columns, **options)
        self.cells[self.at] = [*np.ravel(axes)]
        return part, axes

    def _inches(self, columns: int, figsize: tuple[float, float]) -> tuple[float, float]:
        wanted = figsize[0] * self.columns
        width = self.width or min(wanted, WIDTHS["page"] / _INCH)
        if width / (columns * self.columns) < _NARROWEST:
            wider = "'size: page', or " if width < WIDTHS["page"] / _INCH else ""
            raise ValueError(
                f"{columns * self.columns} panels side by side are too narrow in {width * _INCH:.0f} mm: "
                f"take {wider}fewer columns"
            )
        height = min(max(width / wanted, _FLATTEST), _TALLEST) * figsize[1] * self.rows
        return width, min(height, _HEIGHT / _INCH)

    def empty(self) -> None:
        """Leave the panel empty, in which nothing is to be shown."""
        self.cells[self.at] = []

    def finish(self, titles: list[str], sides: list[str]) -> None:
        """Title the columns and rows of panels, give them common limits, and label the outer axes only."""
        if self.figure is None:
            return
        if self.shared:
            self._join(titles, sides)
        self._wrap_titles()
        self._thin_ticks()

    def _join(self, titles: list[str], sides: list[str]) -> None:
        alone = self._grid is not None and hasattr(self._grid[0, 0], "set_xlabel")
        drawn = [at for at, axes in self.cells.items() if axes]
        for (row, column), axes in self.cells.items():
            cell = self._grid[row, column]
            if not axes and alone:
                cell.set_visible(False)
            elif alone and not cell.axison:
                # Beside it stand texts of its own.
                _title(cell, ", ".join(filter(None, (sides[row], titles[column]))), "")
            elif alone:
                is_first = row == min(i for i, j in drawn if j == column)
                is_last = column == max(j for i, j in drawn if i == row)
                _title(cell, titles[column] if is_first else "", sides[row] if is_last else "")
                if self.cells.get((row + 1, column)):
                    cell.set_xlabel("")
                if self.cells.get((row, column - 1)):
                    cell.set_ylabel("")
            else:
                cell.suptitle(", ".join(filter(None, (sides[row], titles[column]))), fontsize="medium")
        if alone:
            last = max(row for row, column in self.cells if self.cells[row, column])
            _one_label([a for (row, _), [*axes] in self.cells.items() for a in axes if row == last], "x")
            _one_label([a for (_, column), [*axes] in self.cells.items() for a in axes if not column], "y")
        else:
            _common_limits([axes for axes in self.cells.values() if axes])

    def _wrap_titles(self) -> None:
        """Break titles at their commas that are wider than their axes."""
        assert self.figure is not None
        for axes in (one for cell in self.cells.values() for one in cell):
            place = axes.get_subplotspec()
            beside = place.get_gridspec().ncols / len(place.colspan)
            across = self.columns if axes.figure is not self.figure else 1
            letters = int((self.figure.get_figwidth() / across / beside - _LABELS) / _LETTER)
            lines = (part for line in axes.get_title().split("\n") for part in _lines(line, letters))
            axes.set_title("\n".join(lines))

    def _thin_ticks(self) -> None:
        """Leave out numbers that a figure sets along its abscissa and that would touch; their marks stay."""
        from matplotlib.ticker import FixedLocator

        assert self.figure is not None
        axes = [one for cell in self.cells.values() for one in cell]
        if not any(isinstance(one.xaxis.get_major_locator(), FixedLocator) for one in axes):
            return
        typeset(self.figure)
        self.figure.draw_without_rendering()
        for one in axes:
            if isinstance(one.xaxis.get_major_locator(), FixedLocator):
                texts = [label.get_text() for label in one.get_xticklabels()]
                boxes = [label.get_window_extent() for label in one.get_xticklabels()]
                kept = _apart([(box.x0, box.x1, _APART * box.height) for box in boxes])
                words = [text if i in kept else "" for i, text in enumerate(texts)]
                # Panels share their marks, and those above others may show no numbers.
                if any(words) and words != texts:
                    one.set_xticks(one.get_xticks(), words)


def _apart(spans: Sequence[tuple[float, float, float]]) -> set[int]:
    """Which of texts with these beginnings, ends and distances are kept, so that none touch.

    The first and the last are, and of the others as many as fit, from the left.

    Examples
    --------
    >>> sorted(_apart([(0, 10, 2), (11, 21, 2), (30, 40, 2), (41, 51, 2)]))
    [0, 3]
    >>> sorted(_apart([(0, 10, 2), (15, 25, 2), (30, 40, 2)]))
    [0, 1, 2]
    """
    order = sorted((i for i, span in enumerate(spans) if span[1] > span[0]), key=lambda i: spans[i][0])
    if not order:
        return set()
    first, last = order[0], order[-1]
    kept = [first]
    for i in order[1:-1]:
        start, end, free = spans[i]
        if spans[kept[-1]][1] + free <= start and end + free <= spans[last][0]:
            kept.append(i)
    if last != first and spans[kept[-1]][1] + spans[last][2] <= spans[last][0]:
        kept.append(last)
    return set(kept)


def _one_label(beside: Sequence[Any], along: Literal["x", "y"]) -> None:
    """One label in the middle of axes beside each other, or below, in the place of equal ones.

    The room of a label along its axis is none of the layout's matter, so that it may be longer than the axes.
    """
    labels = [getattr(axes, f"get_{along}label")() for axes in beside]
    if len(set(labels)) > 1 or len(labels) < 2:
        return
    middle = (len(beside) - 1) // 2
    for i, axes in enumerate(beside):
        getattr(axes, f"set_{along}label")(labels[0] if i == middle else "")
    if len(beside) % 2 == 0:
        # Between the two in the middle: the axes go down, and their coordinate up.
        between = {"x": 1.05} if along == "x" else {"y": -0.05}
        getattr(beside[middle], f"set_{along}label")(labels[0], **between)


def _title(axes: Any, above: str, beside: str) -> None:
    axes.set_title("\n".join(filter(None, (above, axes.get_title()))))
    if beside:
        look = {"rotation": 270, "ha": "left", "va": "center", "fontsize": "medium"}
        axes.annotate(beside, (1.03, 0.5), xycoords="axes fraction", **look)


def _lines(text: str, letters: int) -> Iterator[str]:
    """A text in lines of so many letters, broken at commas outside of brackets only."""
    line, *parts = re.split(r", (?![^()]*\))", text)
    for part in parts:
        if len(line) + len(part) + 2 > letters:
            yield f"{line},"
            line = part
        else:
            line = f"{line}, {part}"
    yield line


def _common_limits(cells: list[list[Any]]) -> None:
    """The same limits for the axes that stand at the same place of their panels."""
    for axes in zip(*cells, strict=False):
        for get, put in (("get_xlim", "set_xlim"), ("get_ylim", "set_ylim")):
            ends = np.array([getattr(one, get)() for one in axes])
            for one in axes:
                getattr(one, put)(ends[:, 0].min(), ends[:, 1].max())


_CURRENT: ContextVar[Canvas | None] = ContextVar("canvas", default=None)


def canvas() -> Canvas | None:
    """The canvas that is drawn on; None where a figure is as it asks to be."""
    return _CURRENT.get()


@contextmanager
def drawn_on(canvas: Canvas) -> Iterator[Canvas]:
    """Draw on a canvas inside the block, in the smaller letters of print."""
    import matplotlib as mpl

    small: Any = _SMALL
    token = _CURRENT.set(canvas)
    try:
        with mpl.rc_context(small):
            yield canvas
    finally:
        _CURRENT.reset(token)


def subplots(rows: int, columns: int, figsize: tuple[float, float], options: dict[str, Any]) -> Any:
    """A figure of a size in inches and its axes; on a canvas, what that has room for."""
    if (current := canvas()) is not None:
        return current.subplots(rows, columns, figsize, options)
    figure = _new(figsize)
    return figure, figure.subplots(rows, columns, **options)


def _new(figsize: tuple[float, float]) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=figsize)
    FigureCanvasAgg(figure)
    return figure
