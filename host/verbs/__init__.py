"""The verbs of the command line, one module each; listed in `host.cli`, imported only when run."""
