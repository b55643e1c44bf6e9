"""Discrete linear blocks as second-order sections, in which narrow filters of high order keep their digits.

The poles of a narrow filter lie close together, and the coefficients of the product of their factors
determine them badly: a band-pass filter of order 16 and 2 % width that is simulated by its coefficients is
unstable. In sections of order two each pair of poles keeps its own coefficients.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hident.arrays import Array, Complex
from hident.linear_blocks import TransferFunction

Section = tuple[float, float, float, float, float, float]
"""b_0, b_1, b_2, 1, a_1, a_2 of (b_0 + b_1 q^-1 + b_2 q^-2)/(1 + a_1 q^-1 + a_2 q^-2), as in scipy.signal."""


@dataclass(frozen=True)
class SecondOrderSections(TransferFunction):
    """A discrete linear block as the product of ``sections``; ``b`` and ``a`` are those of the product.

    It is simulated, and its poles, zeros and static gain are found, section by section.

    Examples
    --------
    >>> block = SecondOrderSections.of([(1, 0, 0, 1, -0.5, 0), (0, 1, 0, 1, 0, 0)])
    >>> block.b, block.a
    ((0.0, 1.0), (0.5,))
    >>> block.filter(np.array([1.0, 0.0, 0.0]))
    array([0. , 1. , 0.5])
    """

    sections: tuple[Section, ...] = field(default=(), repr=False)

    @classmethod
    def of(cls, sections: Sequence[Sequence[float]]) -> SecondOrderSections:
        """The block of at least one section."""
        rows = np.array(sections, dtype=float)
        top, bottom = np.ones(1), np.ones(1)
        for row in rows:
            top, bottom = np.convolve(top, row[:3]), np.convolve(bottom, row[3:])
        b, a = np.trim_zeros(top, "b"), -np.trim_zeros(bottom, "b")[1:]
        kept: Any = tuple(map(tuple, rows.tolist()))
        return cls(tuple(b.tolist()) or (0.0,), tuple(a.tolist()), kept)

    def _blocks(self) -> list[TransferFunction]:
        """Each section by itself, without its trailing zeros."""
        blocks = []
        for section in self.sections:
            b, denominator = (np.trim_zeros(np.array(part), "b") for part in (section[:3], section[3:]))
            blocks.append(TransferFunction(tuple(b.tolist()), tuple((-denominator[1:]).tolist())))
        return blocks

    def poles(self) -> Complex:
        return np.concatenate([block.poles() for block in self._blocks()])

    def zeros(self) -> Complex:
        return np.concatenate([block.zeros() for block in self._blocks()])

    def is_stable(self, *, integrators: bool = False) -> bool:
        return all(block.is_stable(integrators=integrators) for block in self._blocks())

    def integrators(self) -> int:
        return sum(block.integrators() for block in self._blocks())

    def static_gain(self) -> float:
        gains = [block.static_gain() for block in self._blocks()]
        # A zero at 1 in one section and a pole there in another are for the product to settle.
        found = math.prod(gains)
        return super().static_gain() if math.isnan(found) else found

    def scaled(self, gain: float) -> SecondOrderSections:
        first, *others = self.sections
        b, bottom = tuple(gain * one for one in first[:3]), first[3:]
        return SecondOrderSections.of([(*b, *bottom), *others])

    def frequency_response(self, omega: Array, dt: float = 1.0) -> Complex:
        responses = [block.frequency_response(omega, dt) for block in self._blocks()]
        return np.asarray(np.prod(responses, axis=0))

    def filter(self, w: Array, initial: Array | None = None) -> Array:
        """The response to ``w`` (N,) from rest.

        Raises
        ------
        ValueError
            If ``initial`` is given: past outputs are not the state of the sections.
        """
        if initial is not None:
            raise ValueError("second-order sections begin at rest: past outputs do not tell their state")
        from scipy.signal import sosfilt

        return np.asarray(sosfilt(np.array(self.sections), w))

    def to_scipy(self, dt: float = 1.0) -> Any:
        """The block as a :class:`scipy.signal.dlti` of zeros, poles and gain, sampled every ``dt``."""
        from scipy.signal import dlti

        each = [block.in_z() for block in self._blocks()]
        zeros, poles = (
            np.concatenate([np.roots(part) for part in parts]) for parts in zip(*each, strict=True)
        )
        return dlti(zeros, poles, math.prod(float(top[0]) for top, _ in each), dt=dt)
