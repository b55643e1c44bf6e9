"""Voros's methods in discrete time, by key-term separation."""
