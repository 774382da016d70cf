"""Benchmarks on this machine: learning and planning compared with other tools, and simulated sessions."""
