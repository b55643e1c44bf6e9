"""The random numbers of MATLAB 5 to 7: ``rand('state', s)``, ``randn('state', s)``, ``rand('twister', s)``.

Papers of those years fix their data by these states. Number for number:

=========  =====================================================================================
SHR3       j ^= j << 13, j ^= j >> 17, j ^= j << 5 on 32 bits: linear over GF(2)
CONG       i -> 69069 i + 1234567 modulo 2^32: affine
uniform    x_n = x_{n-12} - x_{n-27} - borrow modulo 1, in steps of 2^-53, its mantissa masked by SHR3
normal     ziggurat of 64 strips, each word CONG + SHR3: low 6 bits the strip, all 32 the position
=========  =====================================================================================

A jump of 2^k steps of SHR3 or CONG costs as much as one step, so a sequence doubles with every jump. The
subtraction advances 12 numbers at once as one integer of 12 digits. The ziggurat treats all words together
and then walks over the few that need more than one word.

Sources: Marsaglia and Zaman 1991, A new class of random number generators, Annals of Applied Probability 1
(subtract with borrow); Marsaglia and Tsang 1984, A fast, easily implemented method for sampling from
decreasing or symmetric unimodal density functions, SIAM J. Sci. Stat. Comput. 5 (ziggurat); Moler 2004,
Numerical Computing with MATLAB, section 9 (both, as MATLAB combines them).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache, cached_property, partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hident.arrays import Array

Words = NDArray[np.uint32]
Size = int | tuple[int, ...] | None

_LARGEST_STATE = 2**32 - 1
_ZERO_STATE_RAND = 2**31
_ZERO_STATE_RANDN = 521288629
_CONG_START = 362436069
_CONG_MULTIPLIER, _CONG_INCREMENT = 69069, 1234567
_SHORT_LAG, _LONG_LAG = 12, 27
_DIGIT = 53
_LANE = 64
_DIGITS = sum((2**_DIGIT - 1) << _LANE * lane for lane in range(_SHORT_LAG))
# Words kept in reserve, besides one for every 16 draws: a draw takes 1.044 words on average.
_SPARE = 16

# Edges of the strips and the constants of their tips, as published: with 7 digits.
# fmt: off
_Z = np.array([
    0.3409450, 0.4573146, 0.5397793, 0.6062427, 0.6631691, 0.7136975, 0.7596125, 0.8020356, 0.8417227,
    0.8792102, 0.9148948, 0.9490791, 0.9820005, 1.0138492, 1.0447810, 1.0749254, 1.1043917, 1.1332738,
    1.1616530, 1.1896010, 1.2171815, 1.2444516, 1.2714635, 1.2982650, 1.3249008, 1.3514125, 1.3778399,
    1.4042211, 1.4305929, 1.4569915, 1.4834527, 1.5100122, 1.5367061, 1.5635712, 1.5906454, 1.6179680,
    1.6455802, 1.6735255, 1.7018503, 1.7306045, 1.7598422, 1.7896223, 1.8200099, 1.8510770, 1.8829044,
    1.9155831, 1.9492166, 1.9839239, 2.0198431, 2.0571356, 2.0959930, 2.1366450, 2.1793713, 2.2245175,
    2.2725186, 2.3239338, 2.3795008, 2.4402218, 2.5075117, 2.5834658, 2.6713916, 2.7769942, 2.7769942,
    2.7769942, 2.7769942,
])
# fmt: on
_A, _B, _C = 12.37586, 0.4878992, 12.67706
_C1, _C2, _PC, _XN = 0.9689279, 1.301198, 0.01958303, 2.776994


def state_number(value: float) -> int:
    """The state as an int.

    Raises
    ------
    ValueError
        If it is not a whole number from 0 to 2^32 - 1.
    """
    if not (0 <= value <= _LARGEST_STATE and value == int(value)):
        raise ValueError(f"a state is a whole number from 0 to {_LARGEST_STATE}, not {value:.10g}")
    return int(value)


class Rand:
    """``rand('state', state)``: uniform on (0, 1).

    Raises
    ------
    ValueError
        If the state is not a whole number from 0 to 2^32 - 1.
    """

    def __init__(self, state: int) -> None:
        self._shr3 = np.array([state_number(state) or _ZERO_STATE_RAND], dtype=np.uint32)
        # Bit 19 of SHR3 fills 32 digits, the highest bit first; the first five are never used.
        bits = _sequence(self._shr3, 32 * _DIGIT, _shr3_jump)[0, 1:] >> 19 & 1
        digits = bits.reshape(32, _DIGIT).astype(np.uint64) @ (1 << np.arange(_DIGIT, dtype=np.uint64)[::-1])
        self._window = int.from_bytes(digits[-_LONG_LAG:].astype("<u8").tobytes(), "little")
        self._borrow = 0

    def random(self, size: Size = None) -> Array:
        """The next numbers, in the order in which numpy fills an array (MATLAB fills columns first)."""
        n = _count(size)
        digits, self._window, self._borrow = _subtract_with_borrow(self._window, self._borrow, n)
        shr3 = _sequence(self._shr3, n, _shr3_jump)
        self._shr3 = shr3[:, -1].copy()
        old, new = shr3[0, :-1].astype(np.uint64), shr3[0, 1:].astype(np.uint64)
        mask = (new << 32 & np.uint64(2**52 - 1)) ^ old
        # All but the leading one of the 53 bits, which a float does not store.
        drawn = ((digits * 2.0**-_DIGIT).view(np.uint64) ^ mask).view(np.float64)
        return _shaped(drawn, size)


class Randn:
    """``randn('state', state)``: standard normal.

    Neighbouring small states begin with nearly the same position u in the strip, so their first draws are
    not independent: a flaw of MATLAB's seeding.

    Raises
    ------
    ValueError
        If the state is not a whole number from 0 to 2^32 - 1.
    """

    def __init__(self, state: int, beginnings: Beginnings | None = None) -> None:
        self._first = partial((beginnings or Beginnings([state])).of, state)
        self._at: tuple[Words, Words] | None = None

    def standard_normal(self, size: Size = None) -> Array:
        """The next numbers, in the order in which numpy fills an array (MATLAB fills columns first)."""
        n = _count(size)
        drawn, cong, shr3 = _normals(*self._at, n) if self._at else self._first(n)
        self._at = cong, shr3
        return _shaped(drawn[0], size)


class Beginnings:
    """The first normal numbers of several states, drawn together when one of them is asked for."""

    def __init__(self, states: Sequence[int]) -> None:
        self._rows = {state_number(state): row for row, state in enumerate(dict.fromkeys(states))}
        self._drawn: dict[int, tuple[Array, Words, Words]] = {}

    def of(self, state: int, n: int) -> tuple[Array, Words, Words]:
        """The first ``n`` of a state (1, n), and where its generators stand then, (1,) each."""
        if n not in self._drawn:
            self._drawn = {n: _normals(*_normal_starts([*self._rows]), n)}
        row = slice(at := self._rows[state], at + 1)
        drawn, cong, shr3 = self._drawn[n]
        # What is drawn is the caller's to write to.
        return drawn[row].copy(), cong[row], shr3[row]


def normals(states: Sequence[int], n: int) -> Array:
    """The first ``n`` numbers of ``randn('state', s)`` for each of the states, shape (len(states), n).

    Raises
    ------
    ValueError
        If a state is not a whole number from 0 to 2^32 - 1.
    """
    return _normals(*_normal_starts(states), n)[0]


def twister(state: int) -> np.random.Generator:
    """``rand('twister', state)``: numpy's MT19937 with the original seeding, which takes 0 as it is.

    Differs from MATLAB 7.7's later ``rng(0)``, which means the seed 5489.

    Raises
    ------
    ValueError
        If the state is not a whole number from 0 to 2^32 - 1.
    """
    bits = np.random.MT19937()
    bits.state = np.random.RandomState(state_number(state)).get_state(legacy=False)  # type: ignore[assignment]
    return np.random.Generator(bits)


class MatlabStream:
    """A session of MATLAB after ``rand(generator, state)`` and ``randn('state', state)``.

    It answers what excitations and noises ask of a numpy generator. MATLAB 7's twister makes uniform
    numbers only, so normal ones come from the ziggurat in any case.

    Raises
    ------
    ValueError
        If the state is not a whole number from 0 to 2^32 - 1.
    """

    def __init__(
        self,
        state: int,
        generator: Literal["state", "twister"] = "state",
        beginnings: Beginnings | None = None,
    ) -> None:
        self._state = state_number(state)
        self._generator = generator
        self._beginnings = beginnings

    def random(self, size: Size = None) -> Array:
        """The next uniform numbers."""
        return self._rand.random(size)

    def standard_normal(self, size: Size = None) -> Array:
        """The next normal numbers."""
        return self._randn.standard_normal(size)

    def integers(self, low: int, high: int) -> int:
        """The next uniform number as a whole one from ``low`` to ``high - 1``."""
        return low + int((high - low) * self.random())

    @cached_property
    def _rand(self) -> Rand | np.random.Generator:
        return twister(self._state) if self._generator == "twister" else Rand(self._state)

    @cached_property
    def _randn(self) -> Randn:
        return Randn(self._state, self._beginnings)


def _count(size: Size) -> int:
    return 1 if size is None else size if isinstance(size, int) else math.prod(size)


def _shaped(drawn: Array, size: Size) -> Array:
    return drawn[0] if size is None else drawn.reshape(size)


def _sequence(start: Words, n: int, jump: Callable[[Words, int], Words]) -> Words:
    """Each start (S,) and its ``n`` successors, shape (S, n + 1); a jump goes 2^k steps ahead."""
    found = np.empty((len(start), n + 1), dtype=np.uint32)
    found[:, 0] = start
    for k in range(n.bit_length()):
        known = 2**k
        found[:, known : 2 * known] = jump(found[:, : min(known, n + 1 - known)], k)
    return found


def _shr3_jump(j: Words, k: int) -> Words:
    lowest, low, high, highest = _shr3_table(k)
    jumped: Words = lowest[j & 255] ^ low[j >> 8 & 255] ^ high[j >> 16 & 255] ^ highest[j >> 24]
    return jumped


@cache
def _shr3_table(k: int) -> Words:
    """What 2^k steps make of each value of each byte, lowest byte first, shape (4, 256)."""
    if k:
        return _shr3_jump(_shr3_table(k - 1), k - 1)
    j: Words = np.arange(256, dtype=np.uint32) << np.array([[0], [8], [16], [24]], dtype=np.uint32)
    j ^= j << 13
    j ^= j >> 17
    j ^= j << 5
    return j


def _cong_jump(i: Words, k: int) -> Words:
    multiplier, increment = _cong_map(k)
    return i * np.uint32(multiplier) + np.uint32(increment)


@cache
def _cong_map(k: int) -> tuple[int, int]:
    """Multiplier and increment of 2^k steps."""
    if k:
        multiplier, increment = _cong_map(k - 1)
        return multiplier**2 % 2**32, increment * (multiplier + 1) % 2**32
    return _CONG_MULTIPLIER, _CONG_INCREMENT


def _subtract_with_borrow(window: int, borrow: int, n: int) -> tuple[NDArray[np.uint64], int, int]:
    """The next ``n`` digits (n,) of x_n = x_{n-12} - x_{n-27} - borrow, then the new window and borrow.

    The window holds the last 27 digits of 53 bits in lanes of 64 bits, the oldest lowest. A lane that falls
    below zero borrows from the next one, and modulo 2^64 its low 53 bits are the digit.
    """
    pieces = []
    for start in range(0, n, _SHORT_LAG):
        width = _LANE * min(_SHORT_LAG, n - start)
        lanes = (1 << width) - 1
        recent = window >> _LANE * (_LONG_LAG - _SHORT_LAG) & lanes
        difference = recent - (window & lanes) - borrow
        borrow = int(difference < 0)
        digits = difference & lanes & _DIGITS
        pieces.append(digits.to_bytes(width // 8, "little"))
        window = (window | digits << _LANE * _LONG_LAG) >> width
    return np.frombuffer(b"".join(pieces), dtype="<u8"), window, borrow


def _normal_starts(states: Sequence[int]) -> tuple[Words, Words]:
    """The states of CONG and SHR3, each of shape (S,)."""
    shr3 = np.array([state_number(state) or _ZERO_STATE_RANDN for state in states], dtype=np.uint32)
    return np.full_like(shr3, _CONG_START), shr3


def _normals(cong: Words, shr3: Words, n: int) -> tuple[Array, Words, Words]:
    """The next ``n`` draws of every stream, shape (S, n), and the states (S,) after them."""
    spare = n // 16 + _SPARE
    while True:
        congs, shr3s = _sequence(cong, n + spare, _cong_jump), _sequence(shr3, n + spare, _shr3_jump)
        values, starts = _ziggurat(congs[:, 1:] + shr3s[:, 1:])
        rank = np.cumsum(starts, axis=1)
        if np.all(rank[:, -1] > n):
            break
        spare *= 2
    drawn = values[starts & (rank <= n)].reshape(len(cong), n)
    streams, following = np.arange(len(cong)), np.argmax(rank > n, axis=1)
    return drawn, congs[streams, following], shr3s[streams, following]


def _ziggurat(words: Words) -> tuple[Array, NDArray[np.bool_]]:
    """The normal number that would begin at each word, and whether one does, both of shape (S, W).

    A draw that needs words beyond its row does not count as begun, nor does what follows it.
    """
    width = words.shape[1]
    flat = words.ravel()
    u = flat.view(np.int32).astype(np.float64) * 2.0**-31
    strip = flat & np.uint32(63)
    values = u * _Z[strip + 1]
    slow = np.flatnonzero(np.abs(values) > _Z[strip])
    stop = (slow // width + 1) * width
    magnitude, end = _tips(u, slow, np.abs(values[slow]), strip[slow], stop)
    values[slow] = np.copysign(magnitude, values[slow])
    complete = end <= stop
    starts = np.ones(len(flat), dtype=np.bool_)
    first, last = np.where(complete, slow + 1, slow), np.where(complete, end, stop)
    for word, after, before in zip(slow.tolist(), first.tolist(), last.tolist(), strict=True):
        # A word that an earlier draw has used up begins none.
        if starts[word]:
            starts[after:before] = False
    return values.reshape(words.shape), starts.reshape(words.shape)


def _tips(
    u: Array, slow: NDArray[np.intp], r: Array, strip: Words, stop: NDArray[np.intp]
) -> tuple[Array, NDArray[np.intp]]:
    """Absolute values of the draws that begin at the ``slow`` words, and the words at which they end.

    Where words at or beyond ``stop`` are needed, the end lies beyond it.
    """

    def uniform(word: NDArray[np.intp]) -> Array:
        return 0.5 + 0.5 * u.take(word, mode="clip")

    def density(x: Array) -> Array:
        return np.exp(-0.5 * x * x)

    low, high = _Z[strip], _Z[strip + 1]
    x = (r - low) / (high - low)
    y = uniform(slow + 1)
    mirrored = _B - _B * x
    swap = (x + y > _C2) | ((x + y > _C1) & (y > _C - _A * density(mirrored)))
    keep = (x + y <= _C1) | (density(high) + y * _PC / high <= density(r))
    magnitude = np.where(swap, mirrored, r)
    end = slow + 2
    tail = np.flatnonzero(~(swap | keep))
    while len(tail):
        # A word of -2^31 makes the uniform number 0 and its logarithm -inf, as in MATLAB.
        with np.errstate(divide="ignore"):
            x, log = np.log(uniform(end[tail])) / _XN, np.log(uniform(end[tail] + 1))
        magnitude[tail] = _XN - x
        end[tail] += 2
        tail = tail[(-2 * log <= x * x) & (end[tail] <= stop[tail])]
    return magnitude, end
