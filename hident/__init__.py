"""hident: Monte Carlo experiments on the identification of block-oriented nonlinear systems."""

from hident import arithmetic as _arithmetic  # noqa: F401  (it must come before numpy)

__version__ = "0.1.0"
