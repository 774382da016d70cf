"""A plan flown: what the log says of it, and why one was not flown to its end."""

from __future__ import annotations

from pathlib import Path

import pytest

from trimtab.host.apps.demo.flights import Airfield
from trimtab.host.log import read_flight
from trimtab.host.log.tracking import tracking_error
from trimtab.host.plan import Plan, plan
from trimtab.host.plan.flown import fly_plan
from trimtab.host.route import Route
from trimtab.host.vehicle import load_vehicle

VEHICLE = load_vehicle("research")
NO_POSES = """
description = "The cameras fall silent in the air"
tolerances = false

[mocap]
gaps_s = [[6.0, 60.0]]
"""


@pytest.fixture(scope="module")
def hop() -> Plan:
    route = Route(name="hop", waypoints_m=((0.0, 0.0, -1.0), (2.0, 0.0, -1.2)), total_time_s=2.0)
    return plan(route, VEHICLE)


def test_flown_plan_has_the_figures_of_its_log(hop: Plan, tmp_path: Path) -> None:
    field = Airfield(vehicle=VEHICLE, world="quiet", world_seed=7, session={})
    flown = fly_plan(hop, field, flight=3, log=tmp_path / "a.mcap", model_id="0123456789ab")
    flight = read_flight(flown.log)
    off = tracking_error(flight)
    assert off is not None
    assert (flown.error_mean_m, flown.error_rmse_m, flown.error_max_m) == (off.mean_m, off.rmse_m, off.max_m)
    assert 0.0 < off.mean_m < off.max_m < 0.3
    assert flown.clipped_share == 0.0
    assert flown.failure is None
    assert flight.metadata["flight"] == "3"


def test_flown_plan_that_is_not_flown_to_its_end_says_why_and_has_no_figures(
    hop: Plan, tmp_path: Path
) -> None:
    world = tmp_path / "gaps.toml"
    world.write_text(NO_POSES, encoding="utf-8")
    field = Airfield(vehicle=VEHICLE, world=str(world), world_seed=7, session={})
    flown = fly_plan(hop, field, flight=0, log=tmp_path / "a.mcap")
    assert "mocap lost" in (flown.failure or "")
    assert flown.error_mean_m is flown.error_max_m is flown.clipped_share is None
    assert flown.log.is_file()
