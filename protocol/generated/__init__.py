"""Made by `python -m protocol.generate`; not edited by hand."""
