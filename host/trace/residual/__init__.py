"""The residual of a model: whether it repeats between flights or rings, and what it depends on."""
