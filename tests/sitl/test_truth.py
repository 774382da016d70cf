"""The truth record says what the world held."""

from __future__ import annotations

import json

from trimtab.host.vehicle import load_vehicle
from trimtab.sitl.seeds import session_uid
from trimtab.sitl.vehicle import SimulatedVehicle


def test_truth_names_uid_world_seed_and_drawn_values() -> None:
    vehicle = SimulatedVehicle.create(load_vehicle("research"), world="drawn", world_seed=12, flight=3)
    truth = vehicle.truth()
    assert json.loads(json.dumps(truth)) == truth
    assert truth["uid"] == f"{session_uid(12, 3):016x}"
    assert (truth["world"], truth["world_seed"], truth["flight"]) == ("drawn", 12, 3)
    assert 1 <= len(truth["effects"]) <= 3
    assert "mass.factor" in truth["deviations"]
    vehicle.power_cycle(4)
    assert vehicle.truth()["uid"] == f"{session_uid(12, 4):016x}"
    assert vehicle.truth()["effects"] == truth["effects"]
