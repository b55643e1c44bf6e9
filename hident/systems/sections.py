"""Discrete linear blocks for filters: by zeros, poles and gain, and by second-order sections.

Both are simulated section by section (``scipy.signal.sosfilt``), so that narrow filters of high order keep
their accuracy; the blocks by coefficients in ``linear.py`` do not there.
"""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    Field,
    field_validator,
)

from hident.config.spec import Real, component
from hident.linear_blocks import MOST_POLES
from hident.second_order_sections import SecondOrderSections
from hident.systems.linear import DiscreteSpec
from hident.systems.roots import Roots, roots

# Sections that delay by so many samples.
_DELAY = {1: (0.0, 1.0, 0.0, 1.0, 0.0, 0.0), 2: (0.0, 0.0, 1.0, 1.0, 0.0, 0.0)}


class _InSections(DiscreteSpec):
    initial: Literal["stationary", "zero"] = "stationary"
    """Start: stationary (after a burn-in), or zero."""

    def transfer_function(self) -> SecondOrderSections:
        return self._sections

    @cached_property
    def _sections(self) -> SecondOrderSections:
        raise NotImplementedError


@component("linear", "zpk", source="scipy.signal.ZerosPolesGain")
class Zpk(_InSections):
    """Zeros, poles and gain: gain (z - z_1)(z - z_2).../((z - p_1)(z - p_2)...).

    Each pole more than zeros delays the input by a sample.

    Examples
    --------
    >>> Zpk(zeros=[0], poles=[0.5]).transfer_function().impulse_response(3)
    array([1.  , 0.5 , 0.25])
    >>> Zpk(poles=[[0.3, 0.4]], gain=2).transfer_function().poles()
    array([0.3+0.4j, 0.3-0.4j])
    """

    zeros: Roots = ()
    """Zeros in the z plane, each a number or [re, im] for the pair re +- im j; no more than poles."""
    poles: Roots = ()
    """Poles in the z plane, each a number or [re, im] for the pair re +- im j."""
    gain: Real = 1.0
    """Factor of the product."""

    @field_validator("gain")
    @classmethod
    def _check_gain(cls, gain: float) -> float:
        if gain == 0.0:
            raise ValueError("must not be zero")
        return gain

    @cached_property
    def _sections(self) -> SecondOrderSections:
        from scipy.signal import zpk2sos

        zeros, poles = roots(self.zeros), roots(self.poles)
        if (excess := len(zeros) - len(poles)) > 0:
            raise ValueError(
                f"{len(zeros)} zeros are more than {len(poles)} poles, and the output would come before the "
                f"input: add {excess} poles at 0, which delay"
            )
        # scipy.signal counts in powers of q^-1, where poles without a zero delay nothing.
        delays = [_DELAY[2]] * ((len(poles) - len(zeros)) // 2) + [_DELAY[1]] * (
            (len(poles) - len(zeros)) % 2
        )
        return SecondOrderSections.of([*zpk2sos(zeros, poles, self.gain).tolist(), *delays])


def _as_section(value: Any) -> Any:
    if not isinstance(value, list | tuple) or len(value) != 6:
        found = f"a list of {len(value)}" if isinstance(value, list | tuple) else repr(value)
        raise ValueError(f"must be the six coefficients [b_0, b_1, b_2, 1, a_1, a_2], not {found}")
    return value


@component("linear", "sos", source="scipy.signal.sosfilt")
class Sos(_InSections):
    """Second-order sections one after the other, as scipy.signal writes them.

    A section is (b_0 + b_1 q^-1 + b_2 q^-2)/(1 + a_1 q^-1 + a_2 q^-2): a_1 and a_2 have the opposite sign of
    those of the other blocks.

    Examples
    --------
    >>> Sos(sections=[[1, 0, 0, 1, -0.5, 0]]).transfer_function().impulse_response(3)
    array([1.  , 0.5 , 0.25])
    """

    sections: Annotated[
        tuple[Annotated[tuple[Real, Real, Real, Real, Real, Real], BeforeValidator(_as_section)], ...],
        Field(min_length=1, max_length=MOST_POLES // 2),
    ]
    """Sections [b_0, b_1, b_2, 1, a_1, a_2], the rows that scipy.signal.butter(..., output="sos") gives."""

    @field_validator("sections")
    @classmethod
    def _check_sections(cls, sections: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
        for i, section in enumerate(sections):
            if section[3] != 1.0:
                raise ValueError(f"section {i} must have 1 as its fourth number, not {section[3]:.10g}")
            if not any(section[:3]):
                raise ValueError(f"section {i} has no numerator: b_0, b_1 and b_2 are zero")
        return sections

    @cached_property
    def _sections(self) -> SecondOrderSections:
        return SecondOrderSections.of(self.sections)
