"""How methods fix what no data determine: the factor between the blocks, and what they leave open.

Multiply the linear block by a factor and divide the nonlinearity by it, and no output changes. So every
method fixes the factor by a rule of its own, and absolute values can be compared with those of a true system
only where that keeps the rule too: the same system, with the factor moved, does (:func:`brought`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hident.arrays import Array, Characteristic
from hident.config.suggest import counted, one_of
from hident.linear_blocks import ContinuousTransferFunction, TransferFunction, significant
from hident.numerics.freedoms import Freedom, multiple
from hident.numerics.least_squares import is_sum_of
from hident.records import Estimate, Truth

CLOSE = 1e-4
"""A factor this close to one counts as one: a coefficient that is written with four digits."""
# Where functions are compared: both signs, small and large.
_PROBES = np.concatenate((-np.geomspace(1e3, 1e-3, 61), np.geomspace(1e-3, 1e3, 61)))
# Steps at zero for difference quotients, of which the first that suits is taken: the first of all gives the
# slope to 1e-5 for a curvature of one. Smaller ones are for larger slopes, greater ones for those that a
# constant's rounding hides.
_STEP = 1e-6
_SMALLER = _STEP * 10.0 ** -np.arange(1.0, 25.0)
_GREATER = _STEP * 10.0 ** np.arange(1.0, 9.0)
_ROUNDED = 1e-8
# A value at zero this small beside others is rounding.
_LEVEL = 1e-12
# A quotient that changes by no more than the first part of it when the step is halved is the slope; one that
# changes by more than the second is none.
_STEADY, _VANISHING = 1e-5, 0.1

# Where sums of functions are compared.
_SIGNAL = np.linspace(-3.0, 3.0, 241)
_LINEAR = frozenset({"linear", "continuous"})

Factors = Mapping[str, float]
"""What each block of a system must be divided by to keep a rule, by its place: ``linear``, ``nonlinearity``,
``input`` and ``output``."""


class MissedConstant(NamedTuple):
    """How a method cannot hold the constant of a system's nonlinearity, which biases all that it finds.

    ``is_zero`` says that it takes the nonlinearity to be zero at zero; else its functions hold no constant.
    ``remedy`` estimates one, and ``when`` says with which of its settings it is so: with all if empty.
    """

    is_zero: bool
    remedy: str
    when: str = ""


def missed_constant(
    functions: Sequence[Characteristic], nonlinearity: Characteristic, remedy: str
) -> MissedConstant | None:
    """How sums of ``functions`` miss the constant of a ``nonlinearity``; None if they do not.

    They do not where one of them is a constant, or the nonlinearity itself.

    Examples
    --------
    >>> missed_constant([np.sin, np.square], lambda u: 1.0 + u, "add one")
    MissedConstant(is_zero=True, remedy='add one', when='')
    >>> missed_constant([np.sin, np.cos], lambda u: 1.0 + u, "add one")
    MissedConstant(is_zero=False, remedy='add one', when='')
    >>> missed_constant([np.sin, np.cos], lambda u: 2.0 * np.cos(u), "add one")
    """
    with np.errstate(all="ignore"):
        if level_at_zero(nonlinearity) == 0.0:
            return None
        if not any(np.any(phi(np.zeros(1))) for phi in functions):
            return MissedConstant(is_zero=True, remedy=remedy)
        rows = np.array([phi(_SIGNAL) for phi in functions], dtype=float)
        if is_sum_of(rows, np.ones(len(_SIGNAL))) or is_sum_of(rows, nonlinearity(_SIGNAL)):
            return None
    return MissedConstant(is_zero=False, remedy=remedy)


def level_at_zero(nonlinearity: Characteristic) -> float:
    """The value of a nonlinearity at zero; 0 if that is no number, or no more than rounding."""
    with np.errstate(all="ignore"):
        level, *beside = nonlinearity(np.array([0.0, -1.0, 1.0])).tolist()
    if not math.isfinite(level) or abs(level) <= _LEVEL * max(map(abs, beside)):
        return 0.0
    return float(level)


@dataclass(frozen=True)
class Normalisation:
    """A rule that fixes the factor between the blocks, and the parts of an estimate that it governs.

    ``parts`` are spelled as an estimator provides them, values by their letter (``value b`` for b_0, b_1,
    ...). ``factors`` takes a true system and the sampling interval (None: discrete time); it gives None where
    the system does not say, and raises ValueError if nothing brings the system to the rule. ``free`` is what
    no data determine of these parts; ``left`` is what of it the method does not fix either. ``found`` gives
    the rule of one estimate, where that depends on what was found, such as a delay; None: all have this one.
    ``says`` gives the rule in words where these depend on the system; None: ``rule`` of all.
    Of a method that adds nothing to the output, the nonlinearity is a sum of ``functions`` (None: of any);
    without one, it is zero at zero, whatever the data say.
    """

    rule: str
    parts: frozenset[str]
    factors: Callable[[Truth, float | None], Factors | None]
    free: frozenset[Freedom] = frozenset({"gain", "sign"})
    left: frozenset[Freedom] = frozenset()
    found: Callable[[Estimate], Normalisation] | None = None
    says: Callable[[Truth, float | None], str] | None = None
    functions: tuple[Characteristic, ...] | None = None

    def said(self, truth: Truth, dt: float | None) -> str:
        """The rule in words, for the estimates of a system."""
        return self.rule if self.says is None else self.says(truth, dt)

    def governs(self, part: str) -> bool:
        """Whether a part, such as ``nonlinearity`` or ``value b_1``, depends on the rule.

        A linear block is one part in discrete and in continuous time: an estimate may hold it in the one, and
        the system in the other.
        """
        if part in _LINEAR and not self.parts.isdisjoint(_LINEAR):
            return True
        return part in self.parts or part.rpartition("_")[0] in self.parts

    def of(self, estimate: Estimate | None) -> Normalisation:
        """The rule of one estimate; without one, what is known before."""
        return self if self.found is None or estimate is None else self.found(estimate)

    def leaving(self, *left: Freedom, says: str = "") -> Normalisation:
        """The rule of a method that does not fix these, with what it ``says`` of them."""
        return replace(self, rule=self.rule + says, free=self.free | {*left}, left=self.left | {*left})

    def beside(self, constant: bool, functions: Iterable[Characteristic] = ()) -> Normalisation:
        """The rule of a nonlinearity with a ``constant`` of the output beside it, or without.

        Such a constant cannot be told from one of the nonlinearity. Without it, that is zero at zero, or a
        sum of ``functions`` alone.
        """
        if constant:
            return self.leaving("constant", says=", a constant left open")
        return replace(self, functions=tuple(functions))

    def misses(self, nonlinearity: Characteristic) -> MissedConstant | None:
        """How the method cannot hold the constant of a true nonlinearity; None if it can."""
        if self.functions is None:
            return None
        return missed_constant(self.functions, nonlinearity, "'constant: true' estimates a constant")

    def of_signs(self) -> Normalisation:
        """The rule for the signs of the factors alone."""
        found = self.found

        def signs(truth: Truth, dt: float | None) -> Factors | None:
            factors = self.factors(truth, dt)
            return factors and {place: math.copysign(1.0, factor) for place, factor in factors.items()}

        return replace(self, factors=signs, found=found and (lambda estimate: found(estimate).of_signs()))

    def off(self, truth: Truth, dt: float | None) -> Factors:
        """What the blocks must be divided by; empty where the system keeps the rule, or does not say.

        ValueError if nothing brings the system to the rule.
        """
        factors = self.factors(truth, dt) or {}
        if all(abs(factor - 1.0) <= CLOSE for factor in factors.values()):
            return {}
        if truth.rescaled is None:
            found = one_of(f"{factor:.4g}" for factor in factors.values())
            raise ValueError(f"the system has {found} in place of 1, and no blocks between which it can move")
        return factors


def brought(truth: Truth, rules: Iterable[Normalisation], dt: float | None) -> Truth:
    """The truth of the same system that keeps the rules, each in the parts that it governs.

    The truth itself, to the last bit, where it keeps them already (:data:`CLOSE`).

    Raises
    ------
    ValueError
        If nothing brings the system to a rule, or two rules ask for different factors in one part.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="abs", linear=hi.Fir(b=[0, 2, 1]))
    >>> truth = brought(system.truth(), [first_coefficient(1)], None)
    >>> truth.linear.b, truth.nonlinearity(np.array([-1.0, 3.0]))
    ((0.0, 1.0, 0.5), array([2., 6.]))
    """
    kept, asked = truth, list[tuple[Normalisation, Factors]]()
    for rule in rules:
        factors = rule.off(kept, dt)
        for other, theirs in asked:
            if not other.parts.isdisjoint(rule.parts) and not _agree(factors, theirs):
                raise ValueError(
                    f"the rules '{other.rule}' and '{rule.rule}' ask for different factors of one system"
                )
        asked.append((rule, factors))
        if not factors:
            continue
        assert kept.rescaled is not None
        moved = kept.rescaled(factors)
        values = {
            name: moved.values[name] if rule.governs(f"value {name}") else value
            for name, value in truth.values.items()
        }
        # It is of the system as it is written.
        truth = replace(truth, values=values, rescaled=None)
        if rule.governs("nonlinearity"):
            truth = replace(truth, nonlinearity=moved.nonlinearity, breakpoints=moved.breakpoints)
        if rule.governs("linear"):
            truth = replace(truth, linear=moved.linear)
        if rule.governs("continuous"):
            truth = replace(truth, continuous=moved.continuous)
    return truth


def _agree(one: Factors, other: Factors) -> bool:
    """Whether the same factor moved between the blocks keeps two rules."""
    first, second = (
        {"linear": 1.0 / of["nonlinearity"]} if "nonlinearity" in of else dict(of) for of in (one, other)
    )
    places = first.keys() | second.keys()
    return all(abs(first.get(place, 1.0) / second.get(place, 1.0) - 1.0) <= CLOSE for place in places)


def _parts(values: str, *parts: str) -> frozenset[str]:
    return frozenset({*parts, *(f"value {letter}" for letter in values.split())})


_BOTH = ("nonlinearity", "linear", "continuous")


def unit_static_gain(values: str = "b c") -> Normalisation:
    """All linear blocks have the static gain 1."""
    return Normalisation("static gain 1", _parts(values, *_BOTH), lambda truth, dt: _static_gains(truth))


def unit_length(delay: int, lags: int, values: str, *, responses: bool = False) -> Normalisation:
    """The numerator's coefficients b (lags,), from the lag ``delay`` on, have length 1 and start positive.

    With ``responses`` they are those of a model without feedback: the impulse response of a system that has.
    """
    span = f"b_{delay}" if lags == 1 else f"b_{delay} to b_{delay + lags - 1}"

    def factors(truth: Truth, dt: float | None) -> Factors | None:
        block = _discrete(truth, dt)
        if block is None:
            return None
        b = np.zeros(delay + lags)
        own = significant(block.impulse_response(len(b)) if responses and block.a else block.b)[: len(b)]
        b[: len(own)] = own
        b = b[delay:]
        if b[0] == 0.0:
            found = "are zero" if not np.any(b) else f"begin with zero, and noise gives b_{delay} a sign"
            raise ValueError(f"the system's {span} {found}: set the estimator's delay to the system's")
        return {"linear": float(np.copysign(np.linalg.norm(b), b[0]))}

    return Normalisation(f"|b| = 1, b_{delay} > 0", _parts(values, *_BOTH), factors)


def first_coefficient(
    lag: int = 0, value: float = 1.0, values: str = "b", step: float | None = None, symbol: str = "b"
) -> Normalisation:
    """The coefficient b of a lag is given; of a continuous block sampled every ``step`` (default: dt)."""
    name = f"{symbol}_{lag}"

    def factors(truth: Truth, dt: float | None) -> Factors | None:
        block = _discrete(truth, step or dt)
        if block is None:
            return None
        found = float(significant(block.b)[lag]) if lag < len(block.b) else 0.0
        if found == 0.0:
            raise ValueError(
                f"the system has {name} = 0, which no factor makes {value:g}: its block delays the input more"
            )
        return {"linear": found / value}

    return Normalisation(f"{name} = {value:g}", _parts(values, *_BOTH), factors)


def behind(rule: Normalisation, delay: int | None, *, responses: bool = False) -> Normalisation:
    """A rule for the discrete block's coefficients, for those from the lag ``delay`` on.

    None is a delay that is not known yet: the system's own counts. With ``responses`` the rule is about the
    impulse response, else about the numerator.
    """

    def factors(truth: Truth, dt: float | None) -> Factors | None:
        block = _discrete(truth, dt)
        if block is None:
            return None
        b = significant(block.b)
        own = next(iter(np.flatnonzero(b).tolist()), 0)
        lag = own if delay is None else delay
        if responses and lag == 0:
            b = b[:1]
        elif responses:
            b = significant(TransferFunction(tuple(b.tolist()), block.a).impulse_response(lag + 1))
        later = TransferFunction(tuple(b[lag:].tolist()) or (0.0,), block.a)
        try:
            return rule.factors(replace(truth, linear=later, continuous=None), dt)
        except ValueError:
            if own == lag:
                raise
            raise ValueError(
                f"the system's block delays its input by {counted(own, 'sample')}, and the "
                f"estimator counts on {lag}: set the estimator's 'delay' to {own}, or to search"
            ) from None

    lags = "" if delay == 0 else ", lags counted from the delay" + ("" if delay is None else f" {delay}")
    return replace(rule, rule=rule.rule + lags, factors=factors)


def behind_found(
    rule: Normalisation, delay_of: Callable[[Estimate], int | None], *, responses: bool = False
) -> Normalisation:
    """A rule for the discrete block's coefficients, from the lag on that an estimate has found.

    None is no lag of its own: then, and where the system gives nothing at that lag, the system's own delay
    counts, as it does as long as there is no estimate.
    """
    known = behind(rule, None, responses=responses)
    known = replace(known, rule=f"{known.rule} found")

    def found(estimate: Estimate) -> Normalisation:
        delay = delay_of(estimate)
        if delay is None:
            return known
        there = behind(rule, delay, responses=responses)

        def factors(truth: Truth, dt: float | None) -> Factors | None:
            try:
                return there.factors(truth, dt)
            except ValueError:
                return known.factors(truth, dt)

        return replace(known, factors=factors)

    return replace(known, found=found)


def behind_noticed(
    rule: Normalisation, delay_of: Callable[[Estimate], int | None], largest: int
) -> Normalisation:
    """A rule for the impulse response, from the lag on that an estimate has noticed though none was given.

    It says so where a system shows more than twice as much of an earlier input, up to ``largest`` samples,
    as of the newest: beside less, the newest is not overlooked.
    """
    noticed = behind_found(rule, delay_of, responses=True)

    def says(truth: Truth, dt: float | None) -> str:
        block = _discrete(truth, dt)
        shown = np.ones(1) if block is None else block.impulse_response(largest + 1) ** 2
        return noticed.rule if np.max(shown) > 2.0 * shown[0] else rule.rule

    return replace(noticed, rule=rule.rule, says=says)


def unit_slope(rule: str, values: str, *parts: str) -> Normalisation:
    """The nonlinearity rises from zero to the right with the slope 1."""

    def factors(truth: Truth, dt: float | None) -> Factors | None:
        if truth.nonlinearity is None:
            return None
        slope = _slope(truth.nonlinearity)
        if not np.isfinite(slope) or slope == 0.0:
            raise ValueError(
                f"the system's nonlinearity has the slope {slope:g} at zero, which no factor makes 1"
            )
        return {"nonlinearity": slope}

    return Normalisation(rule, _parts(values, *parts), factors)


def _slope(function: Characteristic) -> float:
    """The slope of a function at zero, to the right; 0 or infinite where it has none other."""
    at_zero = float(function(np.zeros(1))[0])

    def quotients(step: float) -> tuple[float, float]:
        beside, halfway = function(np.array([step, step / 2.0]))
        return float(beside - at_zero) / step, float(halfway - at_zero) / (step / 2.0)

    def is_rounded(step: float) -> bool:
        return abs(quotients(step)[0]) * step < _ROUNDED * abs(at_zero)

    with np.errstate(all="ignore"):
        slope, nearer = quotients(_STEP)
        if slope == 0.0:
            return slope
        steps = _GREATER if is_rounded(_STEP) else np.array([_STEP, *_SMALLER])
        for step in (step for step in steps.tolist() if not is_rounded(step)):
            tried, halved = quotients(step)
            if abs(halved - tried) <= _STEADY * abs(tried):
                return tried
        if abs(nearer - slope) > _VANISHING * abs(slope):
            # That of a parabola halves with the step, that of a root grows.
            return 0.0 if abs(nearer) < abs(slope) else np.inf
    return slope


def known_function(
    rule: str, known: Characteristic, values: str = "b", *, constant: bool = False
) -> Normalisation:
    """The nonlinearity is the known one, and the linear block holds the rest of the gain.

    With ``constant`` one beside it is estimated, and the nonlinearity of a system may have any.
    """

    def at_probes(function: Characteristic) -> Array:
        return function(_PROBES) - (function(np.zeros(1)) if constant else 0.0)

    def factors(truth: Truth, dt: float | None) -> Factors | None:
        if truth.nonlinearity is None:
            return None
        with np.errstate(all="ignore"):
            ratio = multiple(at_probes(truth.nonlinearity), at_probes(known))
            # Of a Wiener system it is the argument that takes a factor.
            if ratio is not None and abs(ratio - 1.0) > CLOSE and truth.rescaled is not None:
                moved = truth.rescaled({"nonlinearity": ratio}).nonlinearity
                one = None if moved is None else multiple(at_probes(moved), at_probes(known))
                ratio = ratio if one is not None and abs(one - 1.0) <= CLOSE else None
        if ratio is None:
            beside = " and a constant" if constant else ""
            raise ValueError(f"the system's nonlinearity is not a multiple of it{beside}")
        return {"nonlinearity": ratio}

    return Normalisation(rule, _parts(values, *_BOTH), factors)


def _discrete(truth: Truth, dt: float | None) -> TransferFunction | None:
    """The linear block as its samples see it."""
    if truth.linear is not None:
        return truth.linear
    return None if truth.continuous is None else truth.continuous.sampled(dt or 1.0)


def _static_gains(truth: Truth) -> Factors | None:
    blocks: dict[str, TransferFunction | ContinuousTransferFunction] = {
        **truth.blocks,
        **truth.discrete_blocks,
    }
    if block := truth.continuous or truth.linear:
        blocks["linear"] = block
    gains = {place: block.static_gain() for place, block in blocks.items()}
    for place, gain in gains.items():
        if gain == 0.0 or not np.isfinite(gain):
            raise ValueError(f"the system's {place} block has no static gain")
    return gains or None
