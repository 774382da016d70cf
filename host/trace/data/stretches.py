"""Stretches of a flight that are not used, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trimtab.host.trace.data.signals import Signals
from trimtab.host.trace.decision.findings import Code

STRETCH_ORDER = (
    Code.CLOCK_JUMP,
    Code.MOTOR_AT_LIMIT,
    Code.PITCH_SINGULAR,
    Code.IMPACT,
    Code.GAP_IN_COMMANDS,
    Code.GAP_IN_POSES,
    Code.GROUND_CONTACT,
    Code.TILTED,
)
"""Why a stretch is not used; of several that begin at one time, the first of these comes first."""


@dataclass(frozen=True, kw_only=True)
class Stretch:
    """A part of a flight that is not used, seconds since tracking began, and why."""

    start_s: float
    end_s: float
    code: Code


def within(t: np.ndarray, span_s: tuple[float, float]) -> np.ndarray:
    """Return which of the times (n,) lie in the span."""
    return (t >= span_s[0]) & (t <= span_s[1])


def clipped_stretch(s: Signals, start_s: float, end_s: float, code: Code) -> Stretch:
    """From times since arm, cut to the tracking phase."""
    a, b = s.span_s
    return Stretch(start_s=max(start_s, a) - a, end_s=min(end_s, b) - a, code=code)


def runs_of(t: np.ndarray, bad: np.ndarray) -> list[tuple[float, float]]:
    """First and last time of each unbroken run of `bad` samples."""
    edges = np.flatnonzero(np.diff(np.r_[False, bad, False].astype(int)))
    return [(float(t[a]), float(t[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def merged_spans(spans: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Spans in order, those that touch as one."""
    out: list[tuple[float, float]] = []
    for a, b in sorted(spans):
        if out and a <= out[-1][1]:
            out[-1] = (out[-1][0], max(b, out[-1][1]))
        else:
            out.append((a, b))
    return out
