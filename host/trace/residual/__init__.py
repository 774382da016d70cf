"""What a model leaves of the flights: whether it repeats or rings, and what it depends on."""
