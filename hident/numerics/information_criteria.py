"""What a model's fit is worth once its parameters are counted; of several models the least is best.

With the mean squared error V on N samples and d free parameters, -2 times the log-likelihood of white
Gaussian errors is N ln V but for a constant. The criteria of models are compared on the same samples only,
and count errors that follow each other as independent: where these are coloured, they let too many parameters
pass.
"""

from __future__ import annotations

import math


def aic(mse: float, samples: int, parameters: int) -> float:
    """Akaike's criterion (1974), N ln V + 2 d.

    Examples
    --------
    >>> aic(1.0, 100, 3)
    6.0
    """
    return samples * math.log(mse) + 2 * parameters


def bic(mse: float, samples: int, parameters: int) -> float:
    """Schwarz's criterion (1978), N ln V + d ln N.

    Examples
    --------
    >>> round(bic(1.0, 100, 3), 2)
    13.82
    """
    return samples * math.log(mse) + parameters * math.log(samples)


def fpe(mse: float, samples: int, parameters: int) -> float:
    """Akaike's final prediction error (1970), V (1 + d/N)/(1 - d/N); nan where d is not below N.

    Examples
    --------
    >>> fpe(2.0, 100, 50)
    6.0
    """
    if parameters >= samples:
        return math.nan
    return mse * (1 + parameters / samples) / (1 - parameters / samples)
