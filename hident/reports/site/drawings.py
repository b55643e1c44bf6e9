"""Drawings of the site as SVG text: bars of verdicts, the trials behind a number, the ledger as a picture.

Colours come from the stylesheet by class; each verdict has a pattern of its own too, for print and for eyes
that do not tell its colour.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from itertools import groupby

import numpy as np

from hident.arrays import Array
from hident.config.suggest import counted
from hident.ledger.verify import TableState
from hident.reports.site.facts import WORDS
from hident.reports.site.numbers import Number, chance
from hident.reports.tables.writing import SIGNS, written

_PATTERNS = """\
<pattern id="p-agrees" width="6" height="6" patternUnits="userSpaceOnUse" patternTransform="rotate(45)">\
<rect class="v-agrees" width="6" height="6"/><path class="line" d="M0 0V6"/></pattern>\
<pattern id="p-untestable" width="6" height="6" patternUnits="userSpaceOnUse">\
<rect class="v-untestable" width="6" height="6"/><circle class="dot" cx="2" cy="2" r="1.1"/>\
<circle class="dot" cx="5" cy="5" r="1.1"/></pattern>\
<pattern id="p-differs" width="7" height="7" patternUnits="userSpaceOnUse">\
<rect class="v-differs" width="7" height="7"/><path class="cross" d="M1 1L6 6M6 1L1 6"/></pattern>"""
_FILLS = {"exact": 'class="v-exact"', **{word: f'fill="url(#p-{word})"' for word in WORDS[1:]}}
_BINS = 38
_WIDTH, _MARGIN, _TOP, _BASE, _HEIGHT = 320.0, 8.0, 16.0, 84.0, 112.0
_STYLE = """\
text{font:13px system-ui,sans-serif;fill:#1c2126}.muted{fill:#59636e}.head{font-weight:600}\
.v-exact{fill:#14624a}.v-agrees{fill:#6fae95}.v-untestable{fill:#f2dfae}.v-differs{fill:#fbe3e0}\
.line{stroke:#2f6d56;stroke-width:2}.dot{fill:#7a5b00}.cross{stroke:#a1271b;stroke-width:1.3;fill:none}\
.v-wide{fill:#fff;opacity:.65}\
.edge{fill:none;stroke:#59636e}\
@media (prefers-color-scheme:dark){text{fill:#e6e9ec}.muted{fill:#a4adb6}\
.v-exact{fill:#7fe0b8}.v-agrees{fill:#2f7d61}.v-untestable{fill:#4a3d18}.v-differs{fill:#52201b}\
.line{stroke:#9fd9c3}.dot{fill:#e6c766}.cross{stroke:#ff9c90}.edge{stroke:#a4adb6}\
.v-wide{fill:#14181c}}"""


def patterns() -> str:
    """What the fills of bars refer to; once on each page that has any."""
    return f'<svg class="defs" width="0" height="0" aria-hidden="true"><defs>{_PATTERNS}</defs></svg>'


def in_words(counts: Mapping[str, int], wide: int = 0) -> str:
    """The numbers of each verdict, as '2 exact, 1 differs'; those of none are left out."""
    said = [
        f"{counts[word]} {word}" + f" ({wide} wide)" * (word == "agrees" and wide > 0)
        for word in WORDS
        if counts.get(word)
    ]
    return ", ".join(said) or "no number counts"


def bar(counts: Mapping[str, int], width: float = 240.0, height: float = 16.0, wide: int = 0) -> str:
    """A bar of the verdicts of a table, as a drawing of its own; ``wide`` ones that agree are paler."""
    said = in_words(counts, wide)
    return (
        f'<svg class="bar" viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{said}" '
        f'preserveAspectRatio="none">{_segments(counts, 0.0, 0.0, width, height, wide)}</svg>'
    )


def _segments(
    counts: Mapping[str, int], x: float, y: float, width: float, height: float, wide: int = 0
) -> str:
    total = sum(counts.get(word, 0) for word in WORDS)
    parts = []
    for word in WORDS:
        if count := counts.get(word, 0):
            share = width * count / total
            parts.append(
                f'<rect {_FILLS[word]} x="{x:.4g}" y="{y:g}" width="{share:.4g}" height="{height:g}"/>'
                f'<rect class="edge" x="{x:.4g}" y="{y:g}" width="{share:.4g}" height="{height:g}"/>'
            )
            x += share
            if word == "agrees" and wide:
                of_wide = width * wide / total
                at, size = f'x="{x - of_wide:.4g}" y="{y:g}"', f'width="{of_wide:.4g}" height="{height:g}"'
                parts.append(f'<rect class="v-wide" {at} {size}/>')
    return "".join(parts)


def ledger(groups: Sequence[tuple[str, Sequence[tuple[str, TableState]]]]) -> str:
    """The ledger as a picture by itself: for each paper its tables, each with what it is called.

    Each table has a bar of its verdicts, their numbers, the joint p-value and the mutation score.
    """
    row, left, width = 24.0, 250.0, 300.0
    # Behind those that agree stands how many of them are wide.
    columns = {word: left + width + 34.0 + 44.0 * i + 24.0 * (i > 1) for i, word in enumerate(WORDS)}
    joint, score, full = 812.0, 834.0, 970.0
    y, parts = 20.0, []
    head = [("start", 8.0, "table"), ("start", left, "printed numbers by verdict")]
    head += [("end", x, SIGNS[word]) for word, x in columns.items()]
    head += [("end", joint, "joint p"), ("start", score, "rejects")]
    parts += [_text(x, y, said, "head", anchor) for anchor, x, said in head]
    for name, tables in groups:
        y += 30.0
        parts.append(_text(8.0, y, name, "head"))
        for label, table in tables:
            y += row
            parts.append(_text(16.0, y, label))
            parts.append(_segments(table.counts, left, y - 12.0, width, 15.0, table.wide))
            parts += [
                _text(x, y, str(table.counts[word]), "", "end")
                for word, x in columns.items()
                if table.counts.get(word)
            ]
            if table.wide:
                parts.append(_text(columns["agrees"] + 4.0, y, f"({table.wide})", "muted"))
            p = "" if math.isnan(table.joint_p) else chance(table.joint_p)
            parts.append(_text(joint, y, p, "", "end"))
            if table.tried:
                parts.append(_text(score, y, table.score))
    y += 34.0
    told = (
        "exact: ours rounds to it; agrees: in our interval; untestable: under every alternative too; differs"
    )
    x = 8.0
    for word in WORDS:
        parts.append(_segments({word: 1}, x, y - 12.0, 22.0, 15.0))
        parts.append(_text(x + 28.0, y, f"{SIGNS[word]} {word}"))
        x += 130.0
    for said_of in (
        "pale, in brackets: agrees, by an interval that is wider than the printed number itself",
        "rejects: plausible mistakes that the table rules out, of those tried",
        "and ours: the joint p is below 0.05, so that the table rejects our own reading too",
    ):
        y += 20.0
        parts.append(_text(8.0, y, said_of, "muted"))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {full:g} {y + 14:g}" role="img">'
        f"<title>Printed numbers of each table by verdict</title><desc>{told}</desc>"
        f"<style>{_STYLE}</style><defs>{_PATTERNS}</defs>{''.join(parts)}</svg>\n"
    )


def _text(x: float, y: float, said: str, kind: str = "", anchor: str = "start") -> str:
    extra = (f' class="{kind}"' if kind else "") + (f' text-anchor="{anchor}"' if anchor != "start" else "")
    return f'<text x="{x:g}" y="{y:g}"{extra}>{escape(said)}</text>'


def distribution(number: Number) -> str:
    """The trials behind a number, with the interval, ours and the printed number."""
    values = number.values
    if values is None or not len(values):
        return ""
    printed = number.judged.printed.value
    low, high = _range(number, values, printed)
    scale = (_WIDTH - 2 * _MARGIN) / (high - low)

    def x(value: float) -> float:
        return _MARGIN + scale * (min(max(value, low), high) - low)

    parts = []
    if number.has_interval:
        at, to = x(number.judged.low), x(number.judged.high)
        box = f'y="{_TOP:g}" width="{to - at:.1f}" height="{_BASE - _TOP:g}"'
        parts.append(f'<rect class="interval" x="{at:.1f}" {box}/>')
    parts.append(_histogram(values, low, high))
    parts.append(f'<path class="axis" d="M{_MARGIN:g} {_BASE:g}H{_WIDTH - _MARGIN:g}"/>')
    if number.statistic == "standard deviation":
        middle = float(np.mean(values))
        parts += [
            f'<path class="{kind}" d="M{x(middle - spread):.1f} {y:g}H{x(middle + spread):.1f}"/>'
            for kind, spread, y in (("ours", number.judged.ours, 40.0), ("printed", printed, 50.0))
        ]
    else:
        parts.append(f'<path class="ours" d="M{x(number.judged.ours):.1f} {_TOP:g}V{_BASE:g}"/>')
        at = x(printed)
        parts.append(f'<path class="printed" d="M{at:.1f} {_TOP:g}V{_BASE:g}"/>')
        parts.append(f'<circle class="printed" cx="{at:.1f}" cy="10" r="5"/>')
    parts += [
        f'<text x="{at:g}" y="{_BASE + 18:g}"{anchor}>{written(value)}</text>'
        for at, anchor, value in ((_MARGIN, "", low), (_WIDTH - _MARGIN, ' text-anchor="end"', high))
    ]
    beyond = int(np.sum((values < low) | (values > high)))
    said = counted(len(values), "trial") + (f", {beyond} beyond" if beyond else "")
    parts.append(f'<text x="{_WIDTH / 2:g}" y="{_BASE + 18:g}" text-anchor="middle">{said}</text>')
    label = f"Distribution of {said}"
    return (
        f'<svg class="trials" viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" role="img" aria-label="{label}">'
        f"{''.join(parts)}</svg>"
    )


def _range(number: Number, values: Array, printed: float) -> tuple[float, float]:
    """What is drawn: nearly all trials, the interval, and both numbers."""
    low, high = (float(q) for q in np.quantile(values, [0.01, 0.99]))
    shown = [low, high]
    if number.statistic != "standard deviation":
        shown += [printed, number.judged.ours]
        shown += [edge for edge in (number.judged.low, number.judged.high) if math.isfinite(edge)]
    shown = [one for one in shown if math.isfinite(one)]
    low, high = min(shown), max(shown)
    margin = 0.04 * (high - low) or 0.04 * abs(high) or 1.0
    return low - margin, high + margin


def _histogram(values: Array, low: float, high: float) -> str:
    """Bars of whole pixels, as a page holds many of these."""
    counts, _ = np.histogram(values, bins=_BINS, range=(low, high))
    tops = np.rint((_BASE - _TOP) * counts / max(int(counts.max()), 1)).astype(int).tolist()
    step = round((_WIDTH - 2 * _MARGIN) / _BINS)
    path = "".join(f"V{_BASE - top:g}h{step * len([*run])}" for top, run in groupby(tops))
    return f'<path class="histogram" d="M{_MARGIN:g} {_BASE:g}{path}V{_BASE:g}Z"/>'
