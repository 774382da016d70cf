"""What the demo does with what it traced: nothing to plan around, and what may fail on the way."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import pytest

from trimtab.host import cli
from trimtab.host.apps.demo import session
from trimtab.host.apps.demo.files import JSON_NAME, REPORT_NAME
from trimtab.host.apps.demo.flights import Airfield
from trimtab.host.apps.demo.routes import DemoRoutes
from trimtab.host.apps.demo.session import DemoRequest, Outcome, run_demo
from trimtab.host.base.errors import FlightFailed, SolverError
from trimtab.host.base.workers import workers
from trimtab.host.effects import load_effects
from trimtab.host.trace import words
from trimtab.host.vehicle import Vehicle

pytestmark = pytest.mark.xdist_group("demo")

STRONG_BUT_SAGGING = """
description = "For a test: more thrust than the file says, and a battery that takes it away again"
tolerances = true

[effects.thrust-gain]
gain = 1.09

[effects.battery-sag]
exponent = 1.8
"""
DRAG = """
description = "For a test: drag, and poses in time"
tolerances = true

[effects.linear-drag]
dx = 0.45
dy = 0.35
dz = 0.15
"""
SILENT = (
    DRAG
    + """
[mocap]
gaps_s = [[6.0, 60.0]]
"""
)


def run(world: str, folder: Path, vehicle: Vehicle, routes: DemoRoutes) -> Outcome:
    path = folder / "world.toml"
    path.write_text(world, encoding="utf-8")
    order = DemoRequest(vehicle=vehicle, folder=folder / "demo", seed=8, world=str(path), routes=routes)
    with workers(1) as pool:
        return run_demo(order, load_effects(), pool)


def test_demo_without_drag_applies_the_thrust_at_the_battery_there_is_to_the_first_plan(
    tmp_path: Path, vehicle: Vehicle, short_routes: DemoRoutes
) -> None:
    outcome = run(STRONG_BUT_SAGGING, tmp_path, vehicle, short_routes)
    answer, comparison = outcome.answer, outcome.comparison
    assert {effect["name"] for effect in answer["effects"]} == {"thrust-gain", "battery-sag"}
    assert answer["tracking_rmse_new_plan_m"] is None
    assert "not a drag" in answer["comparison"]["no_new_plan"]
    assert comparison.applied is not None
    assert comparison.applied.label == "first plan, effects applied"
    assert comparison.applied.planned is comparison.first[0].planned
    # The gain alone, without the sag, would more than double the error; the battery differs by flight.
    assert answer["tracking_rmse_applied_m"] < 0.8 * answer["tracking_rmse_first_m"]
    assert outcome.failure is None


@pytest.mark.full  # the other demos show the report
def test_demo_whose_second_plan_and_flight_fail_still_reports(
    tmp_path: Path, vehicle: Vehicle, short_routes: DemoRoutes, monkeypatch: pytest.MonkeyPatch
) -> None:
    silent = tmp_path / "silent.toml"
    silent.write_text(SILENT, encoding="utf-8")
    fly = Airfield.fly

    def fly_blind_with_effects(
        field: Airfield, *asked: Any, feedforward: Any = None, **asked_too: Any
    ) -> Any:
        there = field if feedforward is None else dataclasses.replace(field, world=str(silent))
        return fly(there, *asked, feedforward=feedforward, **asked_too)

    def plan_nothing(*_: Any) -> Any:
        raise SolverError("fast planned again with the traced model: no way")

    monkeypatch.setattr(Airfield, "fly", fly_blind_with_effects)
    monkeypatch.setattr(session, "plan_again", plan_nothing)
    outcome = run(DRAG, tmp_path, vehicle, short_routes)
    answer = outcome.answer
    assert answer["verdict"] == "traced"
    assert answer["tracking_rmse_new_plan_m"] is answer["tracking_rmse_applied_m"] is None
    reasons = answer["comparison"]
    assert reasons["no_new_plan"] == "fast planned again with the traced model: no way"
    assert "failsafe" in reasons["no_applied"]
    assert str(tmp_path) not in reasons["no_applied"]
    assert isinstance(outcome.failure, SolverError)
    assert json.loads((tmp_path / "demo" / JSON_NAME).read_text())["comparison"] == reasons
    assert "ended in failsafe" in (tmp_path / "demo" / REPORT_NAME).read_text()


def test_demo_verb_after_a_second_flight_that_failed_answers_and_ends_with_its_exit_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    answer = {
        "verdict": "traced",
        "report": "demo.html",
        "truth": "truth.html",
        "tracking_rmse_first_m": 0.1,
        "tracking_rmse_new_plan_m": None,
        "tracking_rmse_applied_m": None,
        "comparison": {"route": "sprint", "flights": [], "no_new_plan": "a", "no_applied": "b"},
    }

    def failed(*_: Any, **__: Any) -> Outcome:
        nothing: Any = None
        told: Any = None
        error = FlightFailed("flight 11: the flight ended in failsafe: tilt")
        return Outcome(result=told, comparison=nothing, answer=answer, steps=(), failure=error)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(session, "run_demo", failed)
    monkeypatch.setattr(words, "result_lines", lambda result: [])
    assert cli.main(["demo", "--json"]) == 1
    told = capsys.readouterr()
    assert json.loads(told.out.splitlines()[-1])["verdict"] == "traced"
    assert "ended in failsafe" in told.err
