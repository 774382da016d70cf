"""Short references and an airfield, for the tests of the demo."""

from __future__ import annotations

import pytest

from trimtab.host.apps.demo.flights import Airfield
from trimtab.host.apps.demo.routes import DemoRoutes
from trimtab.host.plan import plan
from trimtab.host.route import Route, YawProfile, random_route
from trimtab.host.vehicle import Vehicle, load_vehicle
from trimtab.protocol.blobs import Reference

BOX = ((-3.0, 3.0), (-3.0, 3.0), (-2.8, -1.0))
WORLD_SEED = 4_611_686_018_427_387_847


@pytest.fixture(scope="session")
def vehicle() -> Vehicle:
    return load_vehicle("research")


@pytest.fixture(scope="session")
def hop(vehicle: Vehicle) -> Reference:
    """Two metres in two seconds."""
    route = Route(name="hop", waypoints_m=((0.0, 0.0, -1.0), (2.0, 0.0, -1.2)), total_time_s=2.0)
    return plan(route, vehicle).reference


@pytest.fixture(scope="session")
def airfield(vehicle: Vehicle) -> Airfield:
    return Airfield(vehicle=vehicle, world="drawn-several", world_seed=WORLD_SEED, session={"seed": "5"})


@pytest.fixture(scope="session")
def short_routes() -> DemoRoutes:
    """Two routes of some seconds to learn from, one turning and one fast, and a third."""

    def route(name: str, seed: int, time_s: float, turn_deg: float) -> Route:
        yaw = YawProfile(yaw_deg=(0.0, turn_deg), times_s=(0.0, time_s)) if turn_deg else YawProfile()
        drawn = random_route(seed, count=5, box_m=BOX, leg_min_m=2.5, yaw=yaw, total_time_s=time_s)
        return drawn.model_copy(update={"name": name})

    return DemoRoutes(
        learning=(route("turning", 1, 7.0, 270.0), route("fast", 2, 5.0, 0.0)),
        held_out=(route("unseen", 3, 6.0, 90.0),),
    )
