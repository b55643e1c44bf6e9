"""What every system and nonlinearity spec answers; linear blocks have their base in ``linear.py``."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field

from hident.arrays import Array
from hident.config.spec import Component, Real
from hident.linear_blocks import MOST_POLES
from hident.records import Truth, Waveform


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
    """Base of all static nonlinearities; also used as instruments and known functions."""

    def __call__(self, u: Array) -> Array:
        """The characteristic at ``u``, elementwise, float64 of the shape of ``u``."""
        raise NotImplementedError

    def coefficients_by_power(self) -> dict[int, float]:
        """The coefficients of a polynomial by power; empty for any other characteristic."""
        return {}

    def break_points(self) -> tuple[float, ...]:
        """Where the characteristic or its derivative jumps, in increasing order."""
        return ()


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
