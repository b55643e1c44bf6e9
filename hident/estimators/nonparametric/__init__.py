"""Nonparametric estimates of a Hammerstein nonlinearity, and what undoes the linear block before them."""
