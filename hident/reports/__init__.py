"""Tables and figures of finished trials."""
