"""What no data determine is chosen for the least error, whatever the units."""

from collections.abc import Callable

import numpy as np
import pytest

from hident.arrays import Array
from hident.numerics.freedoms import nearest_argument

FUNCTIONS: dict[str, Callable[[Array], Array]] = {
    "polynomial": lambda x: x + 0.5 * x**2,
    "atan": np.arctan,
    "dead zone": lambda x: x * (np.abs(x) > 0.4),
    "sine": lambda x: np.sin(3.0 * x),
}


@pytest.mark.parametrize("gain", [1e-12, 1e-6, -1e-4, 0.03, 1.0, 800.0, 1e4, -1e6, 1e12])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_factor_of_an_argument_is_found_whatever_its_size(name, gain):
    function, x = FUNCTIONS[name], np.linspace(-2.0, 2.0, 1000) / gain
    true = function(gain * x)
    found = nearest_argument(function, x, true, np.ones(len(x)), ("gain", "sign"))
    assert np.linalg.norm(found - true) <= 1e-6 * np.linalg.norm(true)
