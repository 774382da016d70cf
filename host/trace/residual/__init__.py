"""The residual of a model: whether it repeats between flights, its spectral line, and what it depends on."""
