"""What becomes of an iteration that ends without converging."""

import pytest

from hident.errors import EstimationError
from hident.estimators.convergence import settle


def test_it_fails_with_the_number_of_iterations():
    with pytest.raises(EstimationError, match=r"^the iteration has not converged in 60 iterations: allow"):
        settle(False, 60, "fail")
    with pytest.raises(EstimationError, match=r"^the iteration has not converged in 1 iteration: allow"):
        settle(False, 1, "fail")


def test_it_passes_where_it_has_converged_or_is_kept():
    settle(True, 60, "fail")
    settle(False, 60, "keep")
