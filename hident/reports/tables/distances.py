"""Tables of the distance between settings and the printed numbers: which reading of a paper comes closest."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from hident.config.references import AxisName, CaseLabels
from hident.config.spec import Count, component
from hident.engine.experiment import Plan, PublishedCells
from hident.engine.results import Results
from hident.ledger.published import beside_series, cells_astray
from hident.ledger.verdicts import Verdict
from hident.reports.base import Misfit, Table, TableSpec

if TYPE_CHECKING:
    import pandas as pd

_NOTE = "Distance: mean over the rows of |log(ours / printed)|; 0.1 is about 10 %."


class SettingsSpec(TableSpec):
    """Base of the tables that hold settings of open choices against the printed numbers."""

    at_is_own = True

    cells: tuple[PublishedCells, ...]
    """The correspondence of cells; several may name the same printed quantity."""
    at: CaseLabels = {}
    """Labels of axes that limit the settings; all by default."""

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        if plan.paper is None:
            yield ("cells",), "needs 'paper', the folder under experiments/ with the numbers"
        for i, message in cells_astray(plan, self.cells):
            yield ("cells", i), message


class _Distances(SettingsSpec):
    rows: AxisName
    """The axis over which the printed numbers are averaged."""
    best: Annotated[Count, Field(ge=1)] = 3
    """How many of the nearest settings are shown; the CSV holds all."""

    def axes(self, results: Results) -> list[str]:
        return [axis.name for axis in results.plan.axes if axis.name != self.rows]

    def distances(self, results: Results) -> dict[tuple[str, ...], float]:
        """The distance by metric, statistic, quantity and labels; '' for an axis that does not matter."""
        ratios: dict[tuple[str, ...], list[float]] = {}
        for cell, series, printed in beside_series(results, self.cells):
            if not series.unit.is_at(self.at):
                continue
            setting = tuple(str(series.unit.labels.get(axis, "")) for axis in self.axes(results))
            with np.errstate(divide="ignore", invalid="ignore"):
                ratio = abs(np.log(np.divide(series.value(cell.statistic), printed.value)))
            group = (series.metric, cell.statistic, printed.quantity, *setting)
            ratios.setdefault(group, []).append(float(ratio))
        return {group: float(np.mean(values)) for group, values in ratios.items()}

    def table(self, data: pd.DataFrame, shown: pd.DataFrame, heads: int) -> Table:
        rows = tuple(
            tuple(value if isinstance(value, str) else f"{value:.3f}" for value in row)
            for row in shown.itertuples(index=False)
        )
        statistics = " and ".join(dict.fromkeys(cell.statistic for cell in self.cells))
        statistic = f"distances of the {statistics}"
        return Table(self.title, tuple(shown.columns), rows, (_NOTE,), data, statistic, heads)


@component("table", "distance")
class Distance(_Distances):
    """Distance of every setting to the printed numbers, for each printed quantity by itself."""

    def build(self, results: Results, verdicts: Sequence[Verdict]) -> Table:
        import pandas as pd

        names = ["metric", "statistic", "quantity", *self.axes(results), "distance"]
        rows = [(*group, distance) for group, distance in self.distances(results).items()]
        data = pd.DataFrame(rows, columns=names)
        data = data[["quantity", *(name for name in names if name != "quantity")]]
        data = data.sort_values(["quantity", "distance"], ignore_index=True, kind="stable")
        nearest = data.groupby(["quantity", "metric"], sort=False).head(self.best)
        return self.table(data, nearest, len(names) - 1)


@component("table", "joint_distance")
class JointDistance(_Distances):
    """Distance of settings that hold for all quantities at once: one reading of the whole table."""

    def build(self, results: Results, verdicts: Sequence[Verdict]) -> Table:
        import pandas as pd

        distances = self.distances(results)
        quantities = list(dict.fromkeys(group[2] for group in distances))
        scores = list(dict.fromkeys(group[:2] for group in distances))
        axes = self.axes(results)
        labels = [[str(label) for label in results.labels(axis)] for axis in axes]
        # For each quantity, the places of the axes that matter to it.
        matter = {
            quantity: [any(g[3 + i] for g in distances if g[2] == quantity) for i in range(len(axes))]
            for quantity in quantities
        }
        rows = []
        for score, setting in itertools.product(scores, itertools.product(*labels)):
            found = [
                distances.get((*score, q, *(v * m for v, m in zip(setting, matter[q], strict=True))))
                for q in quantities
            ]
            if None not in found:
                rows.append((*score, *setting, *found, float(np.mean(np.array(found, dtype=float)))))
        names = ["metric", "statistic", *axes, *quantities, "mean"]
        data = pd.DataFrame(rows, columns=names).sort_values("mean", ignore_index=True, kind="stable")
        return self.table(data, data.head(self.best), 2 + len(axes))
