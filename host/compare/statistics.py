"""Differences of paired and unpaired figures, and trends over time, with intervals of 95 %."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

LEVEL = 0.95
"""Probability that an interval covers the true value, if figures vary as independent normal numbers."""


@dataclass(frozen=True, kw_only=True)
class Difference:
    """A difference between two sides, in the unit of the figure.

    count: pairs, or figures of both sides together if they are not paired. mean, low, high: mean difference
    and its interval of 95 %; None if a difference is not finite, the interval also if there are too few
    figures. median: median of the differences; None without pairs, or if it is not finite.
    """

    count: int
    mean: float | None
    low: float | None
    high: float | None
    median: float | None

    @property
    def excludes_zero(self) -> bool:
        """Whether there is an interval and 0 lies outside it."""
        return self.low is not None and self.high is not None and not self.low <= 0.0 <= self.high

    def to_dict(self) -> dict[str, float | int | None]:
        """Return the difference as plain data for JSON."""
        return dict(vars(self))


@dataclass(frozen=True, kw_only=True)
class Trend:
    """Slope of a figure over time, per unit of time, with its interval of 95 %."""

    slope: float
    low: float
    high: float


def paired_difference(differences: Sequence[float]) -> Difference:
    """Return the mean of differences with the t interval over the pairs, and their median.

    Infinite differences count: the median survives as long as it is between finite ones.
    """
    values = np.asarray(differences, dtype=float)
    count, finite = len(values), bool(np.isfinite(values).all())
    mean = float(values.mean()) if count and finite else None
    half = None
    if mean is not None and count > 1:
        half = float(stats.t.ppf(0.5 + 0.5 * LEVEL, count - 1) * values.std(ddof=1) / math.sqrt(count))
    return _difference(count, mean, half, median_of(values))


def unpaired_difference(a: Sequence[float], b: Sequence[float]) -> Difference:
    """Return the mean of `b` minus that of `a`, at least one each, with Welch's t interval."""
    first, second = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    half = None
    if min(len(first), len(second)) > 1:
        squares = np.array([x.var(ddof=1) / len(x) for x in (first, second)])
        freedom = np.array([len(first), len(second)]) - 1
        total = float(squares.sum())
        # Welch and Satterthwaite; without any spread, the interval is the mean.
        degrees = total**2 / float((squares**2 / freedom).sum()) if total > 0.0 else float(freedom.sum())
        half = float(stats.t.ppf(0.5 + 0.5 * LEVEL, degrees) * math.sqrt(total))
    return _difference(len(first) + len(second), float(second.mean() - first.mean()), half, None)


def _difference(count: int, mean: float | None, half: float | None, median: float | None) -> Difference:
    low, high = (None, None) if mean is None or half is None else (mean - half, mean + half)
    return Difference(count=count, mean=mean, low=low, high=high, median=median)


def median_of(values: Sequence[float] | np.ndarray) -> float | None:
    """Return the median of values that may be infinite; None without values, or if it is not finite."""
    if not len(values):
        return None
    with np.errstate(invalid="ignore"):
        median = float(np.median(np.asarray(values, dtype=float)))
    return median if math.isfinite(median) else None


def trend(times: Sequence[float], values: Sequence[float]) -> Trend:
    """Return the slope of a straight line through at least three values at times that are not all equal."""
    t, y = np.asarray(times, dtype=float), np.asarray(values, dtype=float)
    t = t - t.mean()
    spread = float(t @ t)
    slope = float(t @ y) / spread
    residual = y - y.mean() - slope * t
    freedom = len(t) - 2
    sd = math.sqrt(float(residual @ residual) / freedom / spread)
    half = float(stats.t.ppf(0.5 + 0.5 * LEVEL, freedom)) * sd
    return Trend(slope=slope, low=slope - half, high=slope + half)
