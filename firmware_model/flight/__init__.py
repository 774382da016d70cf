"""The flight itself: estimate, supervisor, failsafes, phases and tracks. Knows no bytes."""
