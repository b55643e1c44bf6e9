"""Where the poles and zeros of the best linear approximation of a chain may stand.

The best linear approximation of static and linear blocks one after the other, under a Gaussian input, is a
constant times the product of the linear blocks (Bussgang; Schoukens et al. 2014 split it for
Wiener-Hammerstein systems). Which block a pole or a zero belongs to it does not tell: all splits are tried.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice, product

import numpy as np

from hident.arrays import Complex
from hident.estimators.prediction_error.linear_start import from_roots
from hident.linear_blocks import TransferFunction

_REAL = 1e-9
_COUNTED = 4096


def groups(roots: Complex) -> list[Complex]:
    """The roots that must stay together: conjugate pairs, and single real ones, the largest first."""
    found = []
    for root in sorted(roots, key=lambda z: (-abs(z), z.real)):
        if abs(root.imag) <= _REAL * max(abs(root), 1.0):
            found.append(np.array([complex(root.real)]))
        elif root.imag > 0.0:
            found.append(np.array([root, root.conjugate()]))
    return found


def parted(roots: Complex) -> Complex:
    """The roots with two real ones in the place of each pair, for blocks that have no room for one."""
    found: list[complex] = []
    for group in groups(roots):
        if len(group) == 1:
            found.append(complex(group[0]))
        else:
            size, sign = abs(group[0]), 1.0 if group[0].real >= 0.0 else -1.0
            found += [complex(sign * size**power) for power in (0.8, 1.25)]
    return np.array(found, complex)


def splits(roots: Complex, places: int, most: int) -> list[tuple[Complex, ...]]:
    """Ways to give the roots to so many blocks: all of them, or ``most`` that are spread over all."""
    found = list(islice(_all_splits(roots, places), _COUNTED))
    if len(found) <= most:
        return found
    return [found[round(k * (len(found) - 1) / (most - 1))] for k in range(most)]


def _all_splits(roots: Complex, places: int) -> Iterator[tuple[Complex, ...]]:
    none = np.zeros(0, complex)
    together = groups(roots)
    for choice in product(range(places), repeat=len(together)):
        yield tuple(
            np.concatenate([none, *(g for g, c in zip(together, choice, strict=True) if c == i)])
            for i in range(places)
        )


def block(zeros: Complex, poles: Complex, delay: int) -> TransferFunction:
    """The block with these roots, whose first coefficient behind the delay is 1."""
    b, f = from_roots(zeros), from_roots(poles)
    return TransferFunction((*(0.0,) * delay, *b.tolist()), tuple((-f[1:]).tolist()))


def fits(zeros: Sequence[Complex], poles: Sequence[Complex], sizes: Sequence[tuple[int, int]]) -> bool:
    """Whether each block (nb, nf) has room for its roots."""
    return all(
        len(z) < max(nb, 1) and len(p) <= nf for z, p, (nb, nf) in zip(zeros, poles, sizes, strict=True)
    )
