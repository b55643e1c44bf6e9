"""The comparison of two files of results: tables, documents, texts, pictures.

A number may differ in its last bits, as another machine makes it: relative tolerance, no absolute one.
Whole numbers (counts, labels, seeds) and texts are equal or they differ. The order of a table's rows and
columns does not count, nor does the provenance in ``run.json``.
"""

from __future__ import annotations

import csv
import io
import json
import lzma
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hident.arrays import Array
from hident.engine.run_files import in_format, is_drawn, is_vector
from hident.ledger.drawings import Drawing, decode_pdf, decode_svg, drawings_differ

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
_WHOLE = re.compile(r"[+-]?\d+", re.ASCII)
_TOKEN = re.compile(rf"{_NUMBER.pattern}|\S", re.ASCII)
_NOTHING = ("", "nan")
# Root mean square over all pixels, of which a curve covers some per cent.
_PIXEL_TOLERANCE = 2 / 255

Row = dict[str, str]
# What reads a file's bytes, and what compares two such readings at a relative tolerance.
_Kind = tuple[Callable[[bytes], Any], Callable[[Any, Any, float], Iterator[str]]]


def content_differences(ours: Path, reference: Path, rtol: float) -> Iterator[str]:
    """What two files of one kind differ in, a line each; a file that cannot be read is a difference."""
    try:
        data = ours.read_bytes(), reference.read_bytes()
    except OSError as error:
        yield f"cannot be read: {(error.strerror or str(error)).lower()}"
        return
    if data[0] == data[1]:
        return
    decode, differences = _kind(ours)
    decoded = []
    for content, whose in zip(data, ("", "the reference "), strict=True):
        try:
            decoded.append(decode(content))
        except Exception as error:  # Decoders meet junk with errors of any kind, PIL with a SyntaxError.
            yield f"{whose}cannot be read: {error}"
    if len(decoded) == 2:
        mine, theirs = decoded
        yield from differences(mine, theirs, rtol)


def _kind(file: Path) -> _Kind:
    if is_drawn(file.name):
        return _DRAWN
    return _VECTOR if is_vector(file.name) else _KINDS.get(file.suffix, _OTHER)


def _difference(ours: str, reference: str, rtol: float) -> str | None:
    """What to say of two texts, numbers among them; None if they agree."""
    if ours == reference or (ours.lower() in _NOTHING and reference.lower() in _NOTHING):
        return None
    said = f"{ours or 'empty'}, reference {reference or 'empty'}"
    if not (_NUMBER.fullmatch(ours) and _NUMBER.fullmatch(reference)):
        return said
    whole = _WHOLE.fullmatch(ours) and _WHOLE.fullmatch(reference)
    a, b = float(ours), float(reference)
    if a == b == 0.0 or (not whole and math.isclose(a, b, rel_tol=rtol)):
        return None
    return f"{said}, relative difference {abs(a - b) / max(abs(a), abs(b)):.1e}"


@dataclass(frozen=True)
class Table:
    """The columns and rows of a CSV file, as texts."""

    columns: tuple[str, ...]
    rows: tuple[Row, ...]


def decode_table(data: bytes) -> Table:
    """A CSV file with a header; ValueError if it is none."""
    reader = csv.reader(io.StringIO(data.decode(), newline=""), strict=True)
    columns = tuple(next(reader, ()))
    if not columns:
        raise ValueError("it has no header")
    twice = [column for column, count in Counter(columns).items() if count > 1]
    if twice:
        raise ValueError(f"column {twice[0]} stands twice")
    rows = []
    for cells in reader:
        if len(cells) != len(columns):
            raise ValueError(f"line {reader.line_num} has {len(cells)} cells, not {len(columns)}")
        rows.append(dict(zip(columns, cells, strict=True)))
    return Table(columns, tuple(rows))


def _tables(ours: Table, reference: Table, rtol: float) -> Iterator[str]:
    yield from (f"column {name} is missing" for name in reference.columns if name not in ours.columns)
    yield from (f"column {name} is extra" for name in ours.columns if name not in reference.columns)
    if set(ours.columns) != set(reference.columns):
        # Rows of other columns are other rows.
        return
    key = _key(reference.columns, ours.rows, reference.rows)
    for mine, theirs in _matched(ours.rows, reference.rows, key, rtol):
        name = ", ".join(f"{column} {(theirs or mine or {})[column]}" for column in key)
        if mine is None or theirs is None:
            yield f"{name}: row is {'missing' if mine is None else 'extra'}"
            continue
        for column in reference.columns:
            said = _difference(mine[column], theirs[column], rtol)
            if said:
                yield f"{name}: {column} {said}"


def _key(columns: Sequence[str], *tables: Sequence[Row]) -> Sequence[str]:
    """The columns that name a row: the fewest leading ones that tell rows apart, and texts that follow."""

    def distinct(rows: Sequence[Row], length: int) -> int:
        return len({_label(row, columns[:length]) for row in rows})

    length = next(
        n
        for n in range(min(1, len(columns)), len(columns) + 1)
        if all(distinct(rows, n) == distinct(rows, len(columns)) for rows in tables)
    )
    while length < len(columns) and _is_text(row[columns[length]] for rows in tables for row in rows):
        length += 1
    return columns[:length]


def _is_text(cells: Iterable[str]) -> bool:
    return all(cell.lower() not in _NOTHING and not _NUMBER.fullmatch(cell) for cell in cells)


