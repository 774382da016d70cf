"""Coordinate search on a grid: one parameter after the other, each by steps that lower the score."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

Score = Callable[[Sequence[float]], Sequence[float]]
"""Return the score of each factor, infinite for one that is not possible. Less is better."""


@dataclass(frozen=True, kw_only=True)
class Coordinate:
    """Outcome of one parameter: the factor that it keeps, the best factor found, and the gain of that.

    gain: decrease of the score from factor 1.
    """

    factor: float
    best: float
    gain: float


def search_coordinate(score: Score, factors: Sequence[float], least_gain: float) -> Coordinate:
    """Step from factor 1 to better neighbours until none is better.

    The parameter keeps factor 1 if the best factor gains `least_gain` or less. Raises ValueError if 1 is no
    factor or its score is not finite.
    """
    start = list(factors).index(1.0)
    near = [k for k in (start, start - 1, start + 1) if 0 <= k < len(factors)]
    scores = dict(zip(near, score([factors[k] for k in near]), strict=True))
    if not scores[start] < float("inf"):
        raise ValueError("the start of the search has no finite score")
    best = min(near, key=lambda k: scores[k])
    step = best - start
    while step and 0 <= best + step < len(factors):
        (following,) = score([factors[best + step]])
        if following >= scores[best]:
            break
        best += step
        scores[best] = following
    gain = scores[start] - scores[best]
    return Coordinate(factor=factors[best if gain > least_gain else start], best=factors[best], gain=gain)
