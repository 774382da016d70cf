"""From logs to segments: checks of what belongs together, health of the data, signals on one clock."""
