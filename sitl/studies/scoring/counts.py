"""Shares of worlds with exact intervals, and quantiles; None if nothing was counted."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from scipy.stats import binomtest


def exact_interval(hits: int, count: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return the Clopper-Pearson interval of `hits` in `count`. Raises ValueError for an impossible count."""
    if not 0 <= hits <= count or count < 1:
        raise ValueError(f"{hits} hits of {count} are impossible")
    interval = binomtest(hits, count).proportion_ci(confidence, method="exact")
    return float(interval.low), float(interval.high)


def share(flags: Sequence[bool]) -> float | None:
    """Return the share of True."""
    return sum(flags) / len(flags) if flags else None


def interval(flags: Sequence[bool]) -> list[float] | None:
    """Return the exact 95 % interval of the share of True."""
    return list(exact_interval(sum(flags), len(flags))) if flags else None


def mean(values: Sequence[float]) -> float | None:
    """Return the mean."""
    return float(np.mean(values)) if values else None


def quantile(values: Iterable[float], level: float) -> float | None:
    """Return the quantile of this level in 0..1."""
    listed = list(values)
    return float(np.quantile(listed, level)) if listed else None
