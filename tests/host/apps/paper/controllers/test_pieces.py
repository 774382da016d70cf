"""Pieces of the study: what is flown in each, by flights that nobody flew."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from trimtab.host.apps.demo.flights import Airfield
from trimtab.host.apps.paper.controllers import pieces
from trimtab.host.apps.paper.controllers.design import COURSES, SPEEDS
from trimtab.host.apps.paper.controllers.fly import Course
from trimtab.host.apps.paper.controllers.models import Site
from trimtab.host.apps.paper.controllers.study import QUICK, do, plan_pieces
from trimtab.host.apps.paper.controllers.table import BASELINE_TRAJECTORIES, MIN_ERROR, REGRESSORS, SETS, Set
from trimtab.host.apps.paper.planning.compare import paper_settings
from trimtab.host.plan import Settings
from trimtab.host.vehicle import load_vehicle

VEHICLE = load_vehicle("research")
Flown = list[tuple[Course, Set, Path, tuple[str, ...]]]


@pytest.fixture
def flown(monkeypatch: pytest.MonkeyPatch) -> Flown:
    """Record what pieces would fly."""
    calls: Flown = []

    def site(folder: Path, vehicle: Any, seed: int, world: str, place: str) -> Site:
        field = Airfield(vehicle=vehicle, world=world, world_seed=seed, session={})
        return Site(field=field, models={}, effects={}, selected=place)

    def fly(site: Site, course: Course, chosen: Set, logs: Path, anchors: Any = ()) -> list[dict[str, Any]]:
        calls.append((course, chosen, logs, tuple(anchors)))
        return [{"regressor": chosen.regressor}]

    monkeypatch.setattr(pieces, "learned_site", site)
    monkeypatch.setattr(pieces, "fly_set", fly)
    return calls


def test_balanced_course_flies_three_sets_each_at_a_speed_of_its_own(flown: Flown, tmp_path: Path):
    found = pieces.balanced(tmp_path, tmp_path / "logs", VEHICLE, 3, world=1, course=2)
    fastest = flown[0][0].route.duration_s
    assert [each[0].route.duration_s / fastest for each in flown] == pytest.approx(list(SPEEDS.values()))
    assert len({each[0].route.waypoints_m for each in flown}) == 1
    assert len({each[1] for each in flown}) == 3
    assert len({each[2] for each in flown}) == 3  # logs of one speed do not replace those of another
    assert {each[1].family: each[3] for each in flown} == {
        "dfbc": (MIN_ERROR,),
        "mpc": BASELINE_TRAJECTORIES,
    }
    assert {each[0].settings for each in flown} == {Settings()}
    assert [row["speed"] for row in found["rows"]] == list(SPEEDS)
    assert found["selected"] == "world-01"


def test_flights_of_a_world_have_indices_of_their_own(flown: Flown, tmp_path: Path):
    for course in range(COURSES):
        pieces.balanced(tmp_path, tmp_path, VEHICLE, 3, world=0, course=course)
    indices = [each[0].flight for each in flown]
    assert len(set(indices)) == COURSES * len(SPEEDS)


def test_full_course_flies_every_set_as_the_paper_plans(flown: Flown, tmp_path: Path):
    piece = next(piece for piece in plan_pieces(1, QUICK) if piece.kind == "full")
    found = do(piece, str(tmp_path), vehicle="research", seed=3)
    assert [each[1] for each in flown] == list(SETS)
    assert {(each[0].nodes, each[0].settings) for each in flown} == {(400, paper_settings(VEHICLE))}
    assert {each[0].route.duration_s for each in flown} == {10.0}
    assert (found["setting"], found["selected"]) == ("radio", "tuning-radio")


def test_tuning_course_flies_the_baseline_at_every_speed_with_each_regressor(
    monkeypatch: pytest.MonkeyPatch, flown: Flown, tmp_path: Path
):
    calls: list[tuple[Course, str]] = []

    def fly(site: Site, course: Course, regressor: str, logs: Path) -> list[dict[str, Any]]:
        calls.append((course, regressor))
        return [{"regressor": regressor, "trajectory": MIN_ERROR}]

    monkeypatch.setattr(pieces, "fly_baseline", fly)
    piece = next(piece for piece in plan_pieces(1, QUICK) if piece.kind == "select")
    found = do(piece, str(tmp_path), vehicle="research", seed=3)
    assert not flown
    assert [each[1] for each in calls] == list(REGRESSORS) * len(SPEEDS)
    assert [row["speed"] for row in found["rows"]] == [speed for speed in SPEEDS for _ in REGRESSORS]
    assert {each[0].settings for each in calls} == {Settings()}
    held_out = {pieces.held_out(VEHICLE, 3, "world-00", k).waypoints_m for k in range(COURSES)}
    assert calls[0][0].route.waypoints_m not in held_out
