"""Attacks on the link: strangers that share a vehicle's port, forged and replayed frames, floods."""
