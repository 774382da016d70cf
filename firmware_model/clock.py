"""Times on the vehicle's clock: integer microseconds since power-up."""

NEVER_US = 1 << 62
"""A time later than any clock time."""
