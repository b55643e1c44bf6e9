"""The look of all figures: readable in grey, in a journal's column."""

from __future__ import annotations

import io
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from hident.arrays import Array
from hident.engine.run_files import Format
from hident.reports import canvas

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

Look = dict[str, Any]
"""Keywords of matplotlib's plot."""

# Dark to light and each with its own dash and marker, so that the lines part without colour too.
LINES: tuple[Look, ...] = (
    {"color": "#1b4f8a", "linestyle": "-", "marker": "o"},
    {"color": "#c1440e", "linestyle": "--", "marker": "s"},
    {"color": "#2e7d5b", "linestyle": "-.", "marker": "^"},
    {"color": "#8e6bb0", "linestyle": (0, (1, 1)), "marker": "D"},
    {"color": "#a67c00", "linestyle": (0, (5, 1, 1, 1, 1, 1)), "marker": "v"},
    {"color": "#c77d9b", "linestyle": (0, (8, 2)), "marker": "P"},
)
"""As many curves as a figure can tell apart: more are refused, with a word on facets."""
TRUTH: Look = {"color": "black", "linewidth": 1.4, "zorder": 4}
TRUE_LEVEL: Look = {"color": "black", "linewidth": 1.0, "zorder": 1}
"""A line across a panel at a true number: behind the estimates, and over the grid."""
ESTIMATE: Look = {"color": "#c1440e", "linewidth": 1.1, "zorder": 5}
PRINTED: Look = {"linestyle": "none", "markerfacecolor": "none", "markeredgewidth": 1.3, "markersize": 8}
"""Of a printed number: an open marker, of ours beside it larger, in the colour and shape of a line."""
DATA: Look = {"color": "0.62", "marker": ".", "linestyle": "none", "markersize": 3, "zorder": 1}

PIXELS = 160
"""Of a PNG, in an inch."""
_PRINT_DPI = 300
_METADATA: dict[str, tuple[str, ...]] = {
    "png": ("Software",),
    "pdf": ("Creator", "Producer", "CreationDate"),
    "svg": ("Creator", "Date"),
}
_MARKS = 9
# Inches that a letter of a legend takes, and a handle with the space around it.
_LETTER = 0.064
_HANDLE = 0.55
# Of the letters of print.
_SMALLER = 0.88
_SETTINGS: dict[str, Any] = {
    "font.size": 9,
    "axes.labelsize": 9,
    "axes.titlesize": 9,
    "legend.fontsize": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "0.9",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.2,
    "lines.markersize": 4,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
    "figure.dpi": PIXELS,
    "savefig.dpi": PIXELS,
    # Letters as they are in a PDF, which a journal may edit; as outlines in an SVG, which names fonts only.
    "pdf.fonttype": 42,
    "svg.fonttype": "path",
    "svg.hashsalt": "hident",
}


@contextmanager
def style() -> Iterator[None]:
    """Apply the look inside the block, whatever settings of matplotlib the user has."""
    import matplotlib as mpl

    # Nothing here needs a backend, but the figure of a plugin may come from pyplot.
    shipped = {name: mpl.rcParamsDefault[name] for name in mpl.rcParamsDefault if name != "backend"}
    settings: Any = {**shipped, **_SETTINGS, "backend": "agg"}
    with mpl.rc_context(settings):
        try:
            yield
        finally:
            if "matplotlib.pyplot" in sys.modules:
                sys.modules["matplotlib.pyplot"].close("all")


def subplots(
    rows: int = 1, columns: int = 1, *, figsize: tuple[float, float], **options: Any
) -> tuple[Figure, Any]:
    """A figure of a size in inches and its axes, as pyplot's function has them but without its backends.

    In print, or as one of several panels, they take what room there is.
    """
    figure, axes = canvas.subplots(rows, columns, figsize, options)
    return figure, axes


def symbol(name: str) -> str:
    """A parameter's name for a figure: a_1 with its index below the line, any other as it is."""
    letter, underscore, index = name.partition("_")
    return f"${letter}_{{{index}}}$" if underscore else name


def looks(labels: Iterable[str]) -> dict[str, Look]:
    """One look for each label, the same in all panels of a figure."""
    return {label: LINES[i % len(LINES)] for i, label in enumerate(dict.fromkeys(labels))}


