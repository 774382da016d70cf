"""Short references and an airfield, for the tests of the demo."""

from __future__ import annotations

import pytest

from host.demo.flights import Airfield
from host.plan import plan
from host.route import Route
from host.vehicle import Vehicle, load_vehicle
from protocol.blobs import Reference

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
