"""Scoring of sealed worlds. Only this package opens a truth, and only after the verdict is written."""
