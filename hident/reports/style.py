"""The look of all figures: readable in grey, in a journal's column."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

# Dark to light and each with its own dash and marker, so that the lines part without colour too.
LINES: tuple[dict[str, Any], ...] = (
    {"color": "#1b4f8a", "linestyle": "-", "marker": "o"},
    {"color": "#c1440e", "linestyle": "--", "marker": "s"},
    {"color": "#2e7d5b", "linestyle": "-.", "marker": "^"},
    {"color": "#8e6bb0", "linestyle": (0, (1, 1)), "marker": "D"},
    {"color": "#a67c00", "linestyle": (0, (5, 1, 1, 1, 1, 1)), "marker": "v"},
)
TRUTH: dict[str, Any] = {"color": "black", "linewidth": 1.4, "zorder": 4}
ESTIMATE: dict[str, Any] = {"color": "#c1440e", "linewidth": 1.1, "zorder": 5}
DATA: dict[str, Any] = {"color": "0.62", "marker": ".", "linestyle": "none", "markersize": 3, "zorder": 1}

_SETTINGS: dict[str, Any] = {
    "font.size": 9,
    "axes.labelsize": 9,
    "axes.titlesize": 9,
    "legend.fontsize": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "0.9",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.2,
    "lines.markersize": 4,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
    "figure.dpi": 160,
    "savefig.dpi": 160,
}


@contextmanager
def style() -> Iterator[None]:
    """Apply the look inside the block, with a backend that needs no screen."""
    import matplotlib as mpl

    mpl.use("agg")
    with mpl.rc_context(_SETTINGS):  # type: ignore[arg-type]
        yield
