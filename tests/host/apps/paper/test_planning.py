"""`trimtab study paper-planning`: courses, figures, page and JSON; what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.narrowing import not_none
from trimtab.host.apps.paper.planning import compare
from trimtab.host.apps.paper.planning.courses import draw_course
from trimtab.host.apps.paper.planning.study import COURSES, PLANNED, WORLDS, plan_pieces
from trimtab.host.apps.paper.planning.summary import summary
from trimtab.host.cli import main
from trimtab.host.effects import load_effects
from trimtab.host.log import read_flight
from trimtab.host.plan import plan
from trimtab.host.vehicle import load_vehicle

pytestmark = pytest.mark.usefixtures("virtual_machine")

DATA = Path(__file__).parent.parent.parent.parent / "data"
VEHICLE = load_vehicle("research")


def made_up_row(factor: float) -> dict:
    """Figures of a plan that nobody made and a flight that nobody flew."""
    return {
        "residual_mean_m_s2": 1.5 * factor,
        "drag_mean_n": 1.4 * factor,
        "solve_s": 0.2,
        "first_solve_s": 0.1 / factor,
        "iterations": 30,
        "rounds": 2,
        "path_length_m": 36.0,
        "mean_speed_m_s": 3.6,
        "acceleration_max_m_s2": 9.0,
        "jerk_max_m_s3": 30.0 / factor,
        "jerk_mean_m_s3": 10.0,
        "outside_region": 0.0,
        "error_mean_m": 0.1 * factor**2,
        "error_rmse_m": 0.12 * factor,
        "error_max_m": 0.2 * factor,
        "clipped_share": 0.0,
    }


FACTORS = dict(zip(compare.KINDS, (1.0, 0.95, 0.95, 0.9, 0.6, 0.7), strict=True))


def made_up_pieces() -> dict:
    course = {"course": "c", "duration_s": 10.0, "kinds": {k: made_up_row(f) for k, f in FACTORS.items()}}
    residuals = {
        what: {kind: made_up_row(factor) for kind in compare.RESIDUAL_KINDS}
        for what, factor in ((compare.CLOSED_FORM, 0.6), ("network-body", 0.5), ("network-world", 0.8))
    }
    flown = {**course, "residuals": residuals}
    pieces = {f"planned-{k:02d}": {"result": course} for k in range(2)}
    pieces["world-00"] = {"result": {"world": 0, "kept": "effects", "courses": [flown, flown]}}
    return pieces


def test_course_is_flown_by_min_snap_in_its_time():
    course = draw_course(VEHICLE, 3, 0, "test")
    assert min(course.snap.margins.values()) >= 0.0
    assert course.route.duration_s == pytest.approx(course.snap.duration_s)
    assert draw_course(VEHICLE, 3, 0, "test").snap.reference.id == course.snap.reference.id
    assert draw_course(VEHICLE, 3, 1, "test").route.waypoints_m != course.route.waypoints_m


def test_stretched_course_may_be_planned_again_in_its_time():
    # The first route that is drawn here is refused in its stretched time, with durations optimised for it.
    course = draw_course(VEHICLE, 9300, 0, "labels-training-world-00")
    assert plan(course.route, VEHICLE).duration_s == pytest.approx(course.snap.duration_s)


def test_planned_course_has_every_kind_and_less_drag_with_min_residual(monkeypatch):
    monkeypatch.setattr(compare, "NODES", 100)
    found = compare.planned(VEHICLE, 3, 0)
    drag = {kind: row["drag_mean_n"] for kind, row in found["kinds"].items()}
    assert set(drag) == set(compare.KINDS)
    assert drag["min-residual"] < 0.9 * drag["min-snap"]


def test_residual_models_hold_the_drag_as_a_closed_form_or_a_network_and_the_torque_alike():
    found = compare.residual_models([read_flight(DATA / "a1.mcap")], load_effects())
    assert set(found) == {compare.CLOSED_FORM, *compare.NETWORKS}
    names = {what: [effect.name for effect, _ in model.parts] for what, model in found.items()}
    assert sorted(names.pop(compare.CLOSED_FORM)) == ["com-offset", "linear-drag"]
    assert all(each == ["com-offset"] for each in names.values())
    assert found[compare.CLOSED_FORM].network is None
    frames = {what: not_none(found[what].network).layout.frame for what in compare.NETWORKS}
    assert frames == {"network-body": "body", "network-world": "world"}


def test_summary_gives_ratios_with_bootstraps_and_the_paper_s_claims():
    outcome = summary({"study": "paper-planning"}, made_up_pieces())
    ratio = outcome["answer"]["ratios"]["min-snap"]["min-residual"]
    assert ratio["error"]["median"] == pytest.approx(0.36)
    np.testing.assert_allclose(ratio["error"]["ci95"], 0.36)
    assert (ratio["error"]["courses"], ratio["error"]["better"]) == (2, 2)
    said = [row[""] for row in outcome["tables"]["The paper's claims"]]
    assert said == ["not confirmed", "not confirmed", "confirmed", "not confirmed", "confirmed"]
    assert outcome["answer"]["failed"] == []


def test_summary_sets_the_closed_form_beside_each_network_on_the_same_courses():
    outcome = summary({}, made_up_pieces())
    found = outcome["answer"]["closed_form"]["min-residual"]
    assert found["flown"]["closed-form"]["error_mean_m"] == pytest.approx(0.036)
    assert found["ratios"]["network-body"]["error"]["median"] == pytest.approx(1.44)
    assert found["ratios"]["network-world"]["error"]["median"] == pytest.approx(0.5625)
    assert found["ratios"]["network-world"]["solve"]["median"] == pytest.approx(0.8 / 0.6)
    rows = outcome["tables"]["Closed form in place of the network, the same held-out courses"]
    assert [row["flights"] for row in rows] == ["2"] * 10
    assert rows[3]["mean error, mm"] == "1.44 (1.44-1.44)"


def test_summary_names_what_failed_with_a_network():
    pieces = made_up_pieces()
    course = pieces["world-00"]["result"]["courses"][0]
    row = {"flight_failed": "tilt"}
    residuals = {**course["residuals"], "network-body": {kind: row for kind in compare.RESIDUAL_KINDS}}
    pieces["world-00"]["result"]["courses"][0] = {**course, "residuals": residuals}
    answer = summary({}, pieces)["answer"]
    assert {"course": "c", "kind": "min-residual*, network-body", "why": "tilt"} in answer["failed"]
    assert answer["closed_form"]["min-residual"]["ratios"]["network-body"]["error"]["courses"] == 1


def test_summary_names_what_failed():
    pieces = made_up_pieces()
    kinds = {**pieces["planned-00"]["result"]["kinds"], "min-residual*": {"failed": "no way"}}
    pieces["planned-00"] = {"result": {**pieces["planned-00"]["result"], "kinds": kinds}}
    answer = summary({}, pieces)["answer"]
    assert answer["failed"] == [{"course": "c", "kind": "min-residual*", "why": "no way"}]
    assert answer["planned"]["min-residual*"]["courses"] == 1


def test_study_goes_on_from_pieces_and_leaves_page_picture_and_json(tmp_path, capsys):
    folder = tmp_path / "study"
    (folder / "pieces").mkdir(parents=True)
    for name, piece in made_up_pieces().items():
        (folder / "pieces" / f"{name}.json").write_text(json.dumps(piece))
    words = ["study", "paper-planning", "--quick", "--seed", "5", "-o", str(folder), "--jobs", "1", "--json"]
    assert main(words) == 0
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert answer["planned"]["min-residual"]["drag_mean_n"] == pytest.approx(0.84)
    assert "1.845" in (folder / "report.html").read_text()
    assert (folder / "courses.png").stat().st_size > 1000
    words[words.index("5")] = "6"
    assert main(words) == 2
    assert "another seed" in capsys.readouterr().err


def test_full_study_flies_twenty_held_out_courses():
    pieces = plan_pieces(WORLDS, COURSES, PLANNED)
    assert sum(piece.arguments["courses"] for piece in pieces if piece.kind == "world") == 20
    assert len({piece.name for piece in pieces}) == len(pieces)
