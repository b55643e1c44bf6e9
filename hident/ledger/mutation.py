"""The alternatives of a configuration run, and what its printed numbers make of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence

from hident.engine.experiment import Plan, Published
from hident.engine.results import Results
from hident.ledger.joint import combined_p
from hident.ledger.power import FEWEST, Mutation, NumberPower, VerdictPower
from hident.ledger.published import Key
from hident.ledger.verdicts import LEVEL, Verdict, group_p, grouped, is_same_data, stand


def trials_of(plan: Plan, trials: int | None = None) -> int:
    """How many trials each alternative has: of equal data all, else as many as wanted and there are."""
    published = plan.experiment.published
    if published is not None and is_same_data(published, plan.trials):
        return plan.trials
    return min(trials or FEWEST, plan.trials)


def measured(
    plan: Plan, alternatives: Mapping[str, Plan], run: Callable[[str, Plan], Results]
) -> VerdictPower:
    """The power of a plan's printed numbers; ``run`` is given the name and the plan of each alternative."""
    published = plan.experiment.published
    assert published is not None
    digits = is_same_data(published, plan.trials)
    numbers: dict[Key, tuple[str, dict[str, bool]]] = {}
    mutations: list[Mutation] = []
    # Of equal data digits decide, and some of ours may differ themselves.
    own = _differing(stand(run("itself", plan))) if digits else frozenset()
    for name, alternative in alternatives.items():
        verdicts = stand(run(name, alternative))
        tables: dict[str, list[Verdict]] = {}
        for verdict in verdicts:
            _, excluded = numbers.setdefault(verdict.printed.key, (verdict.printed.printed, {}))
            excluded[name] = excluded.get(name, False) or verdict.word == "differs"
            if verdict.counts:
                tables.setdefault(verdict.printed.table, []).append(verdict)
        mutations += [_mutation(table, name, found, published, own) for table, found in tables.items()]
    order = list(alternatives)
    return VerdictPower(
        {key: NumberPower(*numbers[key]) for key in sorted(numbers)},
        tuple(sorted(mutations, key=lambda one: (one.table, order.index(one.alternative)))),
    )


def _differing(verdicts: Iterable[Verdict]) -> frozenset[Key]:
    return frozenset(verdict.printed.key for verdict in verdicts if verdict.word == "differs")


def _mutation(
    table: str, name: str, verdicts: Sequence[Verdict], published: Published, own: frozenset[Key]
) -> Mutation:
    differing = _differing(verdicts)
    trials = len(verdicts[0].series.values)
    p = combined_p(group_p(group, trials, published) for group in grouped(verdicts))
    # Without one there are digits, bounds, or estimates that all fail.
    rejected = bool(differing - own) if math.isnan(p) else p < LEVEL
    rejected = rejected or any(not len(verdict.series.valid) for verdict in verdicts)
    return Mutation(table, name, len(verdicts), len(differing), p, rejected)
