"""What a foreign file holds, found without importing it."""

from __future__ import annotations

from dataclasses import dataclass

from trimtab.host.base.text import escaped


@dataclass(frozen=True, kw_only=True)
class Topic:
    """A stream of one rate: name as in the file, number of samples, and samples per second (0 if unknown)."""

    name: str
    count: int
    rate_hz: float


@dataclass(frozen=True, kw_only=True)
class Contents:
    """Topics of a file in its own order, its duration, and what is wrong with it, a line each."""

    topics: tuple[Topic, ...]
    duration_s: float
    notes: tuple[str, ...] = ()


_SHORTEST_S = 1e-6
"""A shorter time between samples is damaged."""


def topic(name: str, count: int, duration_s: float) -> Topic:
    """Return a topic with `count` samples that span `duration_s`."""
    rate_hz = max(0, count - 1) / duration_s if duration_s >= _SHORTEST_S else 0.0
    return Topic(name=escaped(name), count=count, rate_hz=rate_hz)
