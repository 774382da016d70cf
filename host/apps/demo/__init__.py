"""The demo: one pass through the loop, from a nominal plan to a plan corrected by the flights in between."""
