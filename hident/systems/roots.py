"""Zeros and poles as a configuration writes them."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import ConfigDict, Field, PlainValidator, TypeAdapter, WithJsonSchema

from hident.arrays import Complex
from hident.config.spec import Real
from hident.linear_blocks import MOST_POLES

_ENTRY = "must be a number, or [re, im] for the pair re +- im j"


_NUMBER: TypeAdapter[float] = TypeAdapter(Real, config=ConfigDict(allow_inf_nan=False))


def _as_root(value: Any) -> float | tuple[float, float]:
    if not isinstance(value, list | tuple):
        return _NUMBER.validate_python(value)
    if len(value) != 2:
        raise ValueError(f"{_ENTRY}, not a list of {len(value)}")
    re, im = map(_NUMBER.validate_python, value)
    return re, im


Root = Annotated[
    Real | tuple[Real, Real],
    PlainValidator(_as_root),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": ["number", "string"]},
                {
                    "type": "array",
                    "items": {"type": ["number", "string"]},
                    "minItems": 2,
                    "maxItems": 2,
                },
            ]
        }
    ),
]
"""A real zero or pole, or [re, im] for a pair."""
Roots = Annotated[tuple[Root, ...], Field(max_length=MOST_POLES)]


def roots(written: tuple[float | tuple[float, float], ...]) -> Complex:
    """The zeros or poles, both of each pair."""
    found: list[complex] = []
    for root in written:
        if isinstance(root, tuple):
            found += [complex(*root), complex(*root).conjugate()]
        else:
            found.append(complex(root))
    return np.array(found, dtype=np.complex128)
