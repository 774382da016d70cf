"""Plans: from a route to a checked reference. `plan` makes one, `write_plan` keeps it."""
