"""Coordinate search: steps, bounds of the grid, and the least gain."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest

from trimtab.host.apps.paper.tuning.search import search_coordinate

FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0)


class Bowl:
    """A score with its minimum at `place`, in octaves; it counts what it scores."""

    def __init__(self, place: float, depth: float = 1.0) -> None:
        self.place, self.depth = place, depth
        self.tried: list[float] = []

    def __call__(self, factors: Sequence[float]) -> list[float]:
        self.tried += factors
        return [self.depth * (math.log2(factor) - self.place) ** 2 for factor in factors]


@pytest.mark.parametrize(
    ("place", "factor", "tried"),
    [
        (0.2, 1.0, [1.0, 0.5, 2.0]),
        (0.8, 2.0, [1.0, 0.5, 2.0, 4.0]),
        (9.0, 4.0, [1.0, 0.5, 2.0, 4.0]),
        (-1.9, 0.25, [1.0, 0.5, 2.0, 0.25]),
    ],
)
def test_search_steps_to_the_best_factor_and_stops(place: float, factor: float, tried: list[float]) -> None:
    bowl = Bowl(place)
    outcome = search_coordinate(bowl, FACTORS, 0.0)
    assert (outcome.factor, outcome.best) == (factor, factor)
    assert bowl.tried == tried


def test_gain_no_greater_than_the_least_keeps_the_start() -> None:
    outcome = search_coordinate(Bowl(1.0, depth=0.05), FACTORS, 0.05)
    assert (outcome.factor, outcome.best) == (1.0, 2.0)
    assert outcome.gain == pytest.approx(0.05)


def test_factor_that_does_not_fly_is_not_chosen() -> None:
    outcome = search_coordinate(lambda factors: [math.inf if f > 1 else f for f in factors], FACTORS, 0.0)
    assert outcome.factor == 0.25


def test_start_that_does_not_fly_is_refused() -> None:
    with pytest.raises(ValueError, match="start"):
        search_coordinate(lambda factors: [math.inf for _ in factors], FACTORS, 0.0)
