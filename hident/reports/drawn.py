"""What a figure draws, as numbers: so that it can be drawn again, and read without a ruler."""

from __future__ import annotations

import lzma
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hident.arrays import Array

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

COLUMNS = ("panel", "title", "x_label", "y_label", "curve", "shape", "x", "y", "y_to", "at")
"""The columns; ``y_to`` is where a band or bar ends that begins at y, ``at`` the nearest tick in words."""
_NO_LABEL = re.compile(r"_(child\d+|nolegend_)?")
_Points = tuple[str, str, Array, Array, Array | None]
"""The label of a curve, its shape, x, y, and where it is a band or a bar the other ends of y."""


def drawn(figure: Figure) -> pd.DataFrame:
    """The numbers that a figure draws, a row for each point, with :data:`COLUMNS`.

    A ``shape`` is a line, points, a band, a bar or a contour. What reaches across a panel, such as the line
    of a true value, has no number in the other direction. A curve without a label has that of the curve
    that looks the same; a label that begins with ``_`` stands here, though in no legend. Colours behind
    contours are left out.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> figure = Figure()
    >>> axes = figure.subplots()
    >>> axes.set(xlabel="samples", ylabel="error")  # doctest: +ELLIPSIS
    [...]
    >>> _ = axes.plot([10, 20], [0.5, 0.25], label="ours")
    >>> drawn(figure)[["panel", "x_label", "curve", "shape", "x", "y"]].values.tolist()
    [[1, 'samples', 'ours', 'line', 10.0, 0.5], [1, 'samples', 'ours', 'line', 20.0, 0.25]]
    """
    import pandas as pd

    looks = dict(_looks(figure))
    parts = []
    panels = [axes for axes in figure.axes if axes.get_visible()]
    for number, axes in enumerate(panels, start=1):
        said = (_line(axes.get_title()), _axis_label(axes, "x", panels), _axis_label(axes, "y", panels))
        words = [_words(axis) for axis in (axes.xaxis, axes.yaxis)]
        for label, shape, x, y, to in _curves(axes, looks):
            part = pd.DataFrame({"x": x, "y": y, "y_to": np.nan if to is None else to})
            told: dict[str, Any] = dict(zip(COLUMNS, (number, *said, label, shape), strict=False))
            parts.append(part.assign(**told, at=_nearest(words, part)))
    if not parts:
        return pd.DataFrame(columns=COLUMNS)
    return pd.concat(parts, ignore_index=True)[list(COLUMNS)]


def _line(text: str) -> str:
    return " ".join(text.split())


def _axis_label(axes: Axes, axis: str, panels: Sequence[Axes]) -> str:
    """The label of an axis, which may stand at the edge of the figure for all of a column or a row."""

    def place(one: Axes) -> tuple[Any, Any] | None:
        if (spec := one.get_subplotspec()) is None:
            return None
        return spec.get_gridspec(), spec.colspan if axis == "x" else spec.rowspan

    alike = [axes, *(one for one in panels if place(axes) and place(one) == place(axes))]
    return next((text for one in alike if (text := _line(getattr(one, f"get_{axis}label")()))), "")


def _words(axis: Axis) -> dict[float, str]:
    """The ticks of an axis that are words, by their places; none where they are numbers."""
    from matplotlib.ticker import FixedLocator, FuncFormatter

    locator, formatter = axis.get_major_locator(), axis.get_major_formatter()
    # Ticks that were given their texts one by one.
    if not (isinstance(locator, FixedLocator) and isinstance(formatter, FuncFormatter)):
        return {}
    places = np.asarray(axis.get_majorticklocs(), dtype=float).tolist()
    found = dict(zip(places, map(_line, formatter.format_ticks(places)), strict=True))
    return {} if all(_is_number(word) for word in found.values()) else found


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _nearest(words: Sequence[Mapping[float, str]], part: pd.DataFrame) -> list[str]:
    """The nearest ticks of points, where ticks are words."""
    found = [""] * len(part)
    for ticks, values in zip(words, (part["x"], part["y"]), strict=True):
        places = np.array([*ticks])
        for i, value in enumerate(values if ticks else ()):
            if np.isfinite(value):
                found[i] = ticks[float(places[np.argmin(np.abs(places - value))])]
    return found


def _looks(figure: Figure) -> Iterator[tuple[Any, str]]:
    """The labels of curves by how these look, and by their colours alone where nothing else is known."""
    found = [(line, label) for axes in figure.axes for line in axes.lines if (label := _label(line))]
    for line, label in reversed(found):
        yield line.get_color(), label
    for line, label in reversed(found):
        yield _look(line), label


def _look(line: Any) -> Any:
    return line.get_color(), line.get_linestyle(), line.get_marker()


