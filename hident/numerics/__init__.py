"""What several families of methods share: numerical decisions and small algorithms on arrays."""
