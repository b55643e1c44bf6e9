"""Names for the arrays that all rooms speak of."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Flags = NDArray[np.bool_]
Index = NDArray[np.intp]

Characteristic = Callable[[Array], Array]
"""A static function of an array, elementwise."""
