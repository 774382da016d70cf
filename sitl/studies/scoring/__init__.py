"""Scoring of sealed worlds: the one place that opens a truth, and only beside a verdict."""
