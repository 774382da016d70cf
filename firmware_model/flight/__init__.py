"""Flight logic: estimate, supervisor, failsafes, phases and tracks. Independent of the link."""
