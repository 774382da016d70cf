"""Seeds of the paper's studies, and intervals of medians."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np

SAMPLES = 10_000
"""Number of bootstraps."""


def number(text: str) -> int:
    """Return the number that a text stands for, 31 bits."""
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") >> 33


def median_interval(values: Sequence[float]) -> tuple[float, float]:
    """Return 95 % of the bootstraps of the median of at least one value."""
    given = np.asarray(values, dtype=float)
    drawn = np.random.default_rng(0).integers(len(given), size=(SAMPLES, len(given)))
    low, high = np.percentile(np.median(given[drawn], axis=1), [2.5, 97.5])
    return float(low), float(high)
