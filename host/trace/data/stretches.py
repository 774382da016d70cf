"""Stretches of a flight that are not used, with their reasons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from trimtab.host.trace.data.signals import Signals
from trimtab.host.trace.decision.findings import Code

STRETCH_ORDER = (
    Code.CLOCK_JUMP,
    Code.LATE_POSES,
    Code.MOTOR_AT_LIMIT,
    Code.PITCH_SINGULAR,
    Code.IMPACT,
    Code.GAP_IN_COMMANDS,
    Code.GAP_IN_POSES,
    Code.GROUND_CONTACT,
    Code.TILTED,
)
"""Reasons for which a stretch is not used. Stretches that begin at the same time are sorted in this order."""


@dataclass(frozen=True, kw_only=True)
class UnusedStretch:
    """A part of a flight that is not used: start and end in s since tracking began, and the reason."""

    start_s: float
    end_s: float
    code: Code


def within(
    t: Annotated[np.ndarray, "samples"], span_s: tuple[float, float]
) -> Annotated[np.ndarray, "samples"]:
    """Return the mask of the times t that lie in the span."""
    return (t >= span_s[0]) & (t <= span_s[1])


def clipped_stretch(s: Signals, start_s: float, end_s: float, code: Code) -> UnusedStretch:
    """Return a stretch, clipped to the tracking phase; start_s and end_s are since arming."""
    a, b = s.span_s
    return UnusedStretch(start_s=max(start_s, a) - a, end_s=min(end_s, b) - a, code=code)


def runs_of(
    t: Annotated[np.ndarray, "samples"], bad: Annotated[np.ndarray, "samples"]
) -> list[tuple[float, float]]:
    """Return the first and last time of each unbroken run of `bad` samples at times t."""
    edges = np.flatnonzero(np.diff(np.r_[False, bad, False].astype(int)))
    return [(float(t[a]), float(t[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def merged_spans(spans: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the spans in order, with overlapping and touching spans merged."""
    merged: list[tuple[float, float]] = []
    for start, end in sorted(spans):
        if merged and start <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(end, merged[-1][1]))
        else:
            merged.append((start, end))
    return merged
