"""The iterative two-stage method for Wiener systems."""
