"""Estimators, one file for each method: a plain function on arrays, then its spec."""
