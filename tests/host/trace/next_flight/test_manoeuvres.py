"""The shipped manoeuvres: both vehicles get only manoeuvres that they can fly."""

from __future__ import annotations

import numpy as np
import pytest

from trimtab.host.route import list_routes, load_route, route_description
from trimtab.host.trace.next_flight.manoeuvres import Manoeuvre, manoeuvre, manoeuvres
from trimtab.host.vehicle import Vehicle, load_vehicle

ROUTES = tuple(list_routes())
TOO_LARGE_FOR_NANO = ("sprint",)
LOWEST_M = 0.5


def inside(flown: Manoeuvre, vehicle: Vehicle) -> bool:
    """Return whether every point of the path is inside the geofence."""
    low, high = np.array(vehicle.limits.geofence_m).T
    p_ned = flown.flat[0:3].T
    return bool(((p_ned >= low) & (p_ned <= high)).all())


@pytest.mark.parametrize("name", ROUTES)
def test_shipped_route_flies_in_its_own_time_and_above_half_a_metre(name: str) -> None:
    vehicle = load_vehicle("research")
    flown = manoeuvre(name, load_route(name), vehicle)
    assert flown is not None
    assert not flown.slowed
    assert inside(flown, vehicle)
    assert flown.flat[2].max() <= -LOWEST_M
    assert route_description(name)


def test_nano_gets_the_routes_that_fit_with_more_time_if_needed() -> None:
    vehicle = load_vehicle("nano")
    known = manoeuvres({name: load_route(name) for name in ROUTES}, vehicle)
    assert {flown.route for flown in known} == set(ROUTES) - set(TOO_LARGE_FOR_NANO)
    for flown in known:
        assert inside(flown, vehicle)
        speed = np.linalg.norm(flown.flat[3:6], axis=0).max()
        assert speed <= vehicle.limits.speed_max_m_s
        own = load_route(flown.route).duration_s
        assert flown.slowed == (flown.total_time_s > own + 0.01)
    assert any(flown.slowed for flown in known)
    assert any(not flown.slowed for flown in known)
