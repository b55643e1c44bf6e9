"""True systems: static nonlinearities, linear blocks and their compositions."""
