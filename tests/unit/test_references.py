"""Fields whose types say what their names refer to: all are found, and checked in one place."""

from typing import Annotated

import pytest

from hident.config.references import (
    AxisName,
    CaseLabels,
    EstimatorName,
    MetricLabel,
    Template,
    ValueName,
    referring,
    value_of,
)
from hident.config.spec import NonEmpty, Spec
from hident.errors import ConfigError
from tests.unit.results_maker import made


class Inner(Spec):
    name: EstimatorName | None = None
    at: CaseLabels = {}


class Outer(Spec):
    x: AxisName = "n"
    metric: str = "m"
    bound: str = "b"
    of: NonEmpty[Annotated[ValueName, value_of("bound", "se_")]] = ("a",)
    nested: tuple[NonEmpty[EstimatorName], ...] = ()
    columns: dict[str, Inner | MetricLabel] = {}
    pair: tuple[Inner, AxisName] | None = None
    text: Annotated[dict[str, str], Template()] = {}


def names(**fields):
    return [one for value in referring(Outer(**fields), ("t",)) for one in value.names()][1:]


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({}, [(("t", "of", 0), "metric", "m a"), (("t", "of", 0), "metric", "b se_a")]),
        ({"nested": [["k"], ["l", "m"]]}, [(("t", "nested", 1, 1), "estimator", "m")]),
        ({"columns": {"c": "m a"}}, [(("t", "columns", "c"), "metric", "m a")]),
        ({"columns": {"c": {"name": "k"}}}, [(("t", "columns", "c", "name"), "estimator", "k")]),
        (
            {"pair": [{"at": {"n": 5}}, "x"]},
            [
                (("t", "pair", 0, "at", "n"), "axis", "n"),
                (("t", "pair", 0, "at", "n"), "label of n", "5"),
                (("t", "pair", 1), "axis", "x"),
            ],
        ),
        ({"text": {"a {n}": "b", "{m}": "c"}}, [(("t", "text"), "axis", "n"), (("t", "text"), "axis", "m")]),
    ],
)
def test_every_name_is_found_with_its_place(fields, expected):
    assert names(**fields)[-len(expected) :] == expected


PARAMETERS = """\
  a: {kind: value, of: [c], estimators: [linear]}
tables:
  t: {kind: parameters, title: T, metric: a, of: [c], mean_only: [d], estimators: [linear]}
"""


def test_a_value_that_a_metric_does_not_give_is_named_where_it_stands(tmp_path):
    linear = "  linear: {kind: least_squares, order: 1}\n"
    with pytest.raises(ConfigError) as caught:
        made(tmp_path, {}, rest=PARAMETERS, estimators=linear)
    assert str(caught.value).endswith(
        "tables.t.mean_only[0]: there is no metric 'a d'; did you mean 'a c'? (there are: mise, a c)"
    )
