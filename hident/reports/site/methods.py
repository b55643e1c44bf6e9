"""What papers call the methods that come with hident."""

from __future__ import annotations

_NAMES = {
    "best_linear_approximation": "best linear approximation (Pintelon, Schoukens)",
    "bilinear_least_squares": "weighted nonlinear least squares (Wang, Zhang, Ljung)",
    "chain_cramer_rao": "Cramér-Rao bound of a chain",
    "cramer_rao": "Cramér-Rao bound",
    "frequency_gain_identification": "frequency gains identification, FGI (Brouri)",
    "instrumental_variables": "instrumental variables (Mzyk)",
    "iterative_hammerstein": "iterative method, two-stage estimation, Hammerstein (Chen, Hwang, Chang)",
    "iterative_wiener": "iterative method, two-stage estimation, Wiener (Chen, Hwang, Chang)",
    "kernel": "kernel regression estimate (Mzyk)",
    "known_dynamics": "known linear block",
    "known_nonlinearity": "least squares with the nonlinearity known",
    "least_squares": "least squares",
    "linear_model": "linear model over moving horizons (Hwang, Lin)",
    "nonlinearity_identification": "nonlinearity identification, NI (Brouri)",
    "orthogonal": "orthogonal series estimate (Mzyk)",
    "output_error": "output error",
    "prediction_error": "prediction error method (Ljung)",
    "select": "selection by a criterion",
    "separable_least_squares": "separable least squares",
    "two_stage": "two-stage algorithm, TSA (Wang, Zhang, Ljung)",
    "voros_hammerstein": "key-term separation, Hammerstein (Vörös)",
    "voros_wiener": "key-term separation, Wiener (Vörös)",
}


def method(kind: str) -> str:
    """The name of a method in words; of a plugin's, that of its kind.

    Examples
    --------
    >>> method("orthogonal"), method("my_method")
    ('orthogonal series estimate (Mzyk)', 'my method')
    """
    return _NAMES.get(kind) or kind.replace("_", " ")
