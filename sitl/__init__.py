"""The simulated world: an independent plant, sensors, radio channel and clock around the firmware model."""
