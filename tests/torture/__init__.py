"""What tries to break hident's promises: see docs/robustness.md."""
