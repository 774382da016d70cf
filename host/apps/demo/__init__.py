"""The demo: one complete cycle, from a nominal plan over flights and tracing to a corrected plan."""
