"""A whole world of the study, with fewer flights: every part has its figures, and they agree."""

from __future__ import annotations

import pytest

from trimtab.host.apps.paper.flight import courses, world
from trimtab.host.apps.paper.flight.controllers import (
    BASELINE,
    MPC,
    MPC_L1,
    MPC_NEURAL,
    NEURAL,
    NEURAL_OBSERVER,
    OBSERVER,
)
from trimtab.host.apps.paper.flight.models import AHEAD, AHEAD_SAME_TORQUE, FLIGHTS
from trimtab.host.apps.paper.flight.summary import summary
from trimtab.host.vehicle import load_vehicle

VEHICLE = load_vehicle("research")


@pytest.mark.long
@pytest.mark.full
def test_fly_world_measures_every_set_and_controller(tmp_path, monkeypatch):
    monkeypatch.setattr(courses, "PATHS", 1)
    monkeypatch.setattr(courses, "OOD_PACES", courses.OOD_PACES[:1])
    monkeypatch.setattr(world, "TEST_FLIGHTS", 1)
    found = world.fly_world(tmp_path / "w", VEHICLE, 9101, world=0, pretzels=1, epochs=5)
    assert found["flights"] == {"train": 3, "test": 1, "ood": 1}
    assert found["failed"] == []
    horizons = {law: list(errors["nominal"]) for law, errors in found["controllers"].items()}
    assert horizons == {
        **{law: [FLIGHTS, AHEAD, AHEAD_SAME_TORQUE] for law in (BASELINE, OBSERVER, NEURAL, NEURAL_OBSERVER)},
        **{law: [AHEAD, AHEAD_SAME_TORQUE] for law in (MPC, MPC_L1, MPC_NEURAL)},
    }
    for name, errors in found["controllers"][BASELINE].items():
        assert errors[FLIGHTS] == found["errors"]["test"][name][FLIGHTS]
    test = found["errors"]["test"]
    nominal, ours = (test[name]["flights"]["position_rmse_m"] for name in ("nominal", "ours"))
    assert ours < 0.6 * nominal
    # Remark 1: what the observer leaves is predicted better than without the residual, as is every flight.
    observed = found["controllers"][OBSERVER]
    assert observed["ours"][FLIGHTS]["position_rmse_m"] < observed["nominal"][FLIGHTS]["position_rmse_m"]
    for errors in found["controllers"].values():
        for horizon in (AHEAD, AHEAD_SAME_TORQUE):
            nominal_m, ours_m = (errors[name][horizon]["position_rmse_m"] for name in ("nominal", "ours"))
            assert ours_m < nominal_m  # by how much three training flights do not say
    assert len(found["pretzel"]["flights"]) == 6
    by_law = {f["controller"]: f["error_mean_m"] for f in found["pretzel"]["flights"] if "-snap" in f["kind"]}
    assert by_law["neural-do"] < by_law["do"] < by_law["baseline"]
    outcome = summary({}, {"world-00": {"result": found}})
    assert outcome["answer"]["prediction_ratio"]["test"] == pytest.approx(ours / nominal)