def marked(look: Look, place: int, points: int) -> Look:
    """The look with a few markers only, which those of other curves do not cover."""
    step = max(1, points // _MARKS)
    return {**look, "markevery": (place * step // 5 % step, step)}


def band_edge(look: Look) -> Look:
    """The look of the edges of a band, which tell overlapping ones apart without colour."""
    return {**look, "linewidth": 0.6, "alpha": 0.6, "marker": ""}


def draw_band(axes: Axes, x: Array, curves: Array, look: Look, label: str, share: float) -> None:
    """The band that holds this central share of some curves (T, K) at each point x (K,); nothing of one."""
    curves = curves[np.all(np.isfinite(curves), axis=1)]
    if len(curves) < 2:
        return
    low, high = np.quantile(curves, [0.5 - share / 2.0, 0.5 + share / 2.0], axis=0)
    named = f"{label}, central {100 * share:g} %"
    axes.fill_between(x, low, high, color=look["color"], alpha=0.2, linewidth=0, label=named)
    for edge in (low, high):
        axes.plot(x, edge, **band_edge(look))


def beside(columns: int, width: float) -> int:
    """How many of so many panels of a width in inches stand side by side, if others may stand below."""
    current = canvas.canvas()
    return columns if current is None else current.beside(columns, width)


def panel_rows(
    count: int, columns: int, size: tuple[float, float], around: tuple[float, float], **options: Any
) -> tuple[Figure, Any]:
    """A figure of so many panels of a size in inches, with room around them, and the rows of its axes."""
    columns = beside(min(columns, count), size[0])
    rows = -(-count // columns)
    figsize = (size[0] * columns + around[0], size[1] * rows + around[1])
    figure, grid = subplots(rows, columns, squeeze=False, figsize=figsize, **options)
    for axes in grid.flat[count:]:
        axes.set_visible(False)
    return figure, grid


def panel_grid(count: int, columns: int, width: float, height: float) -> tuple[Figure, list[Axes]]:
    """A figure of so many panels of a size in inches, row by row."""
    figure, grid = panel_rows(count, columns, (width, height), (0.4, 0.5))
    return figure, list(grid.flat[:count])


def label_edges(grid: Any, x_label: str, y_label: str) -> None:
    """Label the abscissas of the lowest axes of each column, and the ordinates of the first column."""
    for column in grid.T:
        lowest = [axes for axes in column if axes.get_visible()][-1]
        if lowest is not column[-1]:
            # The last row is short, and axes that share theirs show no numbers above it.
            lowest.tick_params(labelbottom=True)
        lowest.set_xlabel(x_label)
    for axes in grid[:, 0]:
        axes.set_ylabel(y_label)


def few_log_ticks(axis: Axis) -> None:
    """Numbers at 1, 2 and 5 of each decade of a logarithmic axis; where it holds one of them, at others."""
    from matplotlib.ticker import AutoLocator, LogLocator, NullLocator

    class Few(LogLocator):
        # Matplotlib does so too, but not where the one is a power of ten: it counts that twice.
        def tick_values(self, vmin: float, vmax: float) -> Any:
            found = super().tick_values(vmin, vmax)
            inside = [tick for tick in found if min(vmin, vmax) <= tick <= max(vmin, vmax)]
            return found if len(inside) > 1 else AutoLocator().tick_values(vmin, vmax)

    axis.set_major_locator(Few(subs=(1, 2, 5)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_locator(NullLocator())


def composed() -> bool:
    """Whether the figure is sized for print or one of several panels: then its legend stands above."""
    return canvas.canvas() is not None


def shared_legend(figure: Figure, entries: tuple[Any, Any], columns: int) -> None:
    """The legend of panels with the same entries, above them, in so many columns at most."""
    if composed():
        legend_above(figure)
    else:
        columns = min(columns, len(entries[1]))
        figure.legend(*entries, loc="outside upper center", ncols=columns)


def printed(figure: Figure, kinds: Iterable[Format]) -> dict[Format, bytes]:
    """The figure as png, pdf or svg; the bytes depend on what it shows alone, not on the other formats.

    Neither the writer's version nor the time stands in them.
    """
    found: dict[Format, bytes] = {"png": _file(figure, "png")}
    # Each drawing would move the axes by less than a pixel.
    figure.set_layout_engine("none")
    return {kind: found.get(kind) or _file(figure, kind) for kind in kinds}


def _file(figure: Figure, kind: str) -> bytes:
    file = io.BytesIO()
    # What is made of pixels within a drawing is for print.
    options: dict[str, Any] = {} if kind == "png" else {"dpi": _PRINT_DPI}
    figure.savefig(file, format=kind, metadata=dict.fromkeys(_METADATA[kind]), **options)
    return file.getvalue()


def write_below(figure: Figure, text: str) -> None:
    """A small text in the corner below all panels."""
    figure.supxlabel(text, x=0.99, ha="right", fontsize=7, color="0.35")


def legend_above(figure: Figure) -> None:
    """One legend above all panels, in which each label stands once, in as few rows as its labels allow.

    Of several panels it is drawn when the last one is.
    """
    current = canvas.canvas()
    if current is None or not current.shared:
        draw_legend(figure)


def draw_legend(figure: Figure) -> None:
    """The legend above all panels of a figure."""
    entries = (zip(*axes.get_legend_handles_labels(), strict=True) for axes in figure.axes)
    handles = {label: handle for pairs in entries for handle, label in pairs}
    if handles:
        scale = _SMALLER if composed() else 1.0
        columns = legend_columns([len(label) for label in handles], figure.get_figwidth(), scale)
        figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=columns)


def legend_columns(lengths: Sequence[int], width: float, scale: float = 1.0) -> int:
    """How many columns of labels with these numbers of letters, at least one, fit a width in inches.

    ``scale`` is that of the letters.
    """
    count = len(lengths)
    for rows in range(1, count):
        # Matplotlib fills column by column.
        columns = [lengths[i : i + rows] for i in range(0, count, rows)]
        if scale * (_LETTER * sum(map(max, columns)) + _HANDLE * len(columns)) <= width:
            return len(columns)
    return 1
