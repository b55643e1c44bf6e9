"""What a component needs and what it gives, in words, by what it answers with some settings."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from hident.config.spec import Component
from hident.config.suggest import one_of
from hident.estimators.base import EstimatorSpec
from hident.metrics.base import Comparing, MetricSpec
from hident.systems.base import NonlinearitySpec, SystemSpec

Fact = tuple[str, str]
"""A term, and what is so, in words with code in backticks."""

_PARTS = {
    "nonlinearity": "the nonlinearity",
    "linear": "a discrete linear block",
    "continuous": "a continuous linear block",
    "blocks": "the two linear blocks around a nonlinearity",
    "response": "a response to any input",
    "frequencies": "gains at the frequencies of sines",
    "model": "a model that simulates and predicts records",
    "left_out": "the estimate at each sample without that sample",
    "unfiltered": "the same estimate without the prefilter",
}
_EXPERIMENTS = {
    "one": "of one experiment",
    "at_one_interval": "of one experiment, or of several at one sampling interval",
    "any": "of one experiment, or of several at any sampling intervals",
}
_BEST = {"lowest": "The lowest is best.", "highest": "The highest is best.", "zero": "Best is zero."}
_STRUCTURES = {
    "N-L": "a nonlinearity, then a linear block (Hammerstein)",
    "L-N": "a linear block, then a nonlinearity (Wiener)",
    "L-N-L": "a nonlinearity between two linear blocks (Wiener-Hammerstein)",
}
_MOST = 24


def facts(component: Component) -> list[Fact]:
    """What such a component needs and gives; nothing of families in which there is nothing to tell."""
    match component:
        case EstimatorSpec():
            return [*_of_estimator(component)]
        case SystemSpec():
            return [*_of_system(component)]
        case MetricSpec():
            return [*_of_metric(component)]
        case NonlinearitySpec():
            return [*_of_nonlinearity(component)]
    return []


def _of_estimator(estimator: EstimatorSpec) -> Iterator[Fact]:
    record = f"A record {_EXPERIMENTS[estimator.takes_experiments()]}"
    least = estimator.fewest_samples()
    yield "Needs", record + (f", of at least {least} samples." if least > 1 else ".")
    if needs := estimator.needs_of_truth():
        yield "Needs of the truth", _parts(needs)
    provides = estimator.provides()
    if parts := {part for part in provides if not part.startswith("value ")}:
        yield "Gives", _parts(parts)
    if names := estimator.names():
        yield "Values", _names(names)
    match estimator.normalisations():
        case None:
            yield "Factor between the blocks", "It does not say how it fixes it."
        case ():
            pass
        case rules:
            said = one_of(dict.fromkeys(rule.rule for rule in rules))
            left = sorted({freedom for rule in rules for freedom in rule.left})
            yield (
                "Factor between the blocks",
                f"Fixed by: {said}." + (f" Left open: {one_of(left)}." if left else ""),
            )
    yield (
        "Random numbers",
        "It draws some of its own." if estimator.draws() else "None: the record decides all.",
    )


def _of_system(system: SystemSpec) -> Iterator[Fact]:
    truth = system.truth()
    if truth.structure:
        yield "Blocks", _sentence(_STRUCTURES[truth.structure])
    provides = truth.provides()
    yield "Its truth holds", _parts(part for part in provides if not part.startswith("value "))
    if values := sorted(part.removeprefix("value ") for part in provides if part.startswith("value ")):
        yield "True values", _names(values)


def _of_metric(metric: MetricSpec) -> Iterator[Fact]:
    for what, needs in (("estimate", metric.needs_of_estimate()), ("truth", metric.needs_of_truth())):
        if needs:
            yield f"Needs of the {what}", _parts(needs)
    yield "Gives", _names(metric.labels("NAME")) + ", where NAME is its name in the configuration."
    if metric.best:
        yield "As a score", _BEST[metric.best]
    if isinstance(metric, Comparing):
        choices = one_of(f"`{choice}`" for choice in metric.choices)
        yield (
            "Can compare up to",
            f"{choices}, {metric.how}." if choices else "Nothing: values as they are.",
        )


def _of_nonlinearity(nonlinearity: NonlinearitySpec) -> Iterator[Fact]:
    static = nonlinearity.characteristic() is not None
    yield (
        "Memory",
        "None: a function of the input, which serves as an instrument, a basis or a known function too."
        if static
        else "Its output depends on earlier inputs too, so it serves in systems only.",
    )


def _parts(parts: Iterable[str]) -> str:
    def said(part: str) -> str:
        if " or " in part:
            return " or ".join(map(said, part.split(" or ")))
        value = part.removeprefix("value ")
        return f"the value `{value}`" if value != part else _PARTS.get(part, f"`{part}`")

    return _sentence(one_of(sorted(map(said, parts))))


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."


def _names(names: Iterable[str]) -> str:
    every = [f"`{name}`" for name in names]
    more = len(every) - _MOST
    return one_of(every) if more <= 1 else f"{one_of(every[:_MOST])} and {more} more"
