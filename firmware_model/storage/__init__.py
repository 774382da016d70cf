"""Non-volatile memory: flash, banks of blobs, stored settings."""
