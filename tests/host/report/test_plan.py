"""The page of a plan and that of a trade: what is told, from the finished reference alone."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

from host.effects import load_effects
from host.models.region import Region
from host.plan import Plan, ResidualModel, plan
from host.plan.pareto import Point
from host.plan.profile import profile
from host.plan.table import from_reference
from host.report import plan_figures
from host.report.plan import page, trade_page
from host.route import Gate, Route
from host.route.shapes import Box, Cylinder, Sphere
from host.vehicle import load_vehicle

VEHICLE = load_vehicle("research")
MODEL = ResidualModel(
    parts=((load_effects()["linear-drag"], (0.5, 0.4, 0.1)),),
    region=Region(speed_max_m_s=1.0, tilt_max_deg=90.0, thrust_min_n=0.0, thrust_max_n=100.0),
)
ROUTE = Route(
    name="around",
    waypoints_m=((0.0, 0.0, -1.2), (3.0, 1.0, -1.8), (0.0, 3.0, -1.2)),
    total_time_s=8.0,
    keep_out=(
        Cylinder(kind="cylinder", centre_m=(-1.5, 2.0), radius_m=0.3, down_m=(-3.0, 0.0)),
        Sphere(kind="sphere", centre_m=(1.0, -2.0, -1.5), radius_m=0.5),
        Box(kind="box", min_m=(-2.0, -2.0, -1.2), max_m=(-1.4, -1.0, -0.1)),
    ),
)
SNAP: Any = {"kind": "min-snap", "plan": None, "solve_s": 0.1, "factor": None}
BARE: Any = {"jerk_rms_m_s3": None, "tilt_max_deg": None, "thrust_share_max": None}


@pytest.fixture(scope="module")
def made() -> Plan:
    return plan(ROUTE, VEHICLE, kind="min-snap", model=MODEL)


def data(html: str) -> dict[str, Any]:
    (text,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', html)
    return json.loads(text)


def test_plan_page_has_two_pictures_every_margin_and_nothing_from_elsewhere(made: Plan) -> None:
    html = page(made, ROUTE, VEHICLE, MODEL, {"version": "1"})
    assert "<title>around: min-snap " in html
    assert html.count("<img ") == 2
    assert not re.search(r'(src|href)="(?!data:)', html)
    names = (
        "geofence",
        "floor",
        "speed",
        "tilt",
        "body rate",
        "jerk",
        "least rotor thrust",
        "keep-out shapes",
    )
    rows = dict(re.findall(r"<tr><td>([^<]+)</td>(.*)</tr>", html))
    assert set(names) < set(rows)
    assert f">{made.margins['speed_m_s']:.3g}<" in rows["speed"]
    assert f">{made.margins['keep_out_m']:.3g}<" in rows["keep-out shapes"]
    assert "minimum-snap spline" in rows["status"]
    assert "8.000 s" in rows["time"]
    assert "m/s^2 RMS" in rows["predicted residual"]
    assert f"{100.0 * (made.outside_region or 0.0):.1f} %" in html
    told = data(html)
    assert told["id"] == made.reference.id
    assert "solve_s" not in told


def test_plan_page_of_the_same_plan_is_the_same_bytes(made: Plan) -> None:
    assert page(made, ROUTE, VEHICLE, MODEL, {}) == page(made, ROUTE, VEHICLE, MODEL, {})


def test_plan_page_says_the_solvers_status_in_words() -> None:
    shot = plan(ROUTE, VEHICLE, kind="min-residual", model=MODEL)
    html = page(shot, ROUTE, VEHICLE, MODEL, {})
    assert f"the solver converged: {shot.iterations} iterations in" in html
    assert "greatest distance from the solver&#39;s path" in html


def test_plan_page_without_a_model_colours_by_speed_and_says_what_is_not_known(made: Plan) -> None:
    bare = plan(ROUTE, VEHICLE)
    html = page(bare, ROUTE, VEHICLE, ResidualModel(), {})
    assert "coloured by speed" in html
    assert "no model predicts any" in html
    assert "coloured by predicted residual" in page(made, ROUTE, VEHICLE, MODEL, {})


def test_plan_pictures_say_how_far_it_goes(made: Plan) -> None:
    along = profile(VEHICLE, MODEL, from_reference(made.reference), made.reference.yaw_nodes())
    over_time = plan_figures.over_time(made, along)
    assert f"speed up to {along.speed_m_s.max():.2f} m/s" in over_time.alt
    assert "Grey" in over_time.caption
    assert "keep-out" in plan_figures.path(made, ROUTE, along).caption


def test_trade_page_has_a_row_for_every_plan_and_the_reason_of_one_that_failed(made: Plan) -> None:
    known = {"jerk_rms_m_s3": 9.0, "tilt_max_deg": 30.0, "thrust_share_max": 0.3, "solve_s": 0.5}
    points = [
        Point(status="refused", reason="tilt <b> above", **SNAP, **BARE),
        Point(kind="min-residual", factor=0.3, status="solved", reason=None, plan=made, **known),
    ]
    html = trade_page(points, ROUTE, {})
    assert html.count("<img ") == 1
    assert "tilt &lt;b&gt; above" in html
    assert "<td>min-residual x 0.3</td>" in html
    assert [point["status"] for point in data(html)["points"]] == ["refused", "solved"]


def test_trade_without_any_plan_is_drawn_empty() -> None:
    point = Point(status="refused", reason="no way", **SNAP, **BARE)
    assert "no plan was found" in plan_figures.trade([point]).alt


def test_page_of_a_route_with_gates_tells_how_far_inside_they_are_passed() -> None:
    route = Route(
        name="gated",
        waypoints_m=((-1.6, -0.9, -1.2), (1.7, 1.2, -1.6), (0.0, 2.4, -2.0)),
        total_time_s=4.0,
        gates=(Gate(waypoint=1, radius_m=0.3),),
    )
    gated = plan(route, VEHICLE, kind="min-control")
    assert "edges of gates" in page(gated, route, VEHICLE, ResidualModel(), {})
