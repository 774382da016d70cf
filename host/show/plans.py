"""Plans as tracks and facts of a page: path, speed, attitude, thrust and margins over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.host.log.tracking import reference_at
from trimtab.host.models.airframe import THETA
from trimtab.host.plan.profile import Profile, profile
from trimtab.host.plan.residual import ResidualModel
from trimtab.host.plan.table import from_reference
from trimtab.host.route import Route
from trimtab.host.show.flights import UP, no_route_note
from trimtab.host.show.lattice import Track, euler_deg, lattice, quaternions, wrapped_deg
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import Reference

Course = tuple[Route, tuple[float, ...]]
"""A route, and the times of its waypoints, s."""


NOMINAL = ResidualModel()


def plan_track(
    reference: Reference,
    vehicle: Vehicle | None,
    course: Course | None,
    name: str,
    step_us: int,
    model: ResidualModel = NOMINAL,
) -> Track:
    """Return a reference on the lattice; attitude, thrusts and margins only with its vehicle.

    model: predicts the residual that is shown, if any.
    """
    route = None if course is None else course[0]
    grid_us = lattice(0, reference.duration_us, step_us)
    flat = reference_at(reference, grid_us)
    channels: dict[str, Any] = {
        "p_ref": flat[:, :3] * UP,
        "v_ref": flat[:, 3:6] * UP,
        "speed": np.linalg.norm(flat[:, 3:6], axis=1)[:, None],
    }
    if vehicle is None:
        channels["yaw_ref"] = wrapped_deg(flat[:, 12])[:, None]
    else:
        along = profile_of(reference, vehicle, grid_us, model)
        if along.residual_m_s2 is not None:
            channels["residual"] = along.residual_m_s2[:, None]
        channels["q"] = quaternions(along.x[THETA].T)
        channels["attitude"] = euler_deg(channels["q"])
        channels["rate"] = along.rate_frd.T
        channels["thrust"] = along.thrust_share.T
        shares = along.margin_shares(limits_of(vehicle, route))
        channels["margin"] = np.stack(list(shares.values()), axis=1)
    return Track(
        name=name,
        what="plan",
        simulated=False,
        reference_id=reference.id,
        zero="start of the reference",
        first=0,
        step_us=step_us,
        channels=channels,
        group="" if route is None else route.name,
        events=() if course is None else tuple(waypoint_events(course[1])),
        vehicle={}
        if vehicle is None
        else {"rotors_frd_m": [list(rotor.position_m) for rotor in vehicle.rotors]},
    )


def waypoint_events(times_s: Sequence[float]) -> list[dict[str, Any]]:
    """Return an event at each waypoint."""
    return [{"t_s": t_s, "kind": "waypoint", "text": str(k)} for k, t_s in enumerate(times_s)]


def profile_of(
    reference: Reference, vehicle: Vehicle, times_us: np.ndarray, model: ResidualModel = NOMINAL
) -> Profile:
    """Return the motion along the reference at these times, without a model that of the nominal vehicle."""
    table, yaws = from_reference(reference), reference.yaw_nodes()
    return profile(vehicle, model, table, yaws, times_us.astype(float))


def limits_of(vehicle: Vehicle, route: Route | None) -> Any:
    """Return the limits of a plan: the vehicle's, tightened by the route."""
    return vehicle.limits if route is None else route.limits.applied_to(vehicle.limits)


def plan_facts(
    reference: Reference, path: Path, vehicle: Vehicle | None, route: Route | None
) -> dict[str, Any]:
    """Return the facts of a plan for `--json` and the page."""
    times_us = np.linspace(0, reference.duration_us, 2001).round().astype(np.int64)
    flat = reference_at(reference, times_us)
    margins: dict[str, float] | None = None
    if vehicle is not None:
        along = profile_of(reference, vehicle, times_us)
        keep_out = () if route is None else route.keep_out
        margins = {
            name: float(values.min())
            for name, values in along.margins(limits_of(vehicle, route), keep_out).items()
        }
    return {
        "reference": str(path),
        "id": reference.id,
        "vehicle": None if vehicle is None else vehicle.name,
        "route": None if route is None else route.name,
        "duration_s": reference.duration_us * 1e-6,
        "path_length_m": float(np.linalg.norm(np.diff(flat[:, :3], axis=0), axis=1).sum()),
        "speed_max_m_s": float(np.linalg.norm(flat[:, 3:6], axis=1).max()),
        "margins": margins,
        "notes": plan_notes(reference, vehicle, route),
    }


def plan_notes(reference: Reference, vehicle: Vehicle | None, route: Route | None) -> list[str]:
    """Return what a reader must know of a plan, as sentences."""
    notes = []
    if vehicle is None:
        notes.append(
            f"The vehicle {reference.vehicle_id} of this reference is not known, so thrusts and margins are "
            "not shown. Name it with --vehicle."
        )
    if route is None:
        notes.append(no_route_note("the .ref.json file of this reference is missing"))
    return notes
