"""Verdict on a reference: the first limit that it violates, with value and bound."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum


class ReferenceReason(IntEnum):
    """Reasons for the refusal of a reference. The values are part of the protocol and never change."""

    NONE = 0
    TOO_FEW_NODES = 1
    NOT_FINITE = 2
    TIME_ORDER = 3
    NOT_AT_REST = 4
    TOO_LOW = 5
    GEOFENCE = 6
    SPEED = 7
    TILT = 8
    BODY_RATE = 9
    JERK = 10
    THRUST_LOW = 11
    THRUST_HIGH = 12
    NOT_SMOOTH = 13
    BATTERY = 14  # only the vehicle reports this: the host does not know the voltage


@dataclass(frozen=True, kw_only=True)
class ReferenceVerdict:
    """Verdict on a reference: `ok`, or the first node whose piece violates a limit, with value and bound.

    text: the violation, at most 64 bytes. message: the violation with node and time. margins: least distance
    to each bound over the whole flight, negative if violated; empty if the nodes do not form a reference.
    """

    ok: bool
    node: int = -1
    quantity: str = ""
    value: float = 0.0
    bound: float = 0.0
    reason_code: ReferenceReason = ReferenceReason.NONE
    text: str = ""
    message: str = "within all limits"
    margins: Mapping[str, float] = field(default_factory=dict)


def refused(
    reason: ReferenceReason,
    node: int,
    t_us: int,
    quantity: str,
    value: float,
    bound: float,
    text: str,
    at_us: float | None = None,
) -> ReferenceVerdict:
    """Return the refusal of the node at `t_us`, or of the piece after it at the time `at_us`."""
    message = f"node {node} at {t_us * 1e-6:.3f} s: {text}"
    if at_us is not None:
        message += f", at {at_us * 1e-6:.3f} s"
    return ReferenceVerdict(
        ok=False,
        node=node,
        quantity=quantity,
        value=value,
        bound=bound,
        reason_code=reason,
        text=text,
        message=message,
    )
