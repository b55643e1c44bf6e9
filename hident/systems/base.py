"""What every system and nonlinearity spec answers; linear blocks have their base in ``linear.py``."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field
from pydantic_core import PydanticCustomError

from hident.arrays import Array, Characteristic
from hident.config.expression import Formula
from hident.config.spec import Component, Of, Real
from hident.linear_blocks import MOST_POLES
from hident.records import Truth, Waveform

_STEP = float(np.finfo(float).eps) ** (1.0 / 3.0)


def _as_list(value: Any) -> Any:
    if not isinstance(value, list | tuple) or not value:
        raise ValueError("must be a list of at least one number")
    return value


def _not_all_zero(b: tuple[float, ...]) -> tuple[float, ...]:
    if not any(b):
        raise ValueError("must have a coefficient other than zero")
    return b


Coefficients = Annotated[tuple[Real, ...], BeforeValidator(_as_list)]
Numerator = Annotated[Coefficients, AfterValidator(_not_all_zero)]
Feedback = Annotated[tuple[Real, ...], Field(max_length=MOST_POLES), BeforeValidator(_as_list)]


class NonlinearitySpec(Component):
    """Base of all nonlinearities: static ones, which also serve as instruments and known functions.

    Those with memory descend from :class:`MemorySpec`.
    """

    def __call__(self, u: Array) -> Array:
        """The characteristic at ``u``, elementwise, float64 of the shape of ``u``."""
        raise NotImplementedError

    def simulate(self, u: Array) -> Array:
        """The output (N,) to the samples ``u`` (N,) of one experiment, an array of its own."""
        return self(u)

    def characteristic(self) -> Characteristic | None:
        """The function of the input that it is; None if it has memory."""
        return self

    def formula(self) -> str | None:
        """The characteristic as a formula in u, to the last digit of its numbers; None if it has none."""
        return None

    def slope(self, u: Array) -> Array:
        """The derivative of the characteristic at ``u``, of its shape; at a bend that of one side.

        That of the formula is exact. Without one it is a difference quotient, good to ten digits or so of a
        smooth characteristic.
        """
        u = np.asarray(u, dtype=float)
        if (text := self.formula()) is not None:
            return np.full(u.shape, Formula(text, ("u",)).slope("u", u=u), dtype=float)
        # The error of the quotient and that of rounding are about equal.
        step = _STEP * np.maximum(np.abs(u), 1.0)
        above, below = u + step, u - step
        return np.asarray((self(above) - self(below)) / (above - below))

    def coefficients_by_power(self) -> dict[int, float]:
        """The coefficients of a polynomial by power; empty for any other characteristic."""
        return {}

    def break_points(self) -> tuple[float, ...]:
        """Where the characteristic or its derivative jumps, in increasing order."""
        return ()


class MemorySpec(NonlinearitySpec):
    """Base of the nonlinearities with memory: their output depends on the inputs before, too.

    They answer :meth:`simulate`, and begin every experiment at their ``initial`` state; they are no function
    of the input, so that a system's truth holds no ``nonlinearity``.
    """

    def __call__(self, u: Array) -> Array:
        raise TypeError(f"{self.kind} has memory: it has a response to a signal, and no value at an input")

    def simulate(self, u: Array) -> Array:
        raise NotImplementedError

    def characteristic(self) -> Characteristic | None:
        return None


class OfStatic(Of):
    """Pydantic annotation: a nonlinearity without memory, where a function of the input is needed."""

    def __init__(self) -> None:
        super().__init__("nonlinearity")

    def validate(self, value: Any) -> Component:
        spec = super().validate(value)
        if isinstance(spec, MemorySpec):
            raise PydanticCustomError(
                "config",
                f"must be a function of the input alone, and {spec.kind} has memory: "
                "take a nonlinearity without",
            )
        return spec


class SystemSpec(Component):
    """Base of all systems."""

    def burn_in(self) -> int:
        """Samples before the record after which the start no longer matters."""
        return 0

    def check(self, dt: float | None) -> None:
        """Raise ValueError if the system cannot work at sampling interval ``dt`` (None: discrete time)."""

    def check_before(self, level: float) -> None:
        """Raise ValueError if it does not start from the equilibrium with a constant input ``level``.

        Unless a system knows better, one with a burn-in does, and any other starts from rest.
        """
        if level != 0.0 and not self.follows_waveforms() and not self.burn_in():
            raise ValueError(
                f"'initial' names what was applied before the record, but this {self.kind} system starts "
                "from rest, as if nothing had been: leave it out (discrete blocks that are stationary, and a "
                "wiener_hammerstein system with continuous blocks, start from the equilibrium)"
            )

    def simulate(self, u: Array, dt: float = 1.0) -> Array:
        """The noise-free response (N,) to ``u`` (N,), sampled every ``dt``, an array of its own.

        Raises
        ------
        SimulationError
            If the simulation does not converge; the trial then counts as failed.
        """
        raise NotImplementedError

    def follows_waveforms(self) -> bool:
        """Whether its data come from :meth:`respond`, not from :meth:`simulate` and the input's samples."""
        return False

    def respond(self, waveform: Waveform, n: int, dt: float) -> Array:
        """The noise-free response (n,) to a signal in continuous time, at the times 0, dt, 2 dt, ...

        Raises
        ------
        SimulationError
            If the simulation does not converge; the trial then counts as failed.
        """
        raise NotImplementedError

    def truth(self) -> Truth:
        """The parts of the system that an estimate can be compared with."""
        raise NotImplementedError

    def provides(self) -> frozenset[str]:
        """The parts of :meth:`truth`: ``nonlinearity``, ``linear``, ``response``, ``value NAME``..."""
        return self.truth().provides()

    def lacks(self, part: str) -> str:
        """Why it has no such part, where one would expect it; empty otherwise."""
        return ""
