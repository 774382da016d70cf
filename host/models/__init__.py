"""Models of a flight: rigid body with effects, closed loop with the law, network, and their file."""
