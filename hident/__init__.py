"""hident: Monte Carlo experiments on the identification of block-oriented nonlinear systems."""

__version__ = "0.1.0"
