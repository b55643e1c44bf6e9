"""What a selection tried in one trial: all candidates, what each is worth, and which was taken."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from hident.config.references import CaseLabels, EstimatorName
from hident.config.spec import Count, component
from hident.engine.experiment import Plan, Unit
from hident.engine.replay import OneTrial
from hident.engine.results import Results
from hident.estimators.selection.select import Criterion, Select, Selection
from hident.ledger.verdicts import Verdict
from hident.reports.base import Misfit, Table, TableSpec, said_of_trial
from hident.reports.tables.writing import written

_HEADINGS: dict[Criterion, str] = {
    "cross_validation": "RMSE, cross-validation",
    "holdout": "RMSE, held out",
    "validation": "RMSE, validation",
    "leave_one_out": "RMSE, leave-one-out",
    "fpe": "FPE",
}
_INFORMATION = "AIC and BIC count the errors on the whole record as independent; lower is better."
_NEAR = "within one standard error"


@component("table", "candidates")
class Candidates(TableSpec):
    """All candidates of a selection in one trial, the best first.

    Each has its settings, how many parameters it has, the criterion, and AIC and BIC as far as there are any.
    Those whose mean squared error is within one standard error of the least are marked: the data do not tell
    them apart.
    """

    at_is_own = True

    estimator: EstimatorName
    """Name of the estimator, which is of kind select."""
    at: CaseLabels = {}
    """Labels of axes that choose the case; the first case by default."""
    trial: Annotated[Count, Field(ge=0)] = 0
    """Number of the trial."""
    digits: Annotated[Count, Field(ge=1, le=15)] = 4
    """Significant digits of the errors."""

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        if not isinstance(self._unit(plan).estimator, Select):
            yield (
                ("estimator",),
                f"the estimator '{self.estimator}' selects nothing: it is not of kind select",
            )

    def _unit(self, plan: Plan) -> Unit:
        return next(unit for unit in plan.units if unit.name == self.estimator and unit.is_at(self.at))

    def build(self, results: Results, verdicts: Sequence[Verdict]) -> Table:
        realised = OneTrial(results.plan, self.trial).of_unit(self._unit(results.plan))
        if realised.found is None:
            return Table(self.title, ("failed",), ((realised.failure,),), tuple(self._said(results.plan)))
        selection: Selection = realised.detail("selection")
        header = (*selection.over, "parameters", *_columns(selection), "")
        rows = list(self._rows(selection))
        failed = "; ".join(
            f"{', '.join(_settings(selection, i))}: {why}" for i, why in selection.failures.items()
        )
        notes = (
            *self._said(results.plan),
            *((_INFORMATION,) if {"AIC", "BIC"} & {*header} else ()),
            *((f"Failed: {failed}.",) if failed else ()),
        )
        return Table(self.title, header, tuple(rows), notes, heads=len(selection.over))

    def _said(self, plan: Plan) -> Iterator[str]:
        if said := "; ".join(said_of_trial(plan, self, self.trial)):
            yield f"{said[0].upper()}{said[1:]}."

    def _rows(self, selection: Selection) -> Iterator[tuple[str, ...]]:
        criterion = selection.criterion
        for i in np.argsort(criterion, kind="stable").tolist():
            if not np.isfinite(criterion[i]):
                continue
            count = selection.parameters[i]
            cells = {"AIC": selection.aic[i], "BIC": selection.bic[i]}
            if (heading := _HEADINGS.get(selection.by)) is not None:
                is_error = selection.by != "fpe"
                cells[heading] = float(np.sqrt(criterion[i])) if is_error else float(criterion[i])
            near = selection.near is not None and selection.near[i]
            numbers = (
                f"{cells[name]:.1f}" if name in ("AIC", "BIC") else written(cells[name], self.digits)
                for name in _columns(selection)
            )
            yield (
                *_settings(selection, i),
                "-" if count is None else str(count),
                *numbers,
                "chosen" if i == selection.chosen else _NEAR if near else "",
            )


def _columns(selection: Selection) -> list[str]:
    """What is shown of each candidate."""
    own = _HEADINGS.get(selection.by)
    return [
        *([own] if own else []),
        *(name for name, of in (("AIC", selection.aic), ("BIC", selection.bic)) if np.any(np.isfinite(of))),
    ]


def _settings(selection: Selection, i: int) -> list[str]:
    """The values of candidate i in words."""
    places = list(itertools.product(*(range(len(values)) for values in selection.over.values())))[i]
    return [selection.word(path, place) for path, place in zip(selection.over, places, strict=True)]
