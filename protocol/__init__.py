"""What crosses the link or lands in a file: dialect, framing, transfers, blobs, parameters, log schemas."""
