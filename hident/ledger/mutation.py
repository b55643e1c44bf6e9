"""The alternatives of a configuration run, and what its printed numbers make of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from hident.engine.experiment import Plan, Published
from hident.engine.results import Results
from hident.ledger.joint import combined_p
from hident.ledger.power import FEWEST, Mutation, NumberPower, VerdictPower
from hident.ledger.published import Place
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
    numbers: dict[Place, tuple[str, dict[str, bool]]] = {}
    mutations: list[Mutation] = []
    # By as many trials as an alternative's, some of ours differ themselves.
    alone = next((one.trials for one in alternatives.values()), plan.trials)
    itself = {one.place: one for one in stand(run("itself", plan.changed(trials=alone)))}
    for name, alternative in alternatives.items():
        verdicts = stand(run(name, alternative))
        tables: dict[str, list[Verdict]] = {}
        for verdict in verdicts:
            place = verdict.place
            _, excluded = numbers.setdefault(place, (verdict.printed.printed, {}))
            excluded[name] = _excludes(verdict, itself[place])
            if verdict.counts:
                tables.setdefault(verdict.printed.table, []).append(verdict)
        mutations += [_mutation(table, name, found, published, itself) for table, found in tables.items()]
    order = list(alternatives)
    return VerdictPower(
        {place: NumberPower(*numbers[place]) for place in sorted(numbers)},
        tuple(sorted(mutations, key=lambda one: (one.table, order.index(one.alternative)))),
    )


def _excludes(verdict: Verdict, ours: Verdict) -> bool:
    """Whether a number differs under an alternative, and does not without it."""
    return verdict.word == "differs" and ours.word != "differs"


def _mutation(
    table: str, name: str, verdicts: Sequence[Verdict], published: Published, itself: Mapping[Place, Verdict]
) -> Mutation:
    excluding = [one for one in verdicts if _excludes(one, itself[one.place])]
    trials = len(verdicts[0].series.values)
    p = combined_p(group_p(group, trials, published) for group in grouped(verdicts))
    # Where nothing is drawn digits decide, and bounds where there is nothing else.
    digits = is_same_data(published, trials)
    bounds = all(one.printed.bound for one in verdicts)
    decided = any(digits or bounds or _is_fixed(one) for one in excluding)
    lost = any(itself[one.place].is_known and not len(one.series.valid) for one in verdicts)
    return Mutation(table, name, len(verdicts), len(excluding), p, p < LEVEL or decided or lost)


def _is_fixed(verdict: Verdict) -> bool:
    """Whether all trials give one number."""
    return verdict.is_known and len(verdict.series.valid) > 1 and not verdict.is_random
