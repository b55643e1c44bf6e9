"""The delay of a record, by the first lag at which its input acts."""

from __future__ import annotations

import numpy as np

from hident.estimators.prediction_error.criterion import Data
from hident.estimators.prediction_error.linear_start import demeaned

_SAMPLES, _LAGS, _MEMORY = 20000, 25, 10
# A coefficient this many standard errors from zero is there.
_SIGNIFICANT = 4.0


def delay(data: Data) -> int:
    """The first lag of the input that is significant in a long ARX model; 0 if none is."""
    data = demeaned(data.busiest(_SAMPLES))
    lags, memory = min(_LAGS, data.count // 20), min(_MEMORY, data.count // 40)
    if not lags:
        return 0
    rows = np.empty((lags + memory + 1, len(data.u)))
    for j in range(lags):
        data.delayed(data.u, j, rows[j])
    for j in range(memory):
        data.delayed(data.y, j + 1, rows[lags + j])
    rows[-1] = 1.0
    rows, y = rows[:, data.counted], data.y[data.counted]
    inverse = np.linalg.pinv(rows @ rows.T, rcond=1e-12, hermitian=True)
    numbers = inverse @ (rows @ y)
    left = y - numbers @ rows
    variance = float(left @ left) / max(data.count - len(rows), 1)
    errors = np.sqrt(np.maximum(variance * np.diag(inverse), 0.0))
    acts = np.abs(numbers[:lags]) > _SIGNIFICANT * errors[:lags]
    return int(np.argmax(acts)) if np.any(acts) else 0
