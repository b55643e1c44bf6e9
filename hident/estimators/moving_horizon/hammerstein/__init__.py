"""The iterative two-stage method for Hammerstein systems."""
