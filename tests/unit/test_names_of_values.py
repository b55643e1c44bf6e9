"""The names of an estimate's values: said once, for what an estimator provides and for what it gives."""

from typing import Annotated

import numpy as np
import pytest
from pydantic import Field

from hident.config.spec import Count
from hident.estimators.base import EstimatorSpec, with_errors


class Lags(EstimatorSpec):
    """A numerator, and how long it took."""

    kind = "lags"
    holds = ("linear",)

    lags: Annotated[Count, Field(ge=1)]
    """Number of coefficients."""

    def names(self):
        return [*(f"b_{k}" for k in range(self.lags)), "iterations", "converged"]


def test_the_parts_follow_from_what_it_holds_and_names():
    assert Lags(lags=1).provides() == {"linear", "value b_0", "value iterations", "value converged"}


def test_arrays_and_numbers_take_the_names_in_their_order():
    found = Lags(lags=2).named(np.array([0.5, -1.0]), 7, True)
    assert found == {"b_0": 0.5, "b_1": -1.0, "iterations": 7.0, "converged": 1.0}
    assert {type(value) for value in found.values()} == {float}


@pytest.mark.parametrize("lags", [1, 3])
def test_more_or_fewer_values_than_names_are_an_error(lags):
    with pytest.raises(ValueError, match=f"^lags names {lags + 2} values, and its estimate has 4$"):
        Lags(lags=lags).named(np.array([0.5, -1.0]), 7, True)


def test_the_names_of_errors_stand_after_those_of_all_values():
    assert with_errors(["a_1", "b_0"]) == ["a_1", "b_0", "se_a_1", "se_b_0"]
