"""Sets of effects fitted to command-driven segments from free initial states."""
