"""Excitations, noise, and the random streams that they draw from."""
