"""Made by `python -m trimtab.protocol.generate`; not edited by hand."""
