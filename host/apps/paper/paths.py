"""Random paths of the paper's section VI-B: waypoints in a confined room, minimum snap, several paces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trimtab.host.plan.judge import judge
from trimtab.host.plan.snap import optimise_durations
from trimtab.host.plan.table import Table, evaluate, snap_table
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import Reference, YawNode

WAYPOINTS = 20
STEP_US = 20_000
"""Between the samples of `statistics`, as in the paper."""

_TRIES, _CANDIDATES = 50, 200


@dataclass(frozen=True, kw_only=True)
class Room:
    """Where and how waypoints are drawn.

    box_m, middle_ned: edges and middle of the box. leg_m: least and greatest distance between waypoints.
    turn_deg: the most that a path turns at a waypoint, where a drawn one allows it. duration_s: of a path at
    pace 1.
    """

    box_m: tuple[float, float, float]
    middle_ned: tuple[float, float, float]
    leg_m: tuple[float, float]
    turn_deg: float
    duration_s: float


@dataclass(frozen=True, kw_only=True)
class Course:
    """A reference, whether it is out of distribution, and its name."""

    name: str
    out_of_distribution: bool
    reference: Reference
    table: Table


def draw_path(
    rng: np.random.Generator,
    vehicle: Vehicle,
    room: Room,
    name: str,
    paces: Mapping[str, float],
    *,
    out_of_distribution: bool,
) -> list[Course]:
    """Return a path drawn in a room, at each pace; `paces` maps the end of the course's name to a pace.

    A path that violates the vehicle's limits is drawn again. Raises ValueError if none may be flown.
    """
    for _ in range(_TRIES):
        waypoints = _walk(rng, room)
        durations = optimise_durations(waypoints, room.duration_s)
        courses = []
        for suffix, pace in paces.items():
            table = snap_table(waypoints, durations / pace)
            verdict = judge(table, [YawNode(0, 0.0, 0.0)], vehicle, vehicle.limits, ())
            if not verdict.ok:
                break
            courses.append(
                Course(
                    name=f"{name}{suffix}",
                    out_of_distribution=out_of_distribution,
                    reference=verdict.reference,
                    table=verdict.table,
                )
            )
        else:
            return courses
    raise ValueError(f"none of {_TRIES} drawn paths {name} may be flown by {vehicle.name}")


def statistics(courses: Sequence[Course]) -> dict[str, float]:
    """Return mean and standard deviation of speed, acceleration and jerk along references, every 20 ms."""
    rows: list[np.ndarray] = []
    for course in courses:
        times = np.arange(0, course.table.times_us[-1], STEP_US)
        rows.append(np.stack([np.linalg.norm(row, axis=0) for row in evaluate(course.table, times)[1:4]]))
    norms = np.concatenate(rows, axis=1)
    names = ("speed_m_s", "acceleration_m_s2", "jerk_m_s3")
    return {
        f"{name}_{what}": float(value)
        for name, row in zip(names, norms, strict=True)
        for what, value in (("mean", row.mean()), ("sd", row.std()))
    }


def _walk(rng: np.random.Generator, room: Room) -> np.ndarray:
    """Return waypoints (20, 3) drawn in the room's box.

    Each is the first drawn one that meets the bounds of a leg, or the one with the smallest turn of many.
    """
    box_m, straight = np.array(room.box_m), np.cos(np.deg2rad(room.turn_deg))
    points = [rng.uniform(-0.5, 0.5, 3) * box_m]
    way = np.zeros(3)
    while len(points) < WAYPOINTS:
        best, straightest = points[-1], -np.inf
        for candidate in rng.uniform(-0.5, 0.5, (_CANDIDATES, 3)) * box_m:
            leg = candidate - points[-1]
            length = float(np.linalg.norm(leg))
            ahead = float(leg @ way) / length if way.any() else 1.0
            if room.leg_m[0] <= length <= room.leg_m[1] and ahead > straightest:
                best, straightest = candidate, ahead
                if ahead >= straight:
                    break
        way = (best - points[-1]) / np.linalg.norm(best - points[-1])
        points.append(best)
    return np.array(room.middle_ned) + np.array(points)
