"""Chains of linear and static blocks, fitted by prediction error."""
