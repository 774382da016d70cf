"""The verbs of the command line, one module each; listed in `trimtab.host.cli`, imported only when run."""
