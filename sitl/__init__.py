"""The simulator: an independent plant, sensors, radio channel and clock around the firmware model."""
