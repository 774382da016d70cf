"""The mean thrust of each rotor over the flight of a log, and the acceleration that it held."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.host.trace.data.audit import Audit
from trimtab.host.trace.data.signals import FlightData, Signals, averaged
from trimtab.host.trace.data.stretches import merged_spans, within
from trimtab.host.trace.decision.findings import Code, LogsRefused
from trimtab.host.trace.decision.rules import RULES

_ABSENT = frozenset(
    {Code.GROUND_CONTACT, Code.GAP_IN_COMMANDS, Code.GAP_IN_POSES, Code.IMPACT, Code.CLOCK_JUMP}
)
"""Stretches that the mean leaves out. A motor at its limit still turns as commanded, so it counts."""


@dataclass(frozen=True, kw_only=True)
class HoverMean:
    """Means of a log over the time in the air.

    Attributes
    ----------
    command
        Means over blocks of RULES.hover_block_s of the motor commands, 0 to 1, or of the rotor thrusts in N.
    command_squared
        The same of their squares.
    in_newton
        Whether commands are rotor thrusts in N.
    lift_m_s2
        Mean specific force along the thrust that the measured motion needs.
    height_m, voltage_ratio
        Mean height above the start, and battery voltage over full voltage.
    flying_s
        Time in the air.
    """

    command: Annotated[np.ndarray, "blocks 4"]
    command_squared: Annotated[np.ndarray, "blocks 4"]
    in_newton: bool
    lift_m_s2: float
    height_m: float
    voltage_ratio: float
    flying_s: float


def hover_mean(data: FlightData, audit: Audit) -> HoverMean:
    """Return the means of a flight. Raises LogsRefused if it flies for less than RULES.hover_min_s."""
    s = data.signals
    blocks = [block for span in _spans(s, audit) for block in _blocks(span)]
    flying_s = sum(end - start for start, end in blocks)
    if flying_s < RULES.hover_min_s:
        raise LogsRefused(
            Code.TOO_FEW_SEGMENTS,
            f"{data.flight.path}: {flying_s:.1f} s in the air without gaps, but a comparison of hovers needs "
            f"{RULES.hover_min_s:g} s; fly longer",
        )
    means = [
        averaged(np.array(block), s.input_s, np.column_stack([s.command, s.command**2]))[0][0]
        for block in blocks
    ]
    command = np.array(means)
    voltage = np.mean([np.interp(np.mean(block), s.voltage_s, s.voltage_ratio) for block in blocks])
    flying = np.logical_or.reduce([within(s.pose_s, block) for block in blocks])
    return HoverMean(
        command=command[:, :4],
        command_squared=command[:, 4:],
        in_newton=s.in_newton,
        lift_m_s2=_lift(s, blocks, flying),
        height_m=float(s.p_ned[0, 2] - s.p_ned[flying, 2].mean()),
        voltage_ratio=float(voltage),
        flying_s=flying_s,
    )


def _spans(s: Signals, audit: Audit) -> list[tuple[float, float]]:
    """Return the spans in the air, since arming, without their first and last RULES.hover_margin_s."""
    start_s, end_s = s.span_s
    absent = [
        (start_s + each.start_s, start_s + each.end_s) for each in audit.stretches if each.code in _ABSENT
    ]
    spans, at = [], start_s
    for begin, end in merged_spans([*absent, (end_s, end_s)]):
        spans.append((at + RULES.hover_margin_s, begin - RULES.hover_margin_s))
        at = max(at, end)
    return [(a, b) for a, b in spans if b - a >= RULES.hover_block_s]


def _blocks(span: tuple[float, float]) -> list[tuple[float, float]]:
    """Return the span in equal blocks of at least RULES.hover_block_s."""
    count = int((span[1] - span[0]) / RULES.hover_block_s)
    edges = np.linspace(*span, count + 1)
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))


def _lift(s: Signals, blocks: list[tuple[float, float]], flying: np.ndarray) -> float:
    """Return the mean specific force along the thrust, m/s^2: the vertical one over the cosine of the tilt.

    The mean vertical acceleration of a span is the change of its vertical speed over its length.
    """
    climbs = [
        np.polyfit(s.pose_s[inside], s.p_ned[inside, 2], 2)
        for inside in (within(s.pose_s, block) for block in blocks)
    ]
    down = np.mean([2.0 * fit[0] for fit in climbs])
    return float((GRAVITY - down) / s.R_ned_frd[flying, 2, 2].mean())
