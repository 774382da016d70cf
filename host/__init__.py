"""The ground side of Trimtab: models, plans, learning, tracing, the link client and the command line."""
