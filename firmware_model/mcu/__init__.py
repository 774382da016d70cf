"""The two processors and the serial lines between them."""
