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


def test_session_at_a_port_has_another_uid_than_the_one_in_lock_step() -> None:
    research = load_vehicle("research")
    served, lockstep = (SimulatedVehicle.create(research, world_seed=2, at_port=at) for at in (True, False))
    assert served.truth() == {**lockstep.truth(), "uid": f"{session_uid(2, 0, at_port=True):016x}"}
    assert served.truth()["uid"] != lockstep.truth()["uid"]
