"""The transform over moving horizons, and linear blocks fitted by it."""
