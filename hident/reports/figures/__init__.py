"""Kinds of figures over all trials."""
