"""Continuous-time Hammerstein and Wiener models by integral transforms over moving horizons."""
