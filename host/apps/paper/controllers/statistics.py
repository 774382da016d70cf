"""Statistics of the study: medians over courses, bootstraps, signed ranks, and Holm's correction.

A course is the unit: the ratios of one course become one value, their median, so that flights of the same
course do not count as independent. A plan or a flight that failed counts as an error of FAILED_M, which is
more than any flown error; where both sides of a ratio failed, the ratio is 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import wilcoxon

from trimtab.host.apps.paper.chance import median_interval

FAILED_M = 11.0
"""Error that counts for a failed plan or flight: more than the diagonal of the room."""
LEAST_COURSES = 5
"""Courses, or cells, from which on there is an interval: bootstraps of fewer are too narrow."""


@dataclass(frozen=True, kw_only=True)
class Effect:
    """A ratio of errors: median over courses, 95 % of bootstraps over courses, and its test.

    p: two-sided Wilcoxon signed-rank test of the logarithms against 0. better: courses with a ratio below 1.
    All but the counts are None without values, and the interval with fewer than LEAST_COURSES.
    """

    median: float | None
    ci95: tuple[float, float] | None
    p: float | None
    courses: int
    better: int

    @property
    def confirmed(self) -> bool:
        """Whether the whole interval is below 1."""
        return self.ci95 is not None and self.ci95[1] < 1.0

    @property
    def upper(self) -> float:
        """Upper end of the interval; the median without one, and 0 without values."""
        return self.ci95[1] if self.ci95 is not None else self.median or 0.0

    def to_json(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {
            "median": self.median,
            "ci95": None if self.ci95 is None else list(self.ci95),
            "p": self.p,
            "courses": self.courses,
            "better": self.better,
        }


def error_m(row: Mapping[str, Any]) -> float:
    """Return the mean tracking error of a flight, or what counts for it."""
    return FAILED_M if row["failed"] is not None else row["error_mean_m"]


def interval(values: Sequence[float]) -> tuple[float, float] | None:
    """Return 95 % of the bootstraps of the median; None for fewer values than LEAST_COURSES."""
    return None if len(values) < LEAST_COURSES else median_interval(values)


def effect(ratios_by_course: Mapping[Any, Sequence[float]]) -> Effect:
    """Return the effect of the ratios of each course."""
    logs = np.array([np.median(np.log(ratios)) for ratios in ratios_by_course.values() if len(ratios)])
    if not len(logs):
        return Effect(median=None, ci95=None, p=None, courses=0, better=0)
    ci = interval(logs.tolist())
    return Effect(
        median=float(np.exp(np.median(logs))),
        ci95=None if ci is None else (float(np.exp(ci[0])), float(np.exp(ci[1]))),
        p=_signed_rank(logs),
        courses=len(logs),
        better=int((logs < 0.0).sum()),
    )


def _signed_rank(logs: np.ndarray) -> float:
    """Return the p-value of the two-sided signed-rank test of the values against 0."""
    if not logs.any():
        return 1.0
    tested: Any = wilcoxon(logs)
    return float(tested.pvalue)


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """Return p-values corrected for their number by Holm's method; None stays None."""
    known = sorted((p, k) for k, p in enumerate(p_values) if p is not None)
    corrected: list[float | None] = [None] * len(p_values)
    reached = 0.0
    for rank, (p, k) in enumerate(known):
        reached = max(reached, min(1.0, (len(known) - rank) * p))
        corrected[k] = reached
    return corrected
