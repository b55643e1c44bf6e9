"""Elementary functions of single numbers, with the same bits on every machine.

The functions of libm and of numpy differ in last bits between processors and systems, and a last bit of a
configuration's number is another hash of its data, so other random numbers. So they are evaluated here in
decimal arithmetic, which is the same everywhere, with about a hundred digits, and rounded once. A whole
exponent is an exact rational number: there the rounding has ties. All other results are rounded correctly,
unless they lie within a relative 1e-90 of the middle between two floats.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from decimal import MAX_EMAX, MIN_EMIN, ROUND_HALF_EVEN, Context, Decimal, localcontext
from fractions import Fraction

_DIGITS = 100
_LARGEST_EXACT = 100
"""Whole exponents up to here are exact; ties end where a power of three has more than 54 bits."""


def power(x: float, y: float) -> float:
    """x**y for finite x and y with a finite result, x not zero."""
    if y == int(y) and abs(y) <= _LARGEST_EXACT:
        return float(Fraction(x) ** int(y))
    return _rounded(lambda a, b: a**b, x, y)


def exp(x: float) -> float:
    return _rounded(Decimal.exp, x)


def log(x: float) -> float:
    return _rounded(Decimal.ln, x)


def log10(x: float) -> float:
    return _rounded(Decimal.log10, x)


def sinh(x: float) -> float:
    return _rounded(lambda a: (a.exp() - (-a).exp()) / 2, x)


def cosh(x: float) -> float:
    return _rounded(lambda a: (a.exp() + (-a).exp()) / 2, x)


def tanh(x: float) -> float:
    # Beyond, the nearest float is one.
    return math.copysign(1.0, x) if abs(x) > 30 else _rounded(lambda a: 1 - 2 / ((2 * a).exp() + 1), x)


def sin(x: float) -> float:
    return _rounded(lambda a: _sin_cos(a)[0], x)


def cos(x: float) -> float:
    return _rounded(lambda a: _sin_cos(a)[1], x)


def tan(x: float) -> float:
    def quotient(a: Decimal) -> Decimal:
        sine, cosine = _sin_cos(a)
        return sine / cosine

    return _rounded(quotient, x)


def arctan(x: float) -> float:
    return _rounded(_arctan, x)


def arcsin(x: float) -> float:
    return (
        math.copysign(math.pi / 2, x)
        if abs(x) == 1
        else _rounded(lambda a: _arctan(a / (1 - a * a).sqrt()), x)
    )


def arccos(x: float) -> float:
    return math.pi if x == -1 else _rounded(lambda a: 2 * _arctan(((1 - a) / (1 + a)).sqrt()), x)


def _rounded(function: Callable[..., Decimal], *arguments: float) -> float:
    """The float nearest to a function of numbers, evaluated with digits to spare for what cancels."""
    exact = [Decimal(argument) for argument in arguments]
    digits = _DIGITS + 2 * max(abs(argument.adjusted()) for argument in exact)
    context = Context(prec=digits, rounding=ROUND_HALF_EVEN, Emin=MIN_EMIN, Emax=MAX_EMAX, traps=[])
    with localcontext(context):
        return float(function(*exact))


def _sin_cos(x: Decimal) -> tuple[Decimal, Decimal]:
    """Sine and cosine, by what is left of the angle after whole quarter turns."""
    quarter = 2 * _arctan(Decimal(1))
    turns = (x / quarter).to_integral_value()
    rest = x - turns * quarter
    sine = _series(rest, lambda n: -rest * rest / (2 * n * (2 * n + 1)))
    cosine = _series(Decimal(1), lambda n: -rest * rest / ((2 * n - 1) * 2 * n))
    return ((sine, cosine), (cosine, -sine), (-sine, -cosine), (-cosine, sine))[int(turns) % 4]


def _arctan(x: Decimal) -> Decimal:
    """By halving the angle until its series converges quickly."""
    halvings = 0
    while abs(x) > Decimal("0.05"):
        x, halvings = x / (1 + (1 + x * x).sqrt()), halvings + 1
    return Decimal(2) ** halvings * _series(x, lambda n: -x * x * (2 * n - 1) / (2 * n + 1))


def _series(first: Decimal, ratio: Callable[[int], Decimal]) -> Decimal:
    """The sum of terms of which the n-th is ratio(n) times the one before."""
    total, term, n = Decimal(0), first, 0
    while total + term != total:
        total, n = total + term, n + 1
        term *= ratio(n)
    return total
