"""Node tables: position, velocity, acceleration and jerk at whole microseconds, with septics between them.

A table becomes the reference: the vehicle flies the septic pieces between its nodes. All figures of a plan
(margins, residual, length, deviation) are therefore computed from the rounded table.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trimtab.firmware_model.law.flatness import Body, flat_full
from trimtab.firmware_model.law.reference import cubic_acceleration, cubic_coefficients, hermite_yaw, septic
from trimtab.firmware_model.law.rotations import matrix_to_euler
from trimtab.host.codegen import NUMPY
from trimtab.host.plan.snap import REST, SnapSpline, solve_snap
from trimtab.host.vehicle import Vehicle
from trimtab.host.vehicle.allocation import allocation_inverse
from trimtab.protocol.blobs import Node, Reference, YawNode

Array = NDArray[np.float64]
Times = NDArray[np.int64]

SPACING_S = 0.1
"""Nominal distance of nodes; at less than half of it float32 spoils the jerk."""
_ORIGIN_STEP_M = 0.1


@dataclass(frozen=True, kw_only=True)
class Table:
    """Nodes of a reference. states_ned: p, v, a, j."""

    times_us: Annotated[Times, "nodes"]
    states_ned: Annotated[np.ndarray, "nodes 12"]

    def __post_init__(self) -> None:
        if self.states_ned.shape != (len(self.times_us), 12):
            raise ValueError(
                f"{len(self.times_us)} times need as many rows of 12, got {self.states_ned.shape}"
            )


def knot_times(
    waypoint_times_us: Annotated[Times, "waypoints"],
    spacing_s: float = SPACING_S,
    most: Annotated[Times, "legs"] | None = None,
) -> Annotated[Times, "nodes"]:
    """Return times, us, about `spacing_s` apart, among them the time of every waypoint.

    Each leg is divided evenly into at least one piece and at most `most` pieces. No piece is shorter than
    half the spacing unless its leg is.
    """
    pieces: list[NDArray[np.float64]] = []
    caps = np.full(len(waypoint_times_us) - 1, np.iinfo(np.int64).max) if most is None else most
    for start, end, cap in zip(waypoint_times_us[:-1], waypoint_times_us[1:], caps, strict=True):
        count = min(max(1, round((end - start) / (spacing_s * 1e6))), int(cap))
        pieces.append(start + (end - start) * np.arange(count) / count)
    return np.rint(np.concatenate([*pieces, waypoint_times_us[-1:]])).astype(np.int64)


def round_times(times_s: Annotated[np.ndarray, "times"]) -> Annotated[Times, "times"]:
    """Whole microseconds. Raises ValueError where two of them fall together."""
    times = np.rint(np.asarray(times_s) * 1e6).astype(np.int64)
    if not (np.diff(times) > 0).all():
        raise ValueError("times must increase by at least a microsecond")
    return times


def snap_table(
    waypoints_ned: Annotated[np.ndarray, "waypoints 3"],
    durations_s: Annotated[np.ndarray, "legs"],
    end_velocities_ned: ArrayLike = REST,
) -> Table:
    """Return the minimum-snap spline as a table, with waypoint times rounded to microseconds."""
    waypoint_times = round_times(np.concatenate([[0.0], np.cumsum(durations_s)]))
    spline = solve_snap(waypoints_ned, np.diff(waypoint_times) * 1e-6, end_velocities_ned)
    ends = Table(times_us=waypoint_times, states_ned=_rows(spline))
    knots = knot_times(waypoint_times)
    states = np.concatenate(evaluate(ends, knots)[:4]).T
    on_waypoint = np.isin(knots, waypoint_times)
    states[on_waypoint] = ends.states_ned
    return Table(times_us=knots, states_ned=states)


def _rows(spline: SnapSpline) -> Array:
    return spline.ends_ned.reshape(len(spline.times_s), 12)


def evaluate(
    table: Table, times_us: Annotated[np.ndarray, "times"]
) -> tuple[
    Annotated[np.ndarray, "3 times"],
    Annotated[np.ndarray, "3 times"],
    Annotated[np.ndarray, "3 times"],
    Annotated[np.ndarray, "3 times"],
    Annotated[np.ndarray, "3 times"],
]:
    """Return position, velocity, acceleration, jerk and snap at times within the table."""
    at = np.asarray(times_us, dtype=float)
    piece = np.clip(np.searchsorted(table.times_us, at, side="right") - 1, 0, len(table.times_us) - 2)
    start = table.times_us[piece]
    length_s = (table.times_us[piece + 1] - start) * 1e-6
    before, after = table.states_ned[piece].T, table.states_ned[piece + 1].T
    rows = septic(length_s, (at - start) * 1e-6, list(before), list(after))
    p, v, a, j, snap = (np.array(row) for row in rows)
    return p, v, a, j, snap


def yaw_at(
    yaws: Sequence[YawNode], times_us: Annotated[np.ndarray, "times"]
) -> tuple[Annotated[np.ndarray, "times"], Annotated[np.ndarray, "times"]]:
    """Return yaw and yaw rate; yaw is constant before the first and after the last node."""
    at = np.asarray(times_us, dtype=float)
    if len(yaws) == 1:
        return np.full(at.shape, yaws[0].yaw), np.zeros(at.shape)
    times, yaw, rate = (np.array(column, dtype=float) for column in zip(*yaws, strict=True))
    inside = np.clip(at, times[0], times[-1])
    piece = np.clip(np.searchsorted(times, inside, side="right") - 1, 0, len(times) - 2)
    length_s = (times[piece + 1] - times[piece]) * 1e-6
    value, slope = hermite_yaw(
        length_s, (inside - times[piece]) * 1e-6, yaw[piece], rate[piece], yaw[piece + 1], rate[piece + 1]
    )
    return value, np.where((at < times[0]) | (at > times[-1]), 0.0, slope)


def yaw_acceleration_at(
    yaws: Sequence[YawNode], times_us: Annotated[np.ndarray, "times"]
) -> Annotated[np.ndarray, "times"]:
    """Return the yaw acceleration, rad/s^2; at a yaw node that of the following piece."""
    at = np.asarray(times_us, dtype=float)
    if len(yaws) == 1:
        return np.zeros(at.shape)
    times, yaw, rate = (np.array(column, dtype=float) for column in zip(*yaws, strict=True))
    piece = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    length_s = (times[piece + 1] - times[piece]) * 1e-6
    coefficients = cubic_coefficients(length_s, yaw[piece], rate[piece], yaw[piece + 1], rate[piece + 1])
    acceleration = np.asarray(cubic_acceleration(coefficients, (at - times[piece]) * 1e-6))
    return np.where((at < times[0]) | (at > times[-1]), 0.0, acceleration)


def flat_states(
    vehicle: Vehicle, table: Table, yaws: Sequence[YawNode], times_us: Annotated[np.ndarray, "times"]
) -> Annotated[np.ndarray, "16 times"]:
    """Return p_ned, v_ned, Theta, rate_frd, rotor thrusts (N) of the nominal vehicle on this path."""
    p, v, a, j, snap = evaluate(table, times_us)
    yaw, yaw_rate = yaw_at(yaws, times_us)
    body = Body(vehicle.mass_kg, vehicle.inertia_kg_m2)
    R, rate, _, collective, torque = flat_full(
        NUMPY, list(a), list(j), list(snap), yaw, yaw_rate, body, yaw_acceleration_at(yaws, times_us)
    )
    euler: Any = matrix_to_euler(NUMPY, R)
    thrust = allocation_inverse(vehicle) @ np.array([collective, *torque])
    return np.concatenate([p, v, np.array(euler), np.array(rate), thrust])


def to_reference(table: Table, yaws: Sequence[YawNode], vehicle_id: str) -> Reference:
    """Return the reference blob; its origin is near the middle of the nodes, where float32 loses least.

    A table that moves at an end gives a reference with free ends. The vehicle does not start such a
    reference, but may switch to it in flight.
    """
    low, high = table.states_ned[:, :3].min(axis=0), table.states_ned[:, :3].max(axis=0)
    steps = np.rint(0.5 * (low + high) / _ORIGIN_STEP_M)
    origin = tuple(round(float(step) * _ORIGIN_STEP_M, 6) for step in steps)
    states = table.states_ned.copy()
    states[:, :3] -= origin
    return Reference(
        vehicle_id=vehicle_id,
        origin_ned=(origin[0], origin[1], origin[2]),
        nodes=tuple(
            Node(t_us, tuple(state))
            for t_us, state in zip(table.times_us.tolist(), states.tolist(), strict=True)
        ),
        yaws=tuple(yaws),
        free_ends=bool(table.states_ned[[0, -1], 3:].any()),
    )


def from_reference(reference: Reference) -> Table:
    """Return the table as flown: positions in NED, rounded as the blob rounds."""
    nodes = reference.nodes_ned()
    return Table(
        times_us=np.array([node.t_us for node in nodes], dtype=np.int64),
        states_ned=np.array([node.state for node in nodes]),
    )
