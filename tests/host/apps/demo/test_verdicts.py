"""Demos in worlds that hold nothing, or what no effect of the library is."""

from __future__ import annotations

from pathlib import Path

import pytest

from trimtab.host.apps.demo.files import REPORT_NAME, TRUTH_PAGE
from trimtab.host.apps.demo.routes import DemoRoutes
from trimtab.host.apps.demo.session import DemoRequest, Outcome, run_demo
from trimtab.host.base.workers import workers
from trimtab.host.effects import load_effects
from trimtab.host.vehicle import Vehicle


def run(world: str, seed: int, folder: Path, vehicle: Vehicle, routes: DemoRoutes) -> Outcome:
    order = DemoRequest(vehicle=vehicle, folder=folder, seed=seed, world=world, routes=routes)
    with workers(1) as pool:
        return run_demo(order, load_effects(), pool, on_message=lambda _: None)


# In the full run: tracing's own tests have the verdict.
@pytest.mark.full
@pytest.mark.parametrize("world", ["flapping", "tether"])
def test_demo_in_a_world_outside_the_library_says_so_and_adds_nothing(
    world: str, tmp_path: Path, vehicle: Vehicle, short_routes: DemoRoutes
) -> None:
    outcome = run(world, 3, tmp_path, vehicle, short_routes)
    answer, model = outcome.answer, outcome.result.model
    assert answer["verdict"] == "outside-library"
    assert answer["effects"] == []
    assert answer["reasons"]
    # A tether of up to 2.5 m/s^2: what repeats counts from the nominal vehicle, not from a fit gone wild.
    assert outcome.result.residual.force.repeat < 2.5
    assert answer["after"] == answer["before"]
    assert model.effects == {}
    assert model.covariance is None
    assert answer["tracking_rmse_new_plan_m"] is None
    assert outcome.comparison.new_plan is outcome.comparison.applied is None
    page = (tmp_path / REPORT_NAME).read_text()
    assert "Outside the library" in page
    assert answer["reasons"][0] in page
    assert "The verdict is right" in (tmp_path / TRUTH_PAGE).read_text()


# In the full run: the demo goes the same way as above, tracing's own tests have what it says of noise.
# Gusts on a drag within tolerance were once taken for wind at seed 3.
@pytest.mark.full
def test_demo_in_a_world_of_tolerances_and_turbulence_finds_nothing_missing(
    tmp_path: Path, vehicle: Vehicle, short_routes: DemoRoutes
) -> None:
    answer = run("empty", 3, tmp_path, vehicle, short_routes).answer
    assert answer["verdict"] == "nothing-missing"
    assert answer["effects"] == []
    assert "The verdict is right" in (tmp_path / TRUTH_PAGE).read_text()
    assert answer["after"]["position_rmse_m"] < 1.2 * answer["before"]["position_rmse_m"]
