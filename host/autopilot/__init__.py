"""Flights of other autopilots: setpoints streamed in PX4's offboard mode or ArduPilot's guided mode."""
