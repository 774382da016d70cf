"""The flight that separates two effects best."""
