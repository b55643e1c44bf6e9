"""Linear blocks as numbers: discrete ones, and continuous ones with any delay.

Signs as the papers write them. In discrete time (Mzyk 2009, A2)

    v_k = a_1 v_{k-1} + ... + a_p v_{k-p} + b_0 w_k + ... + b_m w_{k-m},

so the transfer function is B(q)/A(q) with A(q) = 1 - a_1 q^-1 - ... - a_p q^-p. In continuous time (Chen,
Hwang and Chang 2009, eq. (1) and (9))

    a_n y^(n)(t) + ... + a_1 y^(1)(t) + y(t) = b_m x^(m)(t - d) + ... + b_1 x^(1)(t - d) + b_0 x(t - d),

so the static gain is b_0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hident.arrays import Array, Complex
from hident.errors import ConfigError
from hident.numerics.choices import ROUNDING
from hident.numerics.rounding import apart
from hident.numerics.settling import settling_time
from hident.numerics.whole import split

_NEGLIGIBLE = 1e-16
# A simple pole of this modulus is forgotten to 1e-16 after 3.7 million samples.
SLOWEST = 0.99999
# Rounding moves a pole at 1 less far than this, also one of three.
_NEAR_ONE = 0.9999
MOST_POLES = 200
"""As many as a configuration may give: to find them takes the third power of their number."""


def _roots(polynomial: Array) -> Complex:
    return np.roots(polynomial).astype(np.complex128)


def significant(terms: ArrayLike) -> Array:
    """The terms (n,), zero where one is no more than rounding beside the others."""
    sizes = np.abs(found := np.array(terms, dtype=float))
    found[sizes <= ROUNDING * np.sum(sizes)] = 0.0
    return found


def _sum(terms: Array) -> float:
    """The sum of the terms, zero where it is no more than their rounding."""
    total = float(np.sum(terms))
    return total if abs(total) > ROUNDING * float(np.sum(np.abs(terms))) else 0.0


def python_control() -> Any:
    """The module ``control``; ConfigError if it is not installed."""
    try:
        import control
    except ImportError:
        raise ConfigError("to_control needs python-control: pip install 'hident[control]'") from None
    return control


@dataclass(frozen=True)
class TransferFunction:
    """The discrete linear block with numerator ``b`` (b_0, ..., b_m) and feedback ``a`` (a_1, ..., a_p).

    Examples
    --------
    >>> block = TransferFunction(b=(0.0, 1.0), a=(0.5,))
    >>> block.impulse_response(4)
    array([0.  , 1.  , 0.5 , 0.25])
    >>> block.static_gain()
    2.0
    >>> block.to_scipy(dt=0.1).poles
    array([0.5])
    """

    b: tuple[float, ...] = (1.0,)
    a: tuple[float, ...] = ()

    @property
    def denominator(self) -> Array:
        """The coefficients of A in powers of q^-1: 1, -a_1, ..., -a_p."""
        return np.concatenate(([1.0], -np.asarray(self.a, dtype=float)))

    def poles(self) -> Complex:
        """The p poles in the z plane; the block is stable when all lie inside the unit circle."""
        return _roots(self.denominator)

    def zeros(self) -> Complex:
        """The zeros in the z plane; the inverse is stable when all lie inside the unit circle."""
        return _roots(np.asarray(self.b, dtype=float))

    def radius(self) -> float:
        """The largest modulus of the poles, 0 without feedback."""
        return float(np.max(np.abs(self.poles()), initial=0.0))

    def is_stable(self, *, integrators: bool = False) -> bool:
        """Whether all poles lie inside the unit circle; ``integrators``: or at 1."""
        if self.radius() < 1.0:
            return True
        return integrators and TransferFunction(a=self._beside_integrators()[1]).radius() < 1.0

    def integrators(self) -> int:
        """How many poles lie at 1, where an input that stays makes the output grow without end."""
        return 0 if self.radius() < _NEAR_ONE else self._beside_integrators()[0]

    def _beside_integrators(self) -> tuple[int, tuple[float, ...]]:
        """The number of poles at 1, and the feedback that the others make."""
        count, rest = 0, self.denominator
        while len(rest) > 1 and _sum(rest) == 0.0:
            # The quotient by 1 - q^-1.
            count, rest = count + 1, np.cumsum(rest)[:-1]
        return count, tuple((-rest[1:]).tolist())

    def static_gain(self) -> float:
        """The gain at frequency zero: exactly zero where it is rounding, infinite for an integrator."""
        top, bottom = (_sum(np.asarray(c, dtype=float)) for c in (self.b, self.denominator))
        return top / bottom if bottom else math.inf

    def scaled(self, gain: float) -> TransferFunction:
        """The block with its output multiplied by ``gain``."""
        return TransferFunction(tuple(gain * b for b in self.b), self.a)

    def divided(self, gain: float) -> TransferFunction:
        """The block with its output divided by ``gain``."""
        return TransferFunction(tuple(b / gain for b in self.b), self.a)

    def frequency_response(self, omega: Array, dt: float = 1.0) -> Complex:
        """The complex gain at angular frequencies ``omega`` (any shape), radians per unit of time."""
        delay = np.exp(-1j * np.asarray(omega, dtype=float) * dt)
        return np.asarray(np.polyval(self.b[::-1], delay) / np.polyval(self.denominator[::-1], delay))

    def inverse(self) -> TransferFunction:
        """The block A/B that undoes this one.

        Raises
        ------
        ValueError
            If b_0 is zero: the block delays its input, and only the future would undo that.
        """
        b0 = self.b[0]
        if significant(self.b)[0] == 0.0:
            raise ValueError("a block with b_0 = 0 delays its input and has no causal inverse")
        return TransferFunction(b=tuple(self.denominator / b0), a=tuple(-value / b0 for value in self.b[1:]))

    def filter(self, w: Array, initial: Array | None = None) -> Array:
        """The response to ``w`` (N,) from rest, or from the past outputs ``initial``.

        Parameters
        ----------
        w : array, shape (N,)
            The input; it is zero before its first sample.
        initial : array, shape (p,), optional
            v_{-1}, ..., v_{-p}, the latest first.

        Raises
        ------
        ValueError
            If ``initial`` has not p values.
        """
        # Imported here: scipy.signal alone takes longer to load than validating a configuration.
        from scipy.signal import lfilter, lfiltic

        b, denominator = np.asarray(self.b, dtype=float), self.denominator
        if initial is None:
            return np.asarray(lfilter(b, denominator, w))
        if len(initial) != len(self.a):
            raise ValueError(f"needs {len(self.a)} past outputs, not {len(initial)}")
        return np.asarray(lfilter(b, denominator, w, zi=lfiltic(b, denominator, initial))[0])

    def impulse_response(self, n: int) -> Array:
        """The first ``n`` values gamma_0, gamma_1, ... of the impulse response."""
        impulse = np.zeros(n)
        impulse[:1] = 1.0
        return self.filter(impulse)

    def memory(self) -> int:
        """Samples after which the impulse response stays below 1e-16 of its largest value.

        Without feedback this is the number of coefficients b_0, ..., b_m.

        Raises
        ------
        ValueError
            If a pole has a modulus above 0.99999, unstable blocks included.
        """
        if not self.a:
            return len(self.b)
        if (radius := self.radius()) > SLOWEST:
            raise ValueError(
                f"a pole has modulus {apart(radius, SLOWEST, 8)}: the response lasts too long "
                f"(at most {SLOWEST})"
            )
        # Half of the window must be negligible, and that half must lie behind the last b.
        n = 64 + 2 * len(self.b)
        while True:
            response = np.abs(self.impulse_response(n))
            last = int(np.flatnonzero(response > _NEGLIGIBLE * response.max())[-1])
            if last < n // 2:
                return last + 1
            n *= 2

    def values(self) -> dict[str, float]:
        """The parameters by name: a_1, ..., a_p, b_0, ..., b_m."""
        named = {f"a_{i}": value for i, value in enumerate(self.a, start=1)}
        return named | {f"b_{i}": value for i, value in enumerate(self.b)}

    def to_scipy(self, dt: float = 1.0) -> Any:
        """The block as a :class:`scipy.signal.dlti` with sampling interval ``dt``, of the same response."""
        from scipy.signal import dlti

        return dlti(*self.in_z(), dt=dt)

    def to_control(self, dt: float = 1.0) -> Any:
        """The block as a :class:`control.TransferFunction` with sampling interval ``dt``.

        Raises
        ------
        ConfigError
            If python-control is not installed.
        """
        return python_control().TransferFunction(*self.in_z(), dt)

    def in_z(self) -> tuple[Array, Array]:
        """Numerator and denominator by falling power of z: times z^l, where q^-l is their last power."""
        length = max(len(self.b), len(self.a) + 1)
        top, bottom = (np.pad(c, (0, length - len(c))) for c in (self.b, self.denominator))
        # scipy warns of leading zeros, which a delay has.
        return top[int(np.argmax(top != 0.0)) :], bottom


@dataclass(frozen=True)
class ContinuousTransferFunction:
    """(b_0 + b_1 s + ... + b_m s^m) e^(-delay s) / (1 + a_1 s + ... + a_n s^n) with m < n.

    With ``integrators`` k, poles at zero, the denominator is s^k (1 + a_1 s + ... + a_n s^n), and m < n + k.
    Times are in the unit of the sampling interval of the data.

    Examples
    --------
    >>> block = ContinuousTransferFunction(b=(2.0,), a=(4.0, 3.0))
    >>> block.static_gain(), block.is_stable()
    (2.0, True)
    >>> block.sampled(dt=0.1).radius() < 1
    True
    """

    b: tuple[float, ...]
    a: tuple[float, ...]
    delay: float = 0.0
    integrators: int = 0

    def __post_init__(self) -> None:
        if not (self.a or self.integrators) or (self.a and self.a[-1] == 0.0):
            raise ValueError("the highest coefficient a_n must not be zero, and there must be one")
        if len(self.b) > self._order:
            raise ValueError(
                f"the block is improper: the order m = {len(self.b) - 1} of the numerator must be "
                f"below the order n = {self._order} of the denominator"
            )
        if self.integrators and self.b[0] == 0.0:
            raise ValueError(
                "b_0 = 0 takes an integrator away: leave out the first of b and one of the integrators"
            )
        if self.delay < 0.0:
            raise ValueError(f"the delay must not be negative, not {self.delay:g}")

    @property
    def denominator(self) -> Array:
        """The denominator's coefficients by falling power of s: a_n, ..., a_1, 1, and 0 for integrators."""
        return np.array([*reversed(self.a), 1.0, *[0.0] * self.integrators])

    @property
    def _order(self) -> int:
        """The number of poles."""
        return len(self.a) + self.integrators

    def _coefficients(self) -> list[float]:
        """The denominator's coefficients by rising power of s."""
        return [*[0.0] * self.integrators, 1.0, *self.a]

    def poles(self) -> Complex:
        """The poles, in 1/time; the block is stable when all lie in the left half plane."""
        return np.roots(self.denominator).astype(np.complex128)

    def zeros(self) -> Complex:
        """The zeros, in 1/time."""
        return np.roots(self.b[::-1]).astype(np.complex128)

    def is_stable(self, *, integrators: bool = False) -> bool:
        """Whether all poles lie in the left half plane; ``integrators``: or at zero."""
        poles = self.poles()
        # np.roots puts those at zero last, and exactly there.
        return bool(np.all((poles[: len(self.a)] if integrators else poles).real < 0.0))

    def static_gain(self) -> float:
        """The gain at frequency zero: exactly zero where b_0 is rounding beside what the others make.

        Infinite for an integrator.
        """
        if self.integrators:
            return math.copysign(math.inf, self.b[0])
        return self.b[0] if significant(self.b / self._unit ** np.arange(len(self.b)))[0] else 0.0

    def values(self) -> dict[str, float]:
        """The parameters by name: a_1, ..., a_n, b_0, ..., b_m."""
        named = {f"a_{i}": value for i, value in enumerate(self.a, start=1)}
        return named | {f"b_{i}": value for i, value in enumerate(self.b)}

    def to_scipy(self) -> Any:
        """The block as a :class:`scipy.signal.lti`.

        Raises
        ------
        ConfigError
            If it has a delay, which an lti cannot hold.
        """
        from scipy.signal import lti

        return lti(*self._in_s("a scipy.signal.lti", "to_scipy"))

    def to_control(self) -> Any:
        """The block as a :class:`control.TransferFunction`.

        Raises
        ------
        ConfigError
            If it has a delay, which that cannot hold, or python-control is not installed.
        """
        return python_control().TransferFunction(*self._in_s("a control.TransferFunction", "to_control"))

    def _in_s(self, target: str, method: str) -> tuple[Array, Array]:
        """Numerator and denominator by falling power of s, of a block without delay."""
        if self.delay:
            raise ConfigError(
                f"{target} holds no delay, and this block has {self.delay:g}: take sampled(dt).{method}(dt), "
                "the same response at the samples of a held input"
            )
        return np.trim_zeros(np.array(self.b[::-1]), "f"), self.denominator

    def scaled(self, gain: float) -> ContinuousTransferFunction:
        """The block with its output multiplied by ``gain``."""
        return replace(self, b=tuple(gain * b for b in self.b))

    def frequency_response(self, omega: Array) -> Complex:
        """The complex gain at angular frequencies ``omega`` (any shape), radians per unit of time."""
        s = 1j * np.asarray(omega, dtype=float)
        ratio = np.polyval(self.b[::-1], s) / np.polyval(self.denominator, s)
        return np.asarray(ratio * np.exp(-self.delay * s))

    @cached_property
    def _unit(self) -> float:
        """A unit of time in which the poles have a geometric mean of one, for good conditioning."""
        return float(abs(self.a[-1]) ** (1.0 / len(self.a))) if self.a else 1.0

    @cached_property
    def _form(self) -> tuple[Complex, Complex]:
        """(T, Q) with dz/dt = T z + B x, B the last row of Q conjugated; T is upper triangular.

        Time is in :attr:`_unit`.
        """
        from scipy.linalg import schur

        n, unit, coefficients = self._order, self._unit, self._coefficients()
        leading = coefficients[-1] / unit**n
        companion = np.eye(n, k=1)
        scaled = np.array([one / unit**i for i, one in enumerate(coefficients[:-1])])
        companion[-1] = -scaled / leading
        triangular, basis = schur(companion, output="complex")
        return triangular, basis

    def _weights(self, numerator: tuple[float, ...]) -> Complex:
        """C with y = C z, for a numerator b_0, ..., b_m."""
        n, unit = self._order, self._unit
        leading = self._coefficients()[-1] / unit**n
        output = np.zeros(n)
        output[: len(numerator)] = [b / unit**i / leading for i, b in enumerate(numerator)]
        return np.asarray(output @ self._form[1])

    def _held(self, dt: float) -> tuple[Complex, Complex]:
        """exp(T dt) and its integral from 0 to dt times B."""
        from scipy.linalg import expm

        triangular, basis = self._form
        into = basis[-1].conj()
        n = len(into)
        block = np.zeros((n + 1, n + 1), dtype=complex)
        block[:n, :n], block[:n, n] = triangular, into
        both = expm(block * (dt / self._unit))
        return both[:n, :n], both[:n, n]

    def _steps(self, dt: float) -> tuple[Complex, Complex, Complex, int]:
        """(Phi, Gamma_0, Gamma_1, D) with z_{k+1} = Phi z_k + Gamma_0 x_{k-D} + Gamma_1 x_{k-D-1}."""
        whole, fraction = split(self.delay / dt)
        rest = fraction * dt
        phi, gamma = self._held(dt)
        if rest == 0.0:
            return phi, gamma, np.zeros_like(gamma), whole
        after, recent = self._held(dt - rest)
        return phi, recent, after @ self._held(rest)[1], whole

    def respond(self, x: Array, dt: float) -> Array:
        """The response at the times k dt to an input held at ``x[k]`` from k dt on, from rest.

        Parameters
        ----------
        x : array, shape (N,)
            The held input; it is zero before its first sample.
        dt : float
            Sampling interval.

        Returns
        -------
        array, shape (N,)
            Exact for this input (zero-order hold), whatever the delay.
        """
        return self.responses((self.b,), x, dt)[:, 0]

    def responses(self, numerators: Sequence[tuple[float, ...]], x: Array, dt: float) -> Array:
        """The responses (N, J) of the blocks with these J numerators in place of b, as :meth:`respond`."""
        from scipy.signal import lfilter

        phi, recent, older, whole = self._steps(dt)
        delayed = np.concatenate((np.zeros(min(whole, len(x))), x[: max(len(x) - whole, 0)]))
        earlier = np.concatenate(([0.0], delayed[:-1]))
        z = np.empty((len(phi), len(x)), dtype=complex)
        for i in reversed(range(len(phi))):
            driven = recent[i] * delayed + older[i] * earlier + phi[i, i + 1 :] @ z[i + 1 :]
            z[i] = lfilter([0.0, 1.0], [1.0, -phi[i, i]], driven)
        return np.column_stack([(self._weights(numerator) @ z).real for numerator in numerators])

    def sampled(self, dt: float) -> TransferFunction:
        """The discrete block that relates held input and sampled output, its delay as leading zeros."""
        phi, recent, older, whole = self._steps(dt)
        output = self._weights(self.b)
        denominator = np.poly(np.diag(phi)).real
        markov = np.zeros(len(phi) + 2)
        state = recent
        for k in range(1, len(markov)):
            markov[k] = (output @ state).real
            state = phi @ state + (older if k == 1 else 0.0)
        numerator = np.convolve(denominator, markov)[: len(markov)]
        if not np.any(older):
            numerator = numerator[:-1]
        return TransferFunction(
            b=tuple(map(float, (*np.zeros(whole), *numerator))), a=tuple(map(float, -denominator[1:]))
        )

    def settling_time(self, band: float = 0.05) -> float:
        """The time after which the step response stays within ``band`` of its final value.

        The delay does not count. Infinite for an unstable block or one without static gain.
        """
        if not self.is_stable() or self.static_gain() == 0.0:
            return math.inf
        return settling_time(self.b, self.a, band)
