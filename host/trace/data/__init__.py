"""From logs to segments: checks that logs belong together, audits, and signals on one clock."""
