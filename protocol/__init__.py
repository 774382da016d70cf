"""Formats of the link and of files: dialect, framing, transfers, blobs, parameters, log schemas."""