def _label(row: Row, columns: Sequence[str]) -> tuple[str, ...]:
    return tuple(_rounded(row[column]) for column in columns)


def _rounded(cell: str) -> str:
    """The cell without the last bits of a number, so that it can be looked up."""
    return f"{float(cell):.9g}" if _NUMBER.fullmatch(cell) and not _WHOLE.fullmatch(cell) else cell


def _matched(
    ours: Sequence[Row], reference: Sequence[Row], key: Sequence[str], rtol: float
) -> Iterator[tuple[Row | None, Row | None]]:
    """Pairs of rows with one key: by place if all keys agree there, else wherever they stand."""
    if len(ours) == len(reference) and all(
        _difference(mine[column], theirs[column], rtol) is None
        for mine, theirs in zip(ours, reference, strict=True)
        for column in key
    ):
        yield from zip(ours, reference, strict=True)
        return
    mine, theirs = _by_label(ours, key), _by_label(reference, key)
    for label in theirs | mine:
        yield mine.get(label), theirs.get(label)


def _by_label(rows: Sequence[Row], key: Sequence[str]) -> dict[tuple[object, ...], Row]:
    """The rows by label, and those with one label by their turn."""
    seen: Counter[tuple[str, ...]] = Counter()
    found: dict[tuple[object, ...], Row] = {}
    for row in rows:
        label = _label(row, key)
        found[label, seen[label]] = row
        seen[label] += 1
    return found


def _decode_json(data: bytes) -> dict[str, str]:
    """All leaves by their paths, but the provenance, and of a run the files in formats that it was asked for.

    Those are there, or they are missing. Which trials failed, their values say; why they did stands there
    in words.
    """
    value = json.loads(data)
    if isinstance(value, dict):
        value.pop("provenance", None)
        value.pop("formats", None)
        value.pop("failures", None)
        if isinstance(files := value.get("files"), list):
            value["files"] = [name for name in files if not (isinstance(name, str) and _is_optional(name))]
    return dict(_leaves(value, ""))


def _is_optional(name: str) -> bool:
    """Whether a run writes the file only if it is asked to, or since some version."""
    return in_format(name) is not None or is_drawn(name) or is_vector(name)


def _leaves(value: object, path: str) -> Iterator[tuple[str, str]]:
    match value:
        case dict() if value:
            for key, item in value.items():
                yield from _leaves(item, f"{path}.{key}" if path else key)
        case list() if value:
            for index, item in enumerate(value):
                yield from _leaves(item, f"{path}[{index}]")
        case _:
            yield path, json.dumps(value, ensure_ascii=False)


def _documents(ours: dict[str, str], reference: dict[str, str], rtol: float) -> Iterator[str]:
    for path in reference | ours:
        if path not in ours:
            yield f"{path} is missing"
        elif path not in reference:
            yield f"{path} is extra"
        elif said := _difference(ours[path], reference[path], rtol):
            yield f"{path} {said}"


def _decode_lines(data: bytes) -> list[str]:
    return data.decode().splitlines()


def _lines(ours: list[str], reference: list[str], rtol: float) -> Iterator[str]:
    if len(ours) != len(reference):
        yield f"{len(ours)} lines, reference {len(reference)}"
    for number, (mine, theirs) in enumerate(zip(ours, reference, strict=False), start=1):
        tokens, expected = _TOKEN.findall(mine), _TOKEN.findall(theirs)
        if len(tokens) != len(expected) or any(
            _difference(*pair, rtol) for pair in zip(tokens, expected, strict=True)
        ):
            yield f"line {number}: '{mine.strip()}', reference '{theirs.strip()}'"


def _decode_picture(data: bytes) -> Array:
    from matplotlib.image import imread

    return np.asarray(imread(io.BytesIO(data), format="png"), dtype=float)


def _pictures(ours: Array, reference: Array, rtol: float) -> Iterator[str]:
    if ours.shape != reference.shape:
        size, expected = (" x ".join(map(str, picture.shape)) for picture in (ours, reference))
        yield f"{size} pixels, reference {expected}"
        return
    distance = float(np.sqrt(np.mean((ours - reference) ** 2)))
    if distance > _PIXEL_TOLERANCE:
        yield (
            f"another picture: root mean square of the difference {distance:.4f}, "
            f"allowed {_PIXEL_TOLERANCE:.4f}"
        )


def _drawings(ours: Drawing, reference: Drawing, rtol: float) -> Iterator[str]:
    yield from drawings_differ(ours, reference, _PIXEL_TOLERANCE)


def _bytes(ours: bytes, reference: bytes, rtol: float) -> Iterator[str]:
    yield f"other bytes: {len(ours)}, reference {len(reference)}"


_KINDS: dict[str, _Kind] = {
    ".csv": (decode_table, _tables),
    ".json": (_decode_json, _documents),
    ".md": (_decode_lines, _lines),
    ".txt": (_decode_lines, _lines),
    ".tex": (_decode_lines, _lines),
    ".png": (_decode_picture, _pictures),
    ".pdf": (decode_pdf, _drawings),
    ".svg": (decode_svg, _drawings),
}
_DRAWN: _Kind = (lambda data: decode_table(lzma.decompress(data)), _tables)
_VECTOR: _Kind = (lambda data: decode_svg(lzma.decompress(data)), _drawings)
_OTHER: _Kind = (bytes, _bytes)
