"""The verdict on a node table: the vehicle's checks of its rounded reference, and figures along it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from trimtab.firmware_model.law.checks import check_reference
from trimtab.firmware_model.law.limits import Airframe, from_parameters
from trimtab.firmware_model.law.limits import Limits as CheckedLimits
from trimtab.firmware_model.law.reference_verdict import ReferenceVerdict
from trimtab.host.codegen import NUMPY
from trimtab.host.codegen.all_at_once import ALL_AT_ONCE
from trimtab.host.plan.box import GATES, KEEP_OUT, YAW_RATE, checked
from trimtab.host.plan.heading import fastest_turn
from trimtab.host.plan.profile import profile, sample_times
from trimtab.host.plan.residual import ResidualModel
from trimtab.host.plan.table import Table, evaluate, from_reference, round_times, to_reference
from trimtab.host.route import Gate, Route
from trimtab.host.route.shapes import Shape
from trimtab.host.vehicle import Limits, Vehicle, to_parameters
from trimtab.protocol.blobs import Reference, YawNode


def on_board_verdict(reference: Reference, vehicle: Vehicle) -> ReferenceVerdict:
    """Return the verdict that a Trimtab vehicle of this file would give on a reference from rest to rest."""
    return _verdict(reference, *_on_board(vehicle), ends_at_rest=True)


def _verdict(
    reference: Reference, airframe: Airframe, limits: CheckedLimits, *, ends_at_rest: bool
) -> ReferenceVerdict:
    return check_reference(
        reference.nodes,
        reference.yaw_nodes(),
        airframe,
        limits,
        origin=reference.origin_ned,
        ends_at_rest=ends_at_rest,
        evaluator=ALL_AT_ONCE,
    )


@dataclass(frozen=True, kw_only=True)
class Judged:
    """A reference, the table as flown, and whether it may be flown. margins: least distance to each limit."""

    reference: Reference
    table: Table
    ok: bool
    message: str
    verdict: ReferenceVerdict
    margins: Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class Passing:
    """A gate, its centre, and the time at which a table passes it."""

    gate: Gate
    centre_ned: tuple[float, float, float]
    t_us: int


def passings(route: Route, waypoint_times_s: ArrayLike) -> list[Passing]:
    """Return the route's gates with the times of their waypoints; times (K,)."""
    times_us = round_times(np.asarray(waypoint_times_s, dtype=float))
    return [
        Passing(gate=gate, centre_ned=route.waypoints_m[gate.waypoint], t_us=int(times_us[gate.waypoint]))
        for gate in route.gates or ()
    ]


@dataclass(frozen=True, kw_only=True)
class Figures:
    """Figures along the whole reference.

    residual_rms_m_s2: None without a model. outside_region: share of the reference outside the trained
    region, None where that is not known.
    """

    path_length_m: float
    mean_speed_m_s: float
    residual_rms_m_s2: float | None
    outside_region: float | None


def judge(
    table: Table,
    yaws: Sequence[YawNode],
    vehicle: Vehicle,
    limits: Limits,
    keep_out: Sequence[Shape],
    gates: Sequence[Passing] = (),
    yaw_rate_max_rad_s: float | None = None,
    clearance_m: float = 0.0,
) -> Judged:
    """Return the verdict on a table as the vehicle reads it, within these limits and those on board.

    yaw_rate_max_rad_s: greatest rate of a free heading. clearance_m: by how much shapes are grown and gates
    are shrunk already, for the message.
    """
    reference = to_reference(table, yaws, vehicle.id)
    airframe, on_board = _on_board(vehicle)
    verdict = _verdict(reference, airframe, checked(limits, on_board), ends_at_rest=not reference.free_ends)
    flown = from_reference(reference)
    margins, ok, message = dict(verdict.margins), verdict.ok, verdict.message
    more_margins: list[tuple[str, float, str]] = []
    if keep_out:
        more_margins.append((KEEP_OUT, *_keep_out(flown, keep_out, clearance_m)))
    if gates:
        more_margins.append((GATES, *_gates(flown, gates, clearance_m)))
    if yaw_rate_max_rad_s is not None:
        more_margins.append((YAW_RATE, *_turning(flown, reference.yaw_nodes(), yaw_rate_max_rad_s)))
    for name, margin, where in more_margins:
        margins[name] = margin
        if ok and margin < 0.0:
            ok, message = False, where
    return Judged(reference=reference, table=flown, ok=ok, message=message, verdict=verdict, margins=margins)


