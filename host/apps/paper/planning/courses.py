"""Random courses for the comparison of plans: all kinds get the same waypoints, time, limits and headroom."""

from __future__ import annotations

from dataclasses import dataclass

from trimtab.host.apps.paper.chance import number
from trimtab.host.base.errors import Refused
from trimtab.host.plan import Plan, plan
from trimtab.host.route import Route, random_route
from trimtab.host.vehicle import Vehicle

BOX_M = ((-3.5, 3.5), (-3.5, 3.5), (-2.6, -1.0))
WAYPOINTS = 9
"""Our choice: the paper prints no number of waypoints for its simulated course (its real one has seven)."""
MEAN_SPEED_M_S = 4.0
_TRIES = 50


@dataclass(frozen=True, kw_only=True)
class Course:
    """A route with the time in which its min-snap plan keeps the limits, and that plan."""

    route: Route
    snap: Plan


def draw_course(vehicle: Vehicle, seed: int, index: int, purpose: str) -> Course:
    """Return course `index` of a purpose, which is feasible by construction.

    Its time is the least one, from the drawn pace to twice that time, in which min-snap keeps the limits.
    The durations of its legs are optimised anew for that time, so the plan of the route is tried too. Raises
    ValueError if no drawn course qualifies.
    """
    for attempt in range(_TRIES):
        route = random_route(
            draw(seed, purpose, index, attempt),
            count=WAYPOINTS,
            box_m=BOX_M,
            mean_speed_m_s=MEAN_SPEED_M_S,
            name=f"{purpose}-{index}",
        )
        try:
            snap = plan(route, vehicle, kind="min-snap", stretch=True)
            timed = route.model_copy(update={"total_time_s": snap.duration_s})
            plan(timed, vehicle, kind="min-snap")
        except Refused:
            continue
        if snap.stretch <= 2.0:
            return Course(route=timed, snap=snap)
    raise ValueError(f"none of {_TRIES} drawn courses may be flown by {vehicle.name}")


def draw(seed: int, *what: str | int) -> int:
    """Return a number for a purpose, from the study's seed."""
    return number("trimtab study paper-planning, " + ", ".join(map(str, what)) + f", seed {seed}")
