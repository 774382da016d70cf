"""Times on the vehicle's clock: integer microseconds since power-up."""

NEVER_US = 1 << 62
"""A time that no clock reaches."""
