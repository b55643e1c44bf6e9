"""Settings of any estimator, chosen by the data."""
