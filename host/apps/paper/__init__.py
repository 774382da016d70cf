"""Repetition of the paper's experiments: data, tables and figures beside the paper's numbers."""
