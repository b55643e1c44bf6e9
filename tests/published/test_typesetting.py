"""Every kind of table, of the accepted results, as LaTeX typesets it."""

from __future__ import annotations

from pathlib import Path

from hident.config.spec import components
from hident.reports import latex
from hident.reports.base import TableSpec
from hident.reports.scoring import scoring
from tests.accepted import accepted_results, accepted_verdicts
from tests.typesetting import typeset

# One of each kind, and those with the strangest letters.
CONFIGURATIONS = (
    "brouri_gains",
    "brouri_reading",
    "chen_table1",
    "chen_fig9",
    "compare_hammerstein",
    "compare_selection",
    "data_chosen",
    "mzyk_rates",
    "mzyk_reading",
    "mzyk_table1",
    "pem_starts",
    "wang_efficiency",
    "wang_table1",
)
PACKAGES = "\\usepackage{booktabs}\n\\usepackage{siunitx}\n\\usepackage{graphicx}"


def test_every_kind_of_table_is_typeset_without_a_warning(tmp_path: Path) -> None:
    kinds: set[str] = set()
    pages = []
    for config in CONFIGURATIONS:
        results, verdicts = accepted_results(config), accepted_verdicts(config)
        for name, spec in results.plan.experiment.tables.items():
            assert isinstance(spec, TableSpec)
            kinds.add(spec.kind)
            table = spec.built(results, verdicts)
            caption = latex.caption(table, results.plan.trials, results.plan.seed)
            pages.append(latex.table(f"{config}-{name}", table, caption, scoring(results.plan)))
    house = {kind for kind, cls in components("table").items() if cls.__module__.startswith("hident.")}
    assert house <= kinds
    assert typeset(PACKAGES, "\\clearpage\n".join(pages), tmp_path) == []
    assert (tmp_path / "paper.pdf").stat().st_size > 0
