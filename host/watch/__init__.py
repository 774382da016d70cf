"""A flight while it is flown, from its log: figures for the terminal, and a server for Foxglove."""
