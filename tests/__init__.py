"""The tests; those in a process of their own are started as modules of this package."""

# It decides which kernels numpy and BLAS use, so it comes before them.
import hident  # noqa: F401
