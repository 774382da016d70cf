"""The solver's box: tightened by what the finished reference exceeds a limit by."""

from __future__ import annotations

import pytest

from trimtab.host.plan import plan
from trimtab.host.plan.box import SolverBox
from trimtab.host.route import Route
from trimtab.host.vehicle import load_vehicle

VEHICLE = load_vehicle("research")


def test_box_knows_the_floor_once_a_reference_went_below_it() -> None:
    box = SolverBox.inside(VEHICLE.limits)
    assert box.tightened({"floor_m": 1.0}).floor_m == box.floor_m
    once = box.tightened({"floor_m": -0.12})
    assert once.floor_m == 0.0
    assert once.tightened({"floor_m": 0.2}).floor_m == 0.0
    assert once.tightened({"floor_m": -0.01}).floor_m == pytest.approx(0.014)


def test_min_control_between_low_waypoints_stays_above_the_floor() -> None:
    """Unbounded it would sag 0.12 m below the floor, still inside the geofence."""
    waypoints = ((0.0, 0.0, -1.0), (1.0, 0.0, -0.1), (3.0, 0.0, -0.1), (4.0, 0.0, -1.0))
    made = plan(Route(name="low", waypoints_m=waypoints, total_time_s=5.0), VEHICLE, kind="min-control")
    assert 0.0 <= made.margins["floor_m"] < 0.1