@lru_cache(maxsize=8)
def _on_board(vehicle: Vehicle) -> tuple[Airframe, CheckedLimits]:
    """Return airframe and limits as the vehicle's firmware has them."""
    return from_parameters(to_parameters(vehicle))


def measure(vehicle: Vehicle, model: ResidualModel, table: Table, yaws: Sequence[YawNode]) -> Figures:
    """Return length, speed and predicted residual along a table, sampled every 10 ms."""
    along = profile(vehicle, model, table, yaws)
    length = float(np.linalg.norm(np.diff(along.p_ned, axis=1), axis=0).sum())
    residual = along.residual_m_s2
    return Figures(
        path_length_m=length,
        mean_speed_m_s=length / float(along.t_s[-1]),
        residual_rms_m_s2=None if residual is None else float(np.sqrt((residual**2).mean())),
        outside_region=None if along.outside is None else float(along.outside.mean()),
    )


def _keep_out(table: Table, shapes: Sequence[Shape], clearance_m: float) -> tuple[float, str]:
    """Return the least distance from the shapes, and a message that says where it is."""
    times_us = sample_times(table)
    p = evaluate(table, times_us)[0]
    least, where = np.inf, ""
    for number, shape in enumerate(shapes):
        distance = np.asarray(shape.signed_distance(NUMPY, list(p)))
        k = int(distance.argmin())
        if distance[k] < least:
            least = float(distance[k])
            node = int(np.searchsorted(table.times_us, times_us[k], side="right")) - 1
            where = (
                f"node {node} at {table.times_us[node] * 1e-6:.3f} s: {-least:.3g} m inside "
                f"keep_out[{number}] ({shape.kind}){_grown(clearance_m)}, at {times_us[k] * 1e-6:.3f} s"
            )
    return least, where


def obstacle_margins(table: Table, keep_out: Sequence[Shape], gates: Sequence[Passing]) -> dict[str, float]:
    """Return the least distances of a table from keep-out shapes and inside gates, m, where it has any."""
    margins = {}
    if keep_out:
        margins[KEEP_OUT] = _keep_out(table, keep_out, 0.0)[0]
    if gates:
        margins[GATES] = float(inside_gates(table, gates).min())
    return margins


def inside_gates(table: Table, gates: Sequence[Passing]) -> Annotated[np.ndarray, "gates"]:
    """Return the distances inside each gate's edge when it is passed, m; negative outside."""
    p = evaluate(table, np.array([passing.t_us for passing in gates], dtype=np.int64))[0].T
    inside = [passing.gate.inside_m(at, passing.centre_ned) for passing, at in zip(gates, p, strict=True)]
    return np.array(inside)


def _grown(clearance_m: float) -> str:
    """Return the words for a clearance that counts as part of an obstacle."""
    return f" and its clearance of {clearance_m:.3g} m" if clearance_m else ""


def _gates(table: Table, gates: Sequence[Passing], clearance_m: float) -> tuple[float, str]:
    """Return the least distance inside a gate's edge, and a message that says where it is."""
    inside = inside_gates(table, gates)
    k = int(inside.argmin())
    t_us = gates[k].t_us
    node = int(np.searchsorted(table.times_us, t_us, side="right")) - 1
    least = float(inside[k])
    return (
        least,
        f"node {node} at {t_us * 1e-6:.3f} s: {-least:.3g} m outside gates[{k}]{_grown(clearance_m)}",
    )


def _turning(table: Table, yaws: Sequence[YawNode], bound: float) -> tuple[float, str]:
    """Return the distance of the greatest yaw rate from its bound, and a message that says where it is."""
    rate, t_us = fastest_turn(yaws)
    node = int(np.searchsorted(table.times_us, t_us, side="right")) - 1
    return bound - rate, (
        f"node {node} at {table.times_us[node] * 1e-6:.3f} s: yaw rate {rate:.4g} above {bound:g} rad/s, "
        f"at {t_us * 1e-6:.3f} s"
    )
