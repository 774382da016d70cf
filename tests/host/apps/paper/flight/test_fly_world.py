"""A whole world of the study, with fewer flights: every part has its figures, and they agree."""

from __future__ import annotations

import pytest

from trimtab.host.apps.paper.flight import courses, world
from trimtab.host.apps.paper.flight.controllers import BASELINE, NEURAL, NEURAL_OBSERVER, OBSERVER
from trimtab.host.apps.paper.flight.summary import summary
from trimtab.host.vehicle import load_vehicle

VEHICLE = load_vehicle("research")


@pytest.mark.full  # minutes
def test_fly_world_measures_every_set_and_controller(tmp_path, monkeypatch):
    monkeypatch.setattr(courses, "PATHS", 1)
    monkeypatch.setattr(courses, "OOD_PACES", courses.OOD_PACES[:1])
    monkeypatch.setattr(world, "TEST_FLIGHTS", 1)
    found = world.fly_world(tmp_path / "w", VEHICLE, 9101, world=0, pretzels=1, epochs=5)
    assert found["flights"] == {"train": 3, "test": 1, "ood": 1}
    assert found["failed"] == []
    assert set(found["controllers"]) == {BASELINE, OBSERVER, NEURAL, NEURAL_OBSERVER}
    assert found["controllers"][BASELINE] == found["errors"]["test"]
    test = found["errors"]["test"]
    nominal_m, ours_m = (test[name]["flights"]["position_rmse_m"] for name in ("nominal", "ours"))
    assert ours_m < 0.6 * nominal_m
    # Remark 1: what the observer leaves is predicted better than without the residual.
    observed = found["controllers"][OBSERVER]
    assert observed["ours"]["flights"]["position_rmse_m"] < observed["nominal"]["flights"]["position_rmse_m"]
    assert len(found["pretzel"]["flights"]) == 6
    by_law = {f["controller"]: f["error_mean_m"] for f in found["pretzel"]["flights"] if "-snap" in f["kind"]}
    assert by_law["neural-do"] < by_law["do"] < by_law["baseline"]
    outcome = summary({}, {"world-00": {"result": found}})
    assert outcome["answer"]["prediction_ratio"]["test"] == pytest.approx(ours_m / nominal_m)
