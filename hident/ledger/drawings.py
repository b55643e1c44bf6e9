"""The comparison of two drawings, PDF or SVG: what is drawn, and where.

A coordinate may differ by what no eye sees. Letters, the kinds of strokes and their order are equal or they
differ, and pictures inside a drawing are compared as those beside it.
"""

from __future__ import annotations

import base64
import io
import math
import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hident.arrays import Array

_INVISIBLE = 0.02
"""Points (1/72 inch), or shares of a colour."""
_NUMBER = re.compile(rb"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
# Texts of a PDF, and what an SVG refers to by name, stand for themselves.
_TOKEN = re.compile(rb"(?s:\((?:\\.|[^\\)])*\))|\"#[^\"]*\"|" + _NUMBER.pattern + rb"|\w+|\S")
_STREAM = re.compile(rb"\d obj(.*?)stream\r?\n(.*?)\r?\nendstream", re.DOTALL)
# What a stream says of itself that holds a font or a picture.
_NO_TEXT = re.compile(rb"/Length1\b|/Subtype\s*/Image\b")
_PAGE = re.compile(rb"/MediaBox\s*\[[^\]]*\]")
_PICTURE = re.compile(rb"data:image/png;base64,([A-Za-z0-9+/=\s]+)")
# Names that are a hash of what they name, to the last bit.
_HASHED = re.compile(rb"\b[A-Za-z]{1,2}[0-9a-f]{10}\b")


@dataclass(frozen=True)
class Drawing:
    """The words of a drawing, and what it holds that is no text, as values from 0 to 1."""

    words: list[bytes]
    pictures: list[Array]


def decode_pdf(data: bytes) -> Drawing:
    """The page and the streams of a PDF; ValueError if it is none."""
    if not data.startswith(b"%PDF"):
        raise ValueError("it is no PDF")
    words = [word for page in _PAGE.findall(data) for word in _TOKEN.findall(page)]
    pictures = []
    for said, packed in _STREAM.findall(data):
        try:
            content = zlib.decompress(packed)
        except zlib.error:
            content = packed
        if _NO_TEXT.search(said):
            pictures.append(_shades(content))
        else:
            words += _TOKEN.findall(content)
    return Drawing(words, pictures)


def decode_svg(data: bytes) -> Drawing:
    """The elements of an SVG; ValueError if it is none."""
    if b"<svg" not in data:
        raise ValueError("it is no SVG")
    pictures = [_pixels(base64.b64decode(found)) for found in _PICTURE.findall(data)]
    names: dict[bytes, bytes] = {}

    def named(found: re.Match[bytes]) -> bytes:
        return names.setdefault(found[0], b"name%d" % len(names))

    return Drawing(_TOKEN.findall(_HASHED.sub(named, _PICTURE.sub(b"picture", data))), pictures)


def _shades(content: bytes) -> Array:
    return np.frombuffer(content, dtype=np.uint8) / 255.0


def _pixels(content: bytes) -> Array:
    from matplotlib.image import imread

    return np.asarray(imread(io.BytesIO(content), format="png"), dtype=float)


def drawings_differ(ours: Drawing, reference: Drawing, pixels: float) -> Iterator[str]:
    """What two drawings differ in; ``pixels`` is the root mean square that pictures in them may differ by."""
    if len(ours.words) != len(reference.words):
        yield f"another drawing: {len(ours.words)} words, reference {len(reference.words)}"
        return
    pairs = zip(ours.words, reference.words, strict=True)
    if wrong := [pair for pair in pairs if pair[0] != pair[1] and not _near(*pair)]:
        mine, theirs = (word.decode(errors="replace") for word in wrong[0])
        yield f"another drawing: {len(wrong)} words differ, the first is {mine}, reference {theirs}"
    if [one.shape for one in ours.pictures] != [one.shape for one in reference.pictures]:
        yield "another drawing: other pictures or letters in it"
        return
    for one, other in zip(ours.pictures, reference.pictures, strict=True):
        distance = math.sqrt(float(np.mean((one - other) ** 2)))
        if distance > pixels:
            yield f"another drawing: a picture in it differs by {distance:.4f}, allowed {pixels:.4f}"


def _near(ours: bytes, reference: bytes) -> bool:
    if not (_NUMBER.fullmatch(ours) and _NUMBER.fullmatch(reference)):
        return False
    return abs(float(ours) - float(reference)) <= _INVISIBLE
