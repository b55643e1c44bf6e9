"""What the verbs do; :mod:`hident.cli` only reads their arguments."""
