"""The page of a plan and that of a trade: what is told, from the finished reference alone."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.parts import part
from trimtab.host.models.region import Region
from trimtab.host.plan import Plan, ResidualModel, plan
from trimtab.host.plan.flown import Flown
from trimtab.host.plan.pareto import Point
from trimtab.host.plan.profile import profile
from trimtab.host.plan.sensitivity import sensitivity
from trimtab.host.plan.table import from_reference
from trimtab.host.report import plan_figures, trade_figures
from trimtab.host.report.plan import page, trade_page
from trimtab.host.route import Gate, Route
from trimtab.host.route.shapes import Box, Cylinder, Sphere
from trimtab.host.shooting.problem import SolveStatus
from trimtab.host.vehicle import load_vehicle

VEHICLE = load_vehicle("research")
MODEL = ResidualModel(
    parts=(part("linear-drag", 0.5, 0.4, 0.1),),
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


@pytest.fixture(scope="module")
def html(made: Plan) -> str:
    """The page of that plan."""
    return page(made, ROUTE, VEHICLE, MODEL, {"version": "1"})


def data(html: str) -> dict[str, Any]:
    (text,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', html)
    return json.loads(text)


def shown(html: str) -> dict[str, Any]:
    """What the page draws."""
    (text,) = re.findall(r'<script type="application/json" id="show-data">(.*?)</script>', html)
    return json.loads(text)


def test_plan_page_has_its_path_every_margin_and_nothing_from_elsewhere(made: Plan, html: str) -> None:
    assert "<title>around: min-snap " in html
    assert html.count("<img ") == 1
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


def test_plan_page_of_the_same_plan_is_the_same_bytes(made: Plan, html: str) -> None:
    assert page(made, ROUTE, VEHICLE, MODEL, {"version": "1"}) == html


def test_plan_page_says_the_solvers_status_in_words() -> None:
    shot = plan(ROUTE, VEHICLE, kind="min-residual", model=MODEL)
    html = page(shot, ROUTE, VEHICLE, MODEL, {})
    assert f"{SolveStatus[shot.status.upper()].value}: {shot.iterations} iterations in" in html
    assert "greatest distance from the solver&#39;s path" in html


def test_plan_page_without_a_model_shows_no_residual_and_says_what_is_not_known(html: str) -> None:
    bare = plan(ROUTE, VEHICLE)
    without = page(bare, ROUTE, VEHICLE, ResidualModel(), {})
    assert "none, without a model" in without
    assert "residual" not in shown(without)["tracks"][0]["channels"]
    assert "residual" in shown(html)["tracks"][0]["channels"]


def test_plan_page_shows_waypoints_keep_out_shapes_and_what_the_model_predicts(made: Plan, html: str) -> None:
    along = profile(VEHICLE, MODEL, from_reference(made.reference), made.reference.yaw_nodes())
    ((track,), scene) = (shown(html)[key] for key in ("tracks", "scene"))
    values = np.frombuffer(base64.b64decode(track["channels"]["residual"]["data"]), dtype="<f4")
    assert along.residual_m_s2 is not None
    assert values.max() == pytest.approx(along.residual_m_s2.max(), rel=1e-3)
    assert [point["p"] for point in scene["waypoints"]] == [[n, e, -d] for n, e, d in ROUTE.waypoints_m]
    assert [event["t_s"] for event in track["events"]] == list(made.waypoint_times_s)
    assert sorted(shape["kind"] for shape in scene["keep_out"]) == ["box", "cylinder", "sphere"]


def test_trade_page_has_a_row_for_every_plan_and_the_reason_of_one_that_failed(made: Plan) -> None:
    points = [
        Point(status="refused", reason="tilt <b> above", **SNAP, **BARE),
        Point(
            kind="min-residual",
            factor=0.3,
            status="solved",
            reason=None,
            plan=made,
            jerk_rms_m_s3=9.0,
            tilt_max_deg=30.0,
            thrust_share_max=0.3,
            solve_s=0.5,
        ),
    ]
    html = trade_page(points, ROUTE, {})
    assert html.count("<img ") == 1
    assert "tilt &lt;b&gt; above" in html
    assert "<td>min-residual x 0.3</td>" in html
    assert [point["status"] for point in data(html)["points"]] == ["refused", "solved"]


def test_trade_without_any_plan_is_drawn_empty() -> None:
    point = Point(status="refused", reason="no way", **SNAP, **BARE)
    assert "no plan was found" in trade_figures.trade([point]).alt


def test_trade_page_tells_and_draws_what_flights_came_to(made: Plan, tmp_path: Path) -> None:
    point: Any = partial(
        Point, kind="min-residual", status="solved", reason=None, plan=made, jerk_rms_m_s3=9.0
    )
    rest = {"tilt_max_deg": 30.0, "thrust_share_max": 0.3, "solve_s": 0.5}
    log = tmp_path / "x.mcap"
    points = [
        point(factor=0.3, flown=Flown(log=log, error_mean_m=0.0612, clipped_share=0.0), **rest),
        point(factor=1.0, flown=Flown(log=log, failure="flight 0: tilt"), **rest),
    ]
    html = trade_page(points, ROUTE, {})
    assert "flown once in the same simulated world" in html
    assert ">61.2<" in html
    assert "flight 0: tilt" in html
    picture = trade_figures.trade(points)
    assert picture.alt.endswith("Mean error of the flights in mm: min-residual x 0.3 61.2.")
    assert picture.height > trade_figures.trade([replace(p, flown=None) for p in points]).height


def test_pictures_without_a_model_leave_residual_and_sensitivity_out(made: Plan) -> None:
    table = from_reference(made.reference)
    yaws = made.reference.yaw_nodes()
    off = sensitivity(VEHICLE, MODEL, table, yaws)
    assert off is not None
    told = plan_figures.per_node(made, ROUTE, profile(VEHICLE, MODEL, table, yaws), off, [])
    v, a = off.velocity.max(), off.attitude.max()
    assert f"change up to {v:.2f} per m/s and {a:.2f} per rad" in told.alt
    along = profile(VEHICLE, ResidualModel(), table, yaws)
    bare = plan_figures.per_node(made, ROUTE, along, None, [])
    assert "Sensitivity" in told.caption
    assert "Sensitivity" not in bare.caption
    assert bare.height < told.height
    least = min(values.min() for values in along.margin_shares(made.limits).values())
    assert f"least margin {100.0 * least:.1f} %" in bare.alt


def test_plan_page_names_the_node_of_the_greatest_sensitivity(made: Plan, html: str) -> None:
    off = sensitivity(VEHICLE, MODEL, from_reference(made.reference), made.reference.yaw_nodes())
    assert off is not None
    node = int(off.attitude.argmax())
    wanted = f"{off.attitude[node]:.3g} m/s^2 per rad, node {node} at {off.t_s[node]:.2f} s"
    assert f"<td>its greatest sensitivity to attitude</td><td>{wanted}</td>" in html


GATED = Route(
    name="gated",
    waypoints_m=((-1.6, -0.9, -1.2), (1.7, 1.2, -1.6), (0.0, 2.4, -2.0), (-2.0, 0.0, -1.4)),
    total_time_s=6.0,
    gates=(Gate(waypoint=1, radius_m=0.3), Gate(waypoint=2, width_m=0.8, height_m=0.6, heading_deg=180.0)),
)


def test_page_of_a_route_with_gates_tells_where_the_nearest_edge_is() -> None:
    gated = plan(GATED, VEHICLE, kind="min-control")
    html = page(gated, GATED, VEHICLE, ResidualModel(), {})
    (row,) = re.findall(r"<tr><td>edges of gates</td>(.*)</tr>", html)
    cells = re.findall(r"<td[^>]*>([^<]*)</td>", row)
    times = [f"{gated.waypoint_times_s[k]:.2f}" for k in (1, 2)]
    assert cells[1] == f"{gated.margins['gates_m']:.3g}"
    assert cells[4] in times
    node = gated.reference.nodes[int(cells[3])]
    assert f"{node.t_us * 1e-6:.2f}" == cells[4]
