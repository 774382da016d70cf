"""Manoeuvres: routes that a vehicle can fly, as flat outputs, for the choice of the next flight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from trimtab.host.base.errors import TrimtabError
from trimtab.host.models.reference import flat_outputs
from trimtab.host.trace.data.cutting import DT_S
from trimtab.host.vehicle import Vehicle

if TYPE_CHECKING:
    from trimtab.host.route import Route

PACES = (1.0, 1.4, 2.0)
"""Shares of a route's own time that are tried, the shortest first."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Manoeuvre:
    """A flight along a route in `total_time_s`; `slowed` where the route's own time is too short for it.

    flat (14, n): p, v, a, j NED, yaw, yaw rate each DT_S, as `trimtab.host.models.reference.flat_outputs`
    gives them.
    """

    route: str
    total_time_s: float
    slowed: bool
    flat: np.ndarray


def manoeuvre(name: str, route: Route, vehicle: Vehicle) -> Manoeuvre | None:
    """Return the min-snap flight along the route known as `name`, at the first of PACES that keeps limits and
    geofence; None where none does.
    """
    from trimtab.host.plan import plan  # takes long to import, and few traces ask for a flight

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
    """Those of the routes that the vehicle can fly, by the routes' order."""
    found = (manoeuvre(name, route, vehicle) for name, route in routes.items())
    return tuple(each for each in found if each is not None)
