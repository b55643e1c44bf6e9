"""The table of settings against printed numbers: which of them each setting allows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from hident.config.spec import component
from hident.engine.results import Results
from hident.ledger.published import beside_series
from hident.ledger.verdicts import Verdict, central
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
        if data.empty:
            return Table(
                self.title, ("estimator", "inside"), (), ("No trial gave a number.",), data, "median", 1
            )
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
        return Table(self.title, header, tuple(rows), (_NOTE,), data, "median", 1 + len(axes))

    def _judged(self, results: Results) -> Iterator[dict[str, object]]:
        for cell, series, printed in beside_series(results, self.cells):
            if not series.unit.is_at(self.at) or not len(series.valid):
                continue
            low, high = central(series.valid, printed.bound)
            yield {
                "estimator": cell.estimator,
                **{axis: str(label) for axis, label in series.unit.labels.items()},
                "quantity": printed.quantity,
                "printed": printed.printed,
                "median": series.value("median"),
                "low": low,
                "high": high,
                "inside": printed.lies_in(low, high),
            }


def _shown(one: pd.DataFrame, quantity: str) -> str:
    if quantity not in one.index:
        return "-"
    sign = "~" if one["inside"].loc[quantity] else "!"
    return f"{written(float(one['median'].loc[quantity]), 4)} {sign}"
