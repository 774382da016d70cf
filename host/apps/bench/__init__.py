"""What this machine does in how long: learning beside named peers, and whole simulated sessions."""
