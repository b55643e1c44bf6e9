"""The disturbance that a nonparametric estimate of a Hammerstein nonlinearity has to average out.

delta_k = y_k - w_k = sum_{i>=1} gamma_i w_{k-i} + z_k          without filtering, Mzyk 2009, (20)
delta_k^f = y_k^f - w_k                                         after filtering, Mzyk 2009, (21)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hident.config.spec import Flag, Real, component
from hident.linear_blocks import SLOWEST
from hident.metrics.base import Comparing, MetricSpec, Scored
from hident.numerics.parts import in_each, longer_than
from hident.numerics.rounding import apart
from hident.records import Estimate, Record, needed

# A coefficient that is written with four digits.
_CLOSE = 1e-4


def _check_first_coefficient(scored: Scored) -> None:
    """Raise ValueError unless gamma_0 is 1, without which y - w is no disturbance."""
    block = scored.truth.linear
    if block is not None and abs(block.b[0] - 1.0) > _CLOSE:
        raise ValueError(
            "takes y - w for the disturbance, which holds where gamma_0 = 1, "
            f"and the system has {block.b[0]:.4g}"
        )


@component("metric", "disturbance_variance", source="Mzyk 2009, section IV-C")
class DisturbanceVariance(Comparing):
    """Variance of the output (or of the filtered output) about the nonlinearity's output w_k.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="abs", linear=hi.Ar(a=[0.5]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 5000)
    >>> round(hi.score(hi.Estimate(), record, variance=hi.DisturbanceVariance())["variance"], 2)
    0.03
    """

    filtered: Flag = False
    """Filter the output of each experiment by the inverse of the estimated linear block first, eq. (14)."""

    def needs_of_truth(self) -> frozenset[str]:
        return frozenset({"nonlinearity"})

    def needs_of_estimate(self) -> frozenset[str]:
        return frozenset({"linear"} if self.filtered else ())

    def compares(self) -> frozenset[str]:
        return self.needs_of_estimate()

    def check(self, scored: Scored) -> None:
        _check_first_coefficient(scored)

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        nonlinearity = needed(needed(record.truth).nonlinearity)
        y, w, parts = record.y, nonlinearity(record.u), record.experiments
        if not self.filtered:
            return (float(np.var(y - w, ddof=1)),)
        linear = needed(estimate.linear)
        inverse, lost = linear.inverse(), len(linear.a)
        delta = in_each(longer_than(parts, lost), lambda y, w: (inverse.filter(y) - w)[lost:], y, w)
        return (float(np.var(delta, ddof=1)),)


@component("metric", "disturbance_variance_formula", source="Mzyk 2009, eq. (20), (21)")
class DisturbanceVarianceFormula(MetricSpec):
    """The variance that (20) gives, or (21) without its term c_v/N, from the true linear block.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="abs", linear=hi.Ar(a=[0.5]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 500)
    >>> formula = hi.DisturbanceVarianceFormula(noise_variance=0.1, w_variance=0.3)
    >>> round(hi.score(hi.Estimate(), record, variance=formula)["variance"], 6)
    0.2
    """

    noise_variance: Real
    """Variance sigma_z^2 of the output noise."""
    w_variance: Real
    """Variance sigma_w^2 of the nonlinearity's output."""
    filtered: Flag = False
    """Evaluate (21), after filtering, instead of (20)."""
    squared: Flag = True
    """Square gamma_i in (20); false shows the value that leaving the square out gives."""

    def needs_of_truth(self) -> frozenset[str]:
        return frozenset({"linear"})

    def check(self, scored: Scored) -> None:
        _check_first_coefficient(scored)
        linear = scored.truth.linear
        if not self.filtered and linear is not None and (radius := linear.radius()) > SLOWEST:
            raise ValueError(
                "sums over the impulse response of the system's linear block, which lasts too long: a pole "
                f"has modulus {apart(radius, SLOWEST, 8)} (at most {SLOWEST})"
            )

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        linear = needed(needed(record.truth).linear)
        if self.filtered:  # Eq. (21)
            return (self.noise_variance * float(np.sum(linear.denominator**2)),)
        gamma = linear.impulse_response(linear.memory())[1:]
        power = 2 if self.squared else 1
        return (self.noise_variance + self.w_variance * float(np.sum(gamma**power)),)  # Eq. (20)
