"""The verdict on a reference: the first limit that it breaks, with the numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum


class ReferenceReason(IntEnum):
    """Why a reference was refused; the numbers travel on the wire and never change."""

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
    BATTERY = 14  # found by the vehicle, which alone knows its voltage


@dataclass(frozen=True, kw_only=True)
class ReferenceVerdict:
    """`ok`, or the first node whose piece breaks a limit, and the numbers.

    text: the fault, at most 64 bytes. message: the fault with node and time. margins: least distance to each
    bound over the whole flight, negative if broken; empty if the nodes are no reference at all.
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
    """Return a refusal of the node at t_us, or of the piece after it at the time at_us."""
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
