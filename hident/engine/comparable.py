"""Whether the absolute values that a metric compares mean the same in an estimate and in the true system.

No data determine the factor between the blocks, and each estimator fixes it by a rule of its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from hident.config.suggest import one_of
from hident.estimators.base import EstimatorSpec
from hident.estimators.normalisation import CLOSE, Normalisation
from hident.metrics.base import MetricSpec
from hident.systems.base import SystemSpec
from hident.systems.blocks import Hammerstein, Wiener

_PLACES = {"linear": "b of the linear block", "input": "b of input_linear", "output": "b of output_linear"}


def governed(metric: MetricSpec, estimator: EstimatorSpec) -> Iterator[tuple[Normalisation, list[str]]]:
    """The estimator's rules on which the metric's score depends, with the parts that it compares."""
    alternatives = {part for need in metric.compares() for part in need.split(" or ")}
    compared = sorted(alternatives & estimator.provides())
    for rule in estimator.normalisations() or ():
        if parts := [part for part in compared if rule.governs(part)]:
            yield rule, parts


def incomparable(
    metric: MetricSpec, name: str, estimator: EstimatorSpec, system: SystemSpec, dt: float | None
) -> Iterator[str]:
    """Why the metric's score of the estimator, which the file calls ``name``, would say nothing."""
    for rule, parts in governed(metric, estimator):
        named = one_of(part.removeprefix("value ") for part in parts)
        said = (
            f"compares absolute values ({named}), and no data determine the factor between the blocks: "
            f"estimator '{name}' ({estimator.kind}) fixes it by the rule '{rule.rule}'"
        )
        try:
            factors = rule.factors(system.truth(), dt) or {}
        except ValueError as error:
            yield f"{said}; {error}{_instead(estimator, system)}"
            continue
        off = {place: factor for place, factor in factors.items() if abs(factor - 1.0) > CLOSE}
        if off:
            found = one_of(f"{factor:.4g}" for factor in off.values())
            yield (
                f"{said}, and the system has {found} in place of 1. {_remedy(system, off)}, which is the "
                f"same system{_instead(estimator, system)}"
            )


def _remedy(system: SystemSpec, factors: Mapping[str, float]) -> str:
    """What brings the system to a rule, given what each of its blocks must be divided by."""
    if isinstance(system, Hammerstein | Wiener):
        hammerstein = isinstance(system, Hammerstein)
        if (factor := factors.get("linear")) is not None:
            back = (
                "multiply the nonlinearity by it"
                if hammerstein
                else "multiply the nonlinearity's argument by it"
            )
            return f"Divide {_PLACES['linear']} by {factor:.10g} and {back}"
        back = "the nonlinearity" if hammerstein else "the nonlinearity's argument"
        return f"Divide {back} by {factors['nonlinearity']:.10g} and multiply {_PLACES['linear']} by it"
    divided = one_of(f"{_PLACES.get(place, place)} by {factor:.10g}" for place, factor in factors.items())
    return f"Divide {divided}, and multiply before and after the nonlinearity instead"


def _instead(estimator: EstimatorSpec, system: SystemSpec) -> str:
    """The metrics that do not depend on the factor."""
    given, true = estimator.provides(), system.provides()
    metrics = [
        *(["validation_error"] if "response" in given & true else []),
        *(["linear_percent_error"] if "continuous" in true and {"continuous", "linear"} & given else []),
    ]
    score = f", score what does not depend on it ({one_of(metrics)})" if metrics else ""
    return f"{score}, or limit the metric to other estimators by 'estimators:' under it"
