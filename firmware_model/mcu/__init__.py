"""Flight processor, radio processor and the serial lines between them."""
