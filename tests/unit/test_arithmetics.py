"""The table of arithmetics: which configurations a check takes, and what is written into the document."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import pytest

from hident import plugins
from hident.config.spec import Spec
from hident.engine.experiment import load
from hident.errors import RecordAbsent
from hident.estimators.base import EstimatorSpec
from tests.arithmetics import (
    BEGIN,
    CHECKED,
    DOCUMENT,
    END,
    LAST_BITS,
    ROOT,
    Outcome,
    inserted,
    last_bits,
    main,
    markdown,
)


def _kinds_in(value: Any) -> Iterator[str]:
    """The kinds of the estimators in a specification, those of prefilters and starts too."""
    if isinstance(value, EstimatorSpec):
        yield value.kind
    if isinstance(value, Spec):
        value = dict(value)
    if isinstance(value, Mapping):
        value = [*value.values()]
    if isinstance(value, list | tuple):
        for inner in value:
            yield from _kinds_in(inner)


def _kinds_of(config: str) -> set[str]:
    try:
        plan = load(ROOT / "configs" / f"{config}.yaml")
    except RecordAbsent:
        return set()
    return {kind for unit in plan.units for kind in _kinds_in(unit.estimator)}


def test_the_checked_configurations_hold_every_kind_of_estimator_that_any_holds() -> None:
    plugins.load()
    every = [path.stem for path in (ROOT / "configs").glob("*.yaml")]
    checked = set().union(*map(_kinds_of, CHECKED))
    assert set().union(*map(_kinds_of, every)) == checked
    assert {"instrumental_variables", "least_squares"} <= checked  # prefilters


def test_the_table_names_what_moved_what_cannot_be_had_and_what_is_too_much() -> None:
    table = {
        "one": {"nehalem": Outcome(0, 60), "haswell": Outcome(2, 60)},
        "other": {"nehalem": Outcome(7, 120, ("too many",)), "haswell": Outcome(0, 120)},
    }
    assert markdown(table, ["nehalem", "skylakex", "haswell"]).splitlines() == [
        "| configuration | estimates | Nehalem | SkylakeX | Haswell |",
        "| --- | ---: | ---: | ---: | ---: |",
        "| `one` | 60 | 0 | - | 2 |",
        "| `other` | 120 | **7** | - | 0 |",
    ]


def test_the_table_takes_the_place_between_its_marks() -> None:
    text = f"Above\n{BEGIN}\nold\n{END}\nbelow\n"
    assert inserted(text, "new") == f"Above\n{BEGIN}\n\nnew\n\n{END}\nbelow\n"
    assert inserted(inserted(text, "other"), "new") == inserted(text, "new")
    with pytest.raises(ValueError, match="arithmetics: begin"):
        inserted(f"Above\n{END}\nbelow\n", "new")


def test_the_document_has_the_marks() -> None:
    document = DOCUMENT.read_text(encoding="utf-8")
    assert "new" in inserted(document, "new")


def test_the_document_says_what_the_accepted_results_say_of_last_bits() -> None:
    document = DOCUMENT.read_text(encoding="utf-8")
    # If not: python -m tests.arithmetics --last-bits
    assert inserted(document, last_bits(ROOT / "results"), LAST_BITS) == document


def test_a_name_that_no_configuration_has_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--check", "chen_tabel1"])
    assert ended.value.code == 2
    assert "no configuration is named chen_tabel1" in capsys.readouterr().err
