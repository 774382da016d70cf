"""The verbs of the command line, one module for each. `trimtab.host.cli` lists and imports them."""
