"""The study of corrections: its worlds, its figures, and that it flies and resumes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from trimtab.host.base.errors import UsageError
from trimtab.sitl.kinds import DRAG
from trimtab.sitl.studies import correction
from trimtab.sitl.studies.flights import Programme
from trimtab.sitl.studies.scoring.correction import cells, lines, pose_age_s, ratio, summary, world_cells
from trimtab.sitl.world import load_world


def flight(rmse_m: float, *, whole: bool = True, faded_s: float | None = 0.0) -> dict[str, Any]:
    return {"whole": whole, "rmse_m": rmse_m, "stamped_rmse_m": 2.0 * rmse_m, "faded_s": faded_s}


def score(*ratios: float | None, verdict: str = "traced") -> dict[str, Any]:
    """Return the score of a world with these ratios of the traced model; None for an early end."""
    pairs = [
        {"uncorrected": flight(0.1), "traced": flight(0.1 * (r or 1.0), whole=r is not None)} for r in ratios
    ]
    models = {"traced": {"id": "a", "verdict": verdict, "corrected": {}}, "learned": {"verdict": None}}
    return {"effects": {"wind": {}}, "models": models, "flights": pairs}


def test_worlds_hold_two_or_three_common_effects_and_wind_only_with_a_drag() -> None:
    worlds = [correction.planned_world(7, index) for index in range(60)]
    draw = load_world("drawn-several")[1].draw
    assert draw is not None
    assert {kind for world in worlds for kind in world.kinds} == set(draw.kinds)
    assert {len(set(world.kinds)) for world in worlds} == {2, 3}
    assert all(set(DRAG) & set(world.kinds) for world in worlds if "wind" in world.kinds)
    assert len({world.seed for world in worlds}) == 60
    assert correction.planned_world(7, 3) == correction.planned_world(7, 3)
    assert not any(world.is_measured for world in worlds)


def test_ratio_is_one_without_a_feedforward_and_infinite_for_a_flight_that_it_ends() -> None:
    assert ratio({"uncorrected": flight(0.1), "traced": flight(0.03)}, "traced") == pytest.approx(0.3)
    assert ratio({"uncorrected": flight(0.1)}, "traced") == 1.0
    assert ratio({"uncorrected": flight(0.1), "traced": flight(0.1, whole=False)}, "traced") == float("inf")
    assert ratio({"uncorrected": flight(0.1, whole=False), "traced": flight(0.1)}, "traced") is None


def test_summary_counts_flights_that_a_correction_made_worse_or_ended() -> None:
    scores = {"0000": score(0.2, 0.3), "0001": score(0.4, 1.2, verdict="undecided"), "0002": score(0.3, None)}
    traced, learned = (summary(scores, 1)[model] for model in ("traced", "learned"))
    assert (traced["flights"], traced["worse"], traced["failed"]) == (6, 2, 1)
    assert traced["ratio_median"] == pytest.approx(0.35)
    assert traced["ratio_worst"] is None
    assert traced["ratio_by_world"] == {"0000": pytest.approx(0.25), "0001": pytest.approx(0.8), "0002": None}
    assert (traced["stamped_worse"], traced["stamped_ratio_median"]) == (2, pytest.approx(0.35))
    assert (traced["undecided_worlds"], traced["uncorrected_worlds"]) == (1, 0)
    assert (learned["ratio_median"], learned["uncorrected_worlds"]) == (1.0, 3)
    assert cells(summary(scores, 1))[0]["worst"] == "failed"
    assert "2 of 6 above 1" in lines(summary(scores, 1))[0]
    assert [row["traced, ratio"] for row in world_cells(scores)][2] == "0.30 failed"


def test_interval_is_a_point_for_worlds_that_agree_and_none_for_one_world() -> None:
    alike = summary({str(k): score(0.3, 0.3) for k in range(4)}, 1)["traced"]
    assert alike["ratio_interval"] == [pytest.approx(0.3)] * 2
    spread = summary({str(k): score(0.1 * k, 0.1 * k) for k in range(1, 6)}, 1)["traced"]
    low, high = spread["ratio_interval"]
    assert low < spread["ratio_median"] < high
    assert summary({"0": score(0.3)}, 1)["traced"]["ratio_interval"] is None


def test_age_of_poses_is_the_effect_or_the_deviation_of_the_build() -> None:
    deviations = {"mocap-latency.latency_s": 0.001}
    drawn = {"mocap-latency": {"latency_s": 0.02}}
    assert pose_age_s({"effects": drawn, "deviations": deviations}) == 0.02
    assert pose_age_s({"effects": {}, "deviations": deviations}) == 0.001
    assert pose_age_s({"effects": {}, "deviations": {}}) == 0.0


def test_no_world_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--worlds 0"):
        correction.run(folder=tmp_path, seed=1, vehicle="research", jobs=1, worlds=0)


@pytest.mark.long
@pytest.mark.full  # flies, traces and learns
def test_study_flies_corrections_and_resumes(tmp_path: Path, short_programme: Programme) -> None:
    def run() -> dict[str, Any]:
        return correction.run(
            folder=tmp_path, seed=9102, vehicle="research", jobs=1, quick=True, programme=short_programme
        )

    first = run()
    assert first["answer"]["traced"]["flights"] == len(correction.HELD_OUT)
    assert (tmp_path / "worlds" / "0000" / "models" / "traced.ff").is_file()
    assert not list((tmp_path / "worlds" / "0000" / "models").glob("*truth*"))
    logs = {path: path.stat().st_mtime_ns for path in tmp_path.glob("worlds/*/*/*.mcap")}
    assert run() == first
    assert {path: path.stat().st_mtime_ns for path in logs} == logs
