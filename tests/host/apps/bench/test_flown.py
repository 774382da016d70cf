"""What `trimtab bench` says of flights: the study's comparison, ratios over the right kinds, failures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from trimtab.host.apps.bench import flown
from trimtab.host.apps.paper.planning import compare
from trimtab.host.vehicle import Vehicle, load_vehicle

VEHICLE = load_vehicle("research")
SIZE = flown.Size(worlds=2, courses=2)


def made_up(error_m: float) -> dict[str, Any]:
    """Figures of a plan that nobody made and a flight that nobody flew."""
    return {
        "residual_mean_m_s2": 10.0 * error_m,
        "error_mean_m": error_m,
        "clipped_share": 0.0,
        "path_length_m": 30.0,
        "mean_speed_m_s": 3.0,
    }


ERRORS_M = {"min-snap": 0.2, "min-control": 0.16, "min-residual": 0.1}


def world(folder: Path, vehicle: Vehicle, seed: int, number: int, courses: int, **how: Any) -> dict[str, Any]:
    """A world in which every course goes as the last."""
    assert folder.parent.is_dir()
    for step in range(courses + 1):
        how["on_progress"](f"{number} {step}")
    kinds = {kind: made_up(ERRORS_M[kind]) for kind in how["kinds"]}
    return {"courses": [{"course": f"{number}-{k}", "kinds": kinds} for k in range(courses)]}


def test_ratios_are_over_min_snap_and_min_control(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flown, "flown", world)
    heard: list[str] = []
    found = flown.measure(VEHICLE, 5, heard.append, size=SIZE)
    assert len(set(heard)) == len(heard) == SIZE.steps
    assert (found["courses"], found["seed"], found["failures"]) == (4, 5, [])
    assert found["residual_ratio"] == found["error_ratio"] == pytest.approx(0.5)
    assert found["error_ratio_ci95"] == pytest.approx([0.5, 0.5])
    assert found["error_ratio_min_control"] == pytest.approx(0.625)
    assert found["length_ratio"] == pytest.approx(1.0)
    assert found["kinds"]["min-control"]["error_mean_m"] == pytest.approx(0.16)


def test_course_without_a_plan_is_told_and_not_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    def refusing(*of: Any, **how: Any) -> dict[str, Any]:
        courses = world(*of, **how)["courses"]
        courses[0]["kinds"] = {**courses[0]["kinds"], "min-residual": {"failed": "no way"}}
        courses[1]["kinds"] = {**courses[1]["kinds"], "min-residual": {"flight_failed": "it fell"}}
        return {"courses": courses}

    monkeypatch.setattr(flown, "flown", refusing)
    found = flown.measure(VEHICLE, 5, size=flown.Size(worlds=1, courses=2))
    assert found["failures"] == ["0-0, min-residual: no way", "0-1, min-residual: it fell"]
    assert found["error_ratio"] is None
    assert found["kinds"]["min-residual"]["flights"] == 0
    assert found["kinds"]["min-snap"]["flights"] == 2


def test_sizes_fly_twenty_courses_or_four() -> None:
    assert (flown.Size().worlds * flown.Size().courses, flown.QUICK.worlds * flown.QUICK.courses) == (20, 4)


@pytest.mark.long
@pytest.mark.full
def test_min_residual_is_flown_closer_than_min_snap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compare, "NETWORKS", {"network-body": "body"})
    monkeypatch.setattr(compare, "RESIDUAL_KINDS", ("min-residual",))
    heard: list[str] = []
    found = compare.flown(tmp_path / "w", VEHICLE, 5, 0, 1, kinds=flown.KINDS, on_progress=heard.append)
    (course,) = found["courses"]
    kinds, residuals = course["kinds"], course["residuals"]
    assert tuple(kinds) == flown.KINDS
    assert len(heard) == 2
    for figure in ("residual_mean_m_s2", "error_mean_m"):
        assert kinds["min-residual"][figure] < 0.9 * kinds["min-snap"][figure]
        for name in (compare.CLOSED_FORM, "network-body"):
            assert residuals[name]["min-residual"][figure] < 0.9 * kinds["min-snap"][figure]
