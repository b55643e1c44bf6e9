"""What a user may write: strict YAML, typed fields, formulas, and the register of components."""
