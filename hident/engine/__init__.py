"""Trials: generating data, running estimators, storing what comes out."""
