"""How values are spread over trials, in a line of letters."""

from __future__ import annotations

import math

import numpy as np

from hident.arrays import Array

BARS = "▁▂▃▄▅▆▇█"
MARK = "│"
PLAIN_BARS = ".:-=+*#@"
PLAIN_MARK = "|"
# Beyond so many interquartile ranges from the quartiles a value is far out, and stands in the last bar.
_FENCE = 3.0


def sparkline(
    values: Array,
    width: int,
    printed: float = math.nan,
    slack: float = 0.0,
    *,
    bars: str = BARS,
    mark: str = MARK,
) -> tuple[str, str, str]:
    """A histogram of ``width`` bars, before, at and behind the ``mark`` of a printed number.

    An empty place holds no trial. The two bars at the ends hold what lies further out than three
    interquartile ranges from the quartiles. A printed number beyond the trials stands apart from them;
    ``slack`` is by how much its rounding may have moved it. The three parts together have ``width + 2``
    letters; the second is empty without a printed number.

    Examples
    --------
    >>> values = np.array([1.0, 2.0, 2.0, 3.0, 3.0, 3.0, 3.0, 4.0])
    >>> sparkline(values, 4, 2.4)
    ('▂▄', '│', '█▂ ')
    >>> sparkline(values, 4, 9.0)
    ('▂▄█▂ ', '│', '')
    """
    values = values[np.isfinite(values)]
    if not len(values):
        return " " * (width + 2), "", ""
    low, high = _ends(values)
    if low == high:
        drawn, away = bars[-1].center(width), printed - low
        place = width / 2.0 if abs(away) <= slack else math.copysign(math.inf, away)
    else:
        edges = np.linspace(low, high, width + 1)
        counts, _ = np.histogram(np.clip(values, low, high), edges)
        levels = np.ceil(counts / counts.max() * len(bars)).astype(int)
        drawn = "".join(bars[level - 1] if level else " " for level in levels)
        place = (printed - low) / (high - low) * width
    if math.isnan(printed):
        return f"{drawn}  ", "", ""
    if place < 0.0:
        return "", mark, f" {drawn}"
    if place > width:
        return f"{drawn} ", mark, ""
    at = round(place)
    return drawn[:at], mark, f"{drawn[at:]} "


def _ends(values: Array) -> tuple[float, float]:
    """Where the bars begin and end."""
    first, third = np.quantile(values, [0.25, 0.75])
    fence = _FENCE * (third - first)
    low, high = float(values.min()), float(values.max())
    # Where half of the trials are one number, nothing says what is far out.
    return (max(low, first - fence), min(high, third + fence)) if fence else (low, high)
