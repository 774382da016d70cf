"""Tuning of the controller files: a coordinate search over flights on named courses in named worlds."""
