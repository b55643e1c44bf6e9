"""Wiener-Hammerstein systems in the frequency domain, by staircases, sines and multisines."""
