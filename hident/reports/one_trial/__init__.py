"""Kinds of figures of one trial, which is made again from its seeds."""
