"""A metric of your own, in its own file: trials are not computed again when it changes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hident.config.spec import Interval, component
from hident.metrics.base import MetricSpec
from hident.records import Estimate, Record, needed

POINTS = 1001


@component("metric", "starter_error")
class StarterError(MetricSpec):
    """Largest distance between the estimated and the true nonlinearity."""

    interval: Interval
    """Where they are compared: [low, high]."""

    def needs_of_truth(self) -> frozenset[str]:
        return frozenset({"nonlinearity"})

    def needs_of_estimate(self) -> frozenset[str]:
        return frozenset({"nonlinearity"})

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        u = np.linspace(*self.interval, POINTS)
        truth = needed(needed(record.truth).nonlinearity)
        return (float(np.max(np.abs(needed(estimate.nonlinearity)(u) - truth(u)))),)
