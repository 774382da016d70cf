"""Manoeuvres: plans along known routes, as flat outputs, among which the next flight is chosen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from trimtab.host.base.errors import TrimtabError
from trimtab.host.models.reference import flat_outputs
from trimtab.host.trace.data.cutting import DT_S
from trimtab.host.vehicle import Vehicle

if TYPE_CHECKING:
    from trimtab.host.route import Route

PACES = (1.0, 1.4, 2.0)
"""Multiples of the duration of a route that are tried, the shortest first."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Manoeuvre:
    """A plan along a route.

    route: its name. total_time_s: duration of the plan. slowed: whether that is longer than the duration that
    the route states. flat: position, velocity, acceleration and jerk NED, yaw and yaw rate, every
    DT_S, as from `trimtab.host.models.reference.flat_outputs`.
    """

    route: str
    total_time_s: float
    slowed: bool
    flat: Annotated[np.ndarray, "14 times"]


def manoeuvre(name: str, route: Route, vehicle: Vehicle) -> Manoeuvre | None:
    """Return the min-snap plan along a route at the first of PACES that keeps limits and geofence.

    name: name of the route. Returns None if no pace keeps them.
    """
    from trimtab.host.plan import plan  # slow to import, and few traces propose a flight

    for pace in PACES:
        try:
            planned = plan(route, vehicle, kind="min-snap", total_time_s=pace * route.duration_s)
        except TrimtabError:
            continue
        t_s = np.arange(0.0, planned.duration_s, DT_S)
        return Manoeuvre(
            route=name,
            total_time_s=planned.duration_s,
            slowed=pace > 1.0,
            flat=flat_outputs(planned.reference, t_s),
        )
    return None


def manoeuvres(routes: Mapping[str, Route], vehicle: Vehicle) -> tuple[Manoeuvre, ...]:
    """Return the manoeuvres along all routes that the vehicle can fly, in the order of the routes."""
    candidates = (manoeuvre(name, route, vehicle) for name, route in routes.items())
    return tuple(candidate for candidate in candidates if candidate is not None)
