"""Check a reference against the limits of a vehicle. Planner and vehicle use the same function.

The check covers the flown path: the pieces between the nodes, septic in position and cubic in yaw, not only
the nodes. It samples every piece at least every 12.5 ms, or 512 times in pieces longer than 6.4 s, and
includes the thrust of every rotor from the flat outputs. An `Evaluator` computes the samples: the vehicle
has ONE_BY_ONE, in floats; the host has one in arrays, with the same bits.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from trimtab.firmware_model.law.limits import Airframe, Limits
from trimtab.firmware_model.law.reference import cubic_at, cubic_coefficients
from trimtab.firmware_model.law.reference_verdict import ReferenceReason, ReferenceVerdict, refused
from trimtab.firmware_model.law.scan import Bounds, Node, Search, YawNode, least_margins, scan, yaw_piece
from trimtab.firmware_model.law.smoothness import QUANTITIES, Deviations, deviations_one_by_one, worst_misfit

REST = (1e-3, 1e-2, 1e-1)
"""Greatest speed, acceleration and jerk that count as rest: above the rounding to float32."""
REST_YAW_RATE = 1e-3
"""Greatest yaw rate that counts as rest."""
NUMBER_MAX = 1e6
"""Greatest magnitude of a number in a node. Greater numbers are refused like NaN."""


class Evaluator(NamedTuple):
    """Evaluation of the equations at many places: least margins of samples, deviations of nodes."""

    least_margins: Search
    deviations: Deviations


ONE_BY_ONE = Evaluator(least_margins=least_margins, deviations=deviations_one_by_one)
"""One place after the other, in floats."""


def check_reference(
    nodes: Sequence[Node],
    yaw_nodes: Sequence[YawNode],
    model: Airframe,
    limits: Limits,
    samples_per_piece: int = 8,
    *,
    origin: Sequence[float] = (0.0, 0.0, 0.0),
    ends_at_rest: bool = True,
    evaluator: Evaluator = ONE_BY_ONE,
) -> ReferenceVerdict:
    """Return the verdict on a reference through `nodes` (NED, relative to `origin`) and `yaw_nodes`.

    The times must start at 0 and increase strictly, and all numbers must be finite. With `ends_at_rest` (the
    default) both ends must be at rest and at least `limits.end_height_m` above the floor. No part may lie
    below the floor z = 0, independent of the geofence. The yaw rate must be 0 where a constant yaw starts or
    ends.
    """
    refusal = _structure(nodes, yaw_nodes, origin)
    if refusal is None:
        refusal = _yaw_rate_at_holds(nodes, yaw_nodes, ends_at_rest)
    if refusal is None and ends_at_rest:
        refusal = check_ends(nodes, limits, origin, ends=(0, len(nodes) - 1))
    if refusal is None:
        refusal = _smooth(nodes, evaluator.deviations)
    if refusal is not None:
        return refusal
    bounds = Bounds(model, limits, origin)
    return scan(nodes, yaw_nodes, bounds, samples_per_piece, evaluator.least_margins)


def _structure(
    nodes: Sequence[Node], yaw_nodes: Sequence[YawNode], origin: Sequence[float]
) -> ReferenceVerdict | None:
    """Return the refusal of nodes that do not form a reference, or None."""
    if len(nodes) < 2 or len(yaw_nodes) < 1:
        text = f"{len(nodes)} nodes and {len(yaw_nodes)} yaw nodes, at least 2 and 1 are needed"
        return refused(ReferenceReason.TOO_FEW_NODES, len(nodes), 0, "nodes", float(len(nodes)), 2.0, text)
    rows = [(t, tuple(state), "node") for t, state in nodes]
    rows += [(t, (yaw, rate), "yaw node") for t, yaw, rate in yaw_nodes]
    for k, (t_us, values, row_kind) in enumerate(rows):
        node = k if row_kind == "node" else k - len(nodes)
        for value in (*values, *origin):
            if not abs(value) <= NUMBER_MAX:
                text = f"{row_kind} has the invalid number {value:.6g}"
                return refused(ReferenceReason.NOT_FINITE, node, t_us, row_kind, value, NUMBER_MAX, text)
    if nodes[0][0] != 0:
        text = "the first node must be at 0"
        return refused(ReferenceReason.TIME_ORDER, 0, nodes[0][0], "time", nodes[0][0] * 1e-6, 0.0, text)
    for times, row_kind in (([t for t, _ in nodes], "node"), ([t for t, _, _ in yaw_nodes], "yaw node")):
        for k, (before, after) in enumerate(pairwise(times), start=1):
            if after <= before:
                text = f"{row_kind} is not after the previous one at {before * 1e-6:.6f} s"
                return refused(
                    ReferenceReason.TIME_ORDER, k, after, "time", after * 1e-6, before * 1e-6, text
                )
    return None


def check_ends(
    nodes: Sequence[Node], limits: Limits, origin: Sequence[float], *, ends: Sequence[int]
) -> ReferenceVerdict | None:
    """Return the refusal of a start or end that is not at rest or too low, or None.

    ends: indices of the nodes to check.
    """
    for node in ends:
        t_us, state = nodes[node]
        end = "start" if node == 0 else "end"
        for k, (quantity, unit) in enumerate(
            (("speed", "m/s"), ("acceleration", "m/s^2"), ("jerk", "m/s^3"))
        ):
            value = math.hypot(*state[3 * k + 3 : 3 * k + 6])
            if not value <= REST[k]:
                text = f"the {end} is not at rest, {quantity} {value:.4g} {unit}"
                return refused(ReferenceReason.NOT_AT_REST, node, t_us, quantity, value, REST[k], text)
        height, bound = -(state[2] + origin[2]), limits.end_height_m
        if not height >= bound - 1e-6:
            text = f"the {end} is {height:.3g} m above the floor, less than {bound:.3g} m"
            return refused(ReferenceReason.TOO_LOW, node, t_us, "height", height, bound, text)
    return None


def _yaw_rate_at_holds(
    nodes: Sequence[Node], yaw_nodes: Sequence[YawNode], ends_at_rest: bool
) -> ReferenceVerdict | None:
    """Return the refusal of a yaw rate that is not 0 where yaw becomes or stops being constant, or None.

    Yaw is constant outside its nodes, and before and after a flight whose ends are at rest.
    """
    end_us = nodes[-1][0]
    first_us, last_us = max(yaw_nodes[0][0], 0), min(yaw_nodes[-1][0], end_us)
    if first_us >= last_us:
        return None
    start, stop = yaw_piece(yaw_nodes, first_us), yaw_piece(yaw_nodes, last_us - 1)
    for piece, t_us, free in (
        (start, first_us, first_us == 0),
        (stop, last_us, last_us == end_us),
    ):
        t0, *ends = piece
        rate = abs(cubic_at(cubic_coefficients(*ends), (t_us - t0) * 1e-6)[1])
        if not rate <= REST_YAW_RATE and (ends_at_rest or not free):
            node = max(0, bisect_left([t for t, _ in nodes], t_us) - 1)
            text = f"yaw rate {rate:.4g} rad/s where yaw is held"
            return refused(
                ReferenceReason.NOT_AT_REST, node, nodes[node][0], "yaw rate", rate, REST_YAW_RATE, text, t_us
            )
    return None


def _smooth(nodes: Sequence[Node], deviations: Deviations) -> ReferenceVerdict | None:
    """Return the refusal of the node with the greatest misfit, or None if all nodes are consistent."""
    worst = worst_misfit(nodes, deviations)
    if worst is None or worst.value <= worst.bound:
        return None
    quantity, unit = QUANTITIES[worst.quantity]
    text = f"{quantity} off its neighbours by {worst.value:.3g}, above {worst.bound:.3g} {unit}"
    t_us = nodes[worst.node][0]
    return refused(ReferenceReason.NOT_SMOOTH, worst.node, t_us, quantity, worst.value, worst.bound, text)
