"""Composition of the two references of a flight with a swap into the one that was flown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from trimtab.host.log.tracking import reference_at
from trimtab.protocol.blobs import Node, Reference, YawNode

CLOSEST_US = 20_000
"""Nodes of the first reference closer to the swap than this are left out: float32 distorts their jerk."""


def swap_us(statuses: Sequence[Any], then: Reference) -> tuple[int, int] | None:
    """Return the start of the first reference and of `then` on the vehicle's clock; None without a swap."""
    begun = [message for message in statuses if message.tracking_start_us]
    after = [message.tracking_start_us for message in begun if message.reference_id == then.id]
    before = [message.tracking_start_us for message in begun if message.reference_id != then.id]
    return (before[-1], after[-1]) if before and after and after[-1] > before[-1] else None


def composed(first: Reference, then: Reference, at_us: int) -> Reference:
    """Return a reference of the nodes of `first` up to `at_us` and then those of `then`, with one origin."""
    shift = [b - a for a, b in zip(first.origin_ned, then.origin_ned, strict=True)]
    nodes = [node for node in first.nodes if node.t_us == 0 or node.t_us <= at_us - CLOSEST_US]
    for t_us, state in then.nodes:
        p = [x + dx for x, dx in zip(state[:3], shift, strict=True)]
        nodes.append(Node(at_us + t_us, (*p, *state[3:])))
    flown = reference_at(first, np.array([at_us]))[0]
    rows, start = then.yaw_nodes(), reference_at(then, np.array([0]))[0]
    turn = 2.0 * math.pi * round((flown[12] - start[12]) / (2.0 * math.pi))
    yaws = [row for row in first.yaw_nodes() if row.t_us < at_us]
    if rows[0].t_us > 0:
        yaws.append(YawNode(at_us, start[12] + turn, 0.0))
    yaws += [YawNode(at_us + row.t_us, row.yaw + turn, row.yaw_rate) for row in rows]
    return Reference(
        vehicle_id=first.vehicle_id,
        origin_ned=first.origin_ned,
        nodes=tuple(nodes),
        yaws=tuple(yaws),
        free_ends=first.free_ends,
    )
