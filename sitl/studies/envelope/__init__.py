"""The envelope: whether fence, ceiling and floor hold for every kind of setpoint."""
