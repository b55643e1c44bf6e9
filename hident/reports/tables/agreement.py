"""The table of settings against printed numbers: which of them each setting allows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from hident.config.spec import component
from hident.engine.results import Results
from hident.ledger.published import Printed, printed_beside, published_of
from hident.ledger.verdicts import Verdict
from hident.reports.base import Table
from hident.reports.tables.distances import SettingsSpec
from hident.reports.tables.writing import written

if TYPE_CHECKING:
    import pandas as pd

_NOTE = (
    "Median over the trials, and `~` if the printed number at the head of the column lies in the central "
    "95 % of single trials (widened by its rounding), `!` if not."
)


@component("table", "agreement", source="Brouri, eq. (45), (46)")
class Agreement(SettingsSpec):
    """One row for each setting: whether the trials allow each printed number, and how many they allow."""

    def build(self, results: Results, verdicts: Sequence[Verdict]) -> Table:
        import pandas as pd

        data = pd.DataFrame(self._judged(results))
        axes = [a.name for a in results.plan.axes if a.name in data and data[a.name].nunique() > 1]
        # An axis that does not touch an estimator.
        data[axes] = data[axes].fillna("-")
        settings = data.drop_duplicates(["estimator", *axes])[["estimator", *axes]]
        columns = data[["quantity", "printed"]].drop_duplicates()
        rows = []
        for setting in settings.itertuples(index=False):
            one = data[(data[["estimator", *axes]] == list(setting)).all(axis=1)].set_index("quantity")
            signs = [_shown(one, quantity) for quantity in columns["quantity"]]
            rows.append((*map(str, setting), *signs, f"{one['inside'].sum()} of {len(one)}"))
        printed = [f"{quantity}: {number}" for quantity, number in columns.itertuples(index=False)]
        header = ("estimator", *axes, *printed, "inside")
        return Table(self.title, header, tuple(rows), (_NOTE,), data)

    def _judged(self, results: Results) -> Iterator[dict[str, object]]:
        numbers = published_of(results.plan)
        every = ((cell, *pair) for cell in self.cells for pair in cell.pairs())
        for cell, quantity, metric in every:
            for series in results.select(cell.estimator, metric, cell.at):
                if not series.unit.is_at(self.at) or not len(series.valid):
                    continue
                labels = series.unit.labels
                printed = printed_beside(cell, quantity, labels, numbers)
                low, high = np.quantile(series.valid, [0.025, 0.975])
                yield {
                    "estimator": cell.estimator,
                    **{axis: str(label) for axis, label in labels.items()},
                    "quantity": printed.quantity,
                    "printed": printed.printed,
                    "median": series.value("median"),
                    "low": low,
                    "high": high,
                    "inside": _holds(printed, float(low), float(high)),
                }


def _holds(printed: Printed, low: float, high: float) -> bool:
    slack = printed.half_unit * (1 + 1e-9)
    return low - slack <= printed.value <= high + slack


def _shown(one: pd.DataFrame, quantity: str) -> str:
    if quantity not in one.index:
        return "-"
    sign = "~" if one["inside"].loc[quantity] else "!"
    return f"{written(float(one['median'].loc[quantity]), 4)} {sign}"
