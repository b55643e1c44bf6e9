"""What every system and nonlinearity spec answers; linear blocks have their base in ``linear.py``."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator

from hident.config.spec import Component, Real
from hident.records import Array, Truth


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

    def simulate(self, u: Array) -> Array:
        """The noise-free response (N,) to ``u`` (N,), an array of its own."""
        raise NotImplementedError

    def truth(self) -> Truth:
        """The parts of the system that an estimate can be compared with."""
        raise NotImplementedError

    def provides(self) -> frozenset[str]:
        """The parts that :meth:`truth` holds: ``nonlinearity``, ``linear``, ``value NAME``."""
        truth = self.truth()
        parts: dict[str, Any] = {"nonlinearity": truth.nonlinearity, "linear": truth.linear}
        known = {name for name, part in parts.items() if part is not None}
        return frozenset(known | {f"value {name}" for name in truth.values})
