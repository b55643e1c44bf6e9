"""Hammerstein models with known basis functions, bilinear in their parameters."""