def _label(artist: Artist | Any) -> str:
    """Its label, also one that is to stand in no legend; none of those that matplotlib gives."""
    label = str(artist.get_label() or "")
    return "" if _NO_LABEL.fullmatch(label) else _line(label.removeprefix("_"))


def _curves(axes: Axes, looks: dict[Any, str]) -> Iterator[_Points]:
    """The curves of a panel: lines and points, bands, bars, contours."""
    from matplotlib.collections import LineCollection
    from matplotlib.container import ErrorbarContainer
    from matplotlib.contour import ContourSet

    named: dict[int, str] = {}
    caps: set[int] = set()
    for one in axes.containers:
        if isinstance(one, ErrorbarContainer):
            line, ends, bars = one.lines
            named |= {id(artist): _label(one) for artist in (line, *bars) if artist is not None}
            caps |= {id(cap) for cap in ends}
    bands = [*_bands(axes, looks)]
    edges = [(x, y) for _, _, x, low, high in bands for y in (low, high) if y is not None]
    yield from bands
    for line in axes.lines:
        if id(line) in caps or not line.get_visible():
            continue
        x, y = _in_data(axes, line)
        # The edges of a band are drawn for readers without colours.
        if not any(_same(x, other) and _same(y, edge) for other, edge in edges):
            label = named.get(id(line)) or _label(line) or looks.get(_look(line), "")
            yield label, "points" if line.get_linestyle() == "None" else "line", x, y, None
    for group in axes.collections:
        if isinstance(group, LineCollection):
            label = named.get(id(group)) or _label(group) or _by_colour(group.get_edgecolor(), looks)
            yield from _segments(group, label)
        elif isinstance(group, ContourSet) and not group.filled:
            for level, path in zip(group.levels, group.get_paths(), strict=False):
                for piece in map(np.asarray, path.to_polygons(closed_only=False)):
                    yield f"level {level:g}", "contour", piece[:, 0], piece[:, 1], None


def _in_data(axes: Axes, line: Any) -> tuple[Array, Array]:
    """The coordinates (K,) of a line; nan in a direction in which it stands at no number of the axes."""
    x, y = (np.asarray(values, dtype=float) for values in line.get_data(orig=False))
    across = line.get_transform().contains_branch_seperately(axes.transData)
    x, y = (
        values if is_data else np.full_like(values, np.nan)
        for values, is_data in zip((x, y), across, strict=True)
    )
    # A line across the panel is one number.
    return (x, y) if all(across) or len({*x[np.isfinite(x)], *y[np.isfinite(y)]}) != 1 else (x[:1], y[:1])


def _bands(axes: Axes, looks: dict[Any, str]) -> Iterator[_Points]:
    """What is shaded between two curves."""
    from matplotlib.collections import PolyCollection

    for group in axes.collections:
        if isinstance(group, PolyCollection):
            label = _label(group) or _by_colour(group.get_facecolor(), looks)
            for path in group.get_paths():
                # Out along one curve and back along the other, with a corner more at each end.
                corners = np.asarray(path.vertices)[:-1]
                half = len(corners) // 2
                low, high = corners[1:half], corners[half + 1 :][::-1]
                yield label, "band", low[:, 0], low[:, 1], high[:, 1]


def _segments(group: LineCollection, label: str) -> Iterator[_Points]:
    """Straight lines from one point to another: upright ones are bars."""
    pieces = [np.asarray(piece, dtype=float) for piece in group.get_segments()]
    upright = [piece for piece in pieces if len(piece) == 2 and piece[0, 0] == piece[1, 0]]
    if upright:
        ends = np.array(upright)
        yield label, "bar", ends[:, 0, 0], ends[:, 0, 1], ends[:, 1, 1]
    for piece in pieces:
        if not any(piece is one for one in upright) and len(piece):
            yield label, "line", piece[:, 0], piece[:, 1], None


def _by_colour(colours: Any, looks: dict[Any, str]) -> str:
    """The label of the lines that have the colour, whatever it shines through."""
    from matplotlib.colors import to_rgb

    wanted = [tuple(colour[:3]) for colour in np.atleast_2d(colours)[:1]]
    named = {to_rgb(colour): label for colour, label in looks.items() if not isinstance(colour, tuple)}
    return next((named[colour] for colour in wanted if colour in named), "")


def _same(one: Array, other: Array) -> bool:
    return one.shape == other.shape and bool(np.array_equal(one, other, equal_nan=True))


def encoded(figure: Figure) -> bytes:
    """The same as a CSV at seven digits, compressed with xz: its texts stand in every row."""
    text = str(drawn(figure).to_csv(index=False, lineterminator="\n", float_format="%.7g"))
    return lzma.compress(text.encode(), preset=1)
