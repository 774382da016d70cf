"""The truth record says what the world held, and is written whole."""

from __future__ import annotations

import json
from pathlib import Path

from host.vehicle import load_vehicle
from sitl.seeds import session_uid
from sitl.truth import write_truth
from sitl.vehicle import SimulatedVehicle


def test_truth_names_uid_world_seed_and_drawn_values(tmp_path: Path) -> None:
    vehicle = SimulatedVehicle.create(load_vehicle("research"), world="drawn", world_seed=12, flight=3)
    truth = vehicle.truth()
    path = tmp_path / "flight.truth.json"
    write_truth(path, truth, log_id="0123456789ab")
    record = json.loads(path.read_text())
    assert record["uid"] == f"{session_uid(12, 3):016x}"
    assert (record["world"], record["world_seed"], record["flight"]) == ("drawn", 12, 3)
    assert record["effects"] == truth["effects"]
    assert 1 <= len(record["effects"]) <= 3
    assert record["deviations"]["mass.factor"] == truth["deviations"]["mass.factor"]
    assert record["log"] == "0123456789ab"
    assert [p.name for p in tmp_path.iterdir()] == ["flight.truth.json"]
