"""Gates: spheres and openings, and gates that contradict their route."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trimtab.host.route import Gate, Route, check_route, parse_route
from trimtab.host.vehicle import ConfigurationError, load_vehicle

SPHERE = Gate(waypoint=1, radius_m=0.3)
OPENING = Gate(waypoint=1, width_m=0.8, height_m=0.6, heading_deg=90.0)
CENTRE = (2.0, -1.0, -1.5)
ROUTE = """
name = "good"
total_time_s = 6.0
waypoints_m = [[0, 0, -1], [3, 0, -1], [0, 3, -1]]
"""


@pytest.mark.parametrize(
    ("gate", "offset", "inside"),
    [
        (SPHERE, (0.0, 0.0, 0.0), 0.3),
        (SPHERE, (0.0, 0.3, 0.4), -0.2),
        (OPENING, (0.0, 0.0, 0.0), 0.3),
        (OPENING, (0.35, 0.0, 0.1), 0.05),  # its normal points east: width is north
        (OPENING, (0.0, 0.0, -0.4), -0.1),
        (OPENING, (0.1, 0.02, 0.1), 0.18),
    ],
)
def test_distance_inside_a_gate_is_the_hand_computed_one(
    gate: Gate, offset: tuple[float, float, float], inside: float
) -> None:
    assert gate.inside_m(np.add(CENTRE, offset), CENTRE) == pytest.approx(inside, abs=1e-12)


def test_corners_of_an_opening_are_on_its_edge_and_a_sphere_has_none() -> None:
    turned = Gate(waypoint=1, width_m=0.8, height_m=0.6, heading_deg=30.0)
    corners = turned.corners_ned(CENTRE)
    for corner in corners:
        assert turned.inside_m(corner, CENTRE) == pytest.approx(0.0, abs=1e-12)
    sides = np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)
    assert sides == pytest.approx([0.8, 0.6, 0.8, 0.6])
    with pytest.raises(ValueError, match="no corners"):
        SPHERE.corners_ned(CENTRE)


@given(
    offset=st.tuples(*[st.floats(-2.0, 2.0)] * 3),
    heading=st.floats(-360.0, 360.0),
    size=st.floats(0.01, 2.0),
    sphere=st.booleans(),
)
def test_nearest_point_is_inside_by_the_inset_and_its_own_nearest(
    offset: tuple[float, float, float], heading: float, size: float, sphere: bool
) -> None:
    gate = Gate(waypoint=1, radius_m=size)
    if not sphere:
        gate = Gate(waypoint=1, width_m=2.0 * size, height_m=3.0 * size, heading_deg=heading)
    point = gate.nearest(np.add(CENTRE, offset), CENTRE)
    assert gate.inside_m(point, CENTRE) >= min(0.01, 0.1 * size) - 1e-9
    np.testing.assert_allclose(gate.nearest(point, CENTRE), point, atol=1e-12)
    q = gate.frame() @ (point - CENTRE)
    assert (np.linalg.norm(q) if sphere else np.abs(q).max()) <= 1.0 + 1e-9
    assert sphere or abs(q[0]) < 1e-12


def test_route_with_gates_reads_back_equal_and_one_without_does_not_tell_of_them() -> None:
    text = ROUTE + "[[gates]]\nwaypoint = 1\nwidth_m = 0.8\nheight_m = 0.6\nheading_deg = 90\n"
    route = parse_route(text, "r")
    assert route.gates == (OPENING,)
    assert parse_route(route.to_toml(), "again") == route
    plain = parse_route(ROUTE, "r")
    assert plain.gates is None
    assert "gates" not in plain.to_toml()
    assert plain.id != route.id


@pytest.mark.parametrize(
    ("table", "said"),
    [
        (
            "waypoint = 3\nradius_m = 0.3",
            "gates[0].waypoint: 3 is no waypoint between the first and the last",
        ),
        (
            "waypoint = 0\nradius_m = 0.3",
            "gates[0].waypoint: 0 is no waypoint between the first and the last",
        ),
        ("waypoint = 1\nradius_m = 0.0", "gates[0].radius_m: 0.0 is out of range; give a value above 0"),
        ("waypoint = 1\nradius_m = 0.3\nwidth_m = 1.0", "gates[0]: give either radius_m, or width_m"),
        ("waypoint = 1\nwidth_m = 1.0\nheight_m = 1.0", "gates[0]: give either radius_m, or width_m"),
        ("waypoint = 1", "gates[0]: give either radius_m, or width_m"),
        ("radius_m = 0.3", "gates[0].waypoint: missing; add it"),
        (
            "waypoint = 1\nradius_m = 0.3\n[[gates]]\nwaypoint = 1\nradius_m = 0.2",
            "gates[1].waypoint: waypoint 1 has gates[0] already, keep one of them",
        ),
        (
            "waypoint = 1\nradius_m = 0.3\n"
            '[[keep_out]]\nkind = "sphere"\ncentre_m = [3, 0, -1]\nradius_m = 1',
            "waypoints_m[1]: lies 1.00 m inside keep_out[0] (sphere), move one of them",
        ),
    ],
)
def test_bad_gate_is_named_with_its_key_and_a_remedy(table: str, said: str) -> None:
    vehicle = load_vehicle("research")
    with pytest.raises(ConfigurationError) as caught:
        check_route(parse_route(f"{ROUTE}[[gates]]\n{table}\n", "bad.toml"), vehicle, "bad.toml")
    (line,) = caught.value.problems
    assert line.startswith(f"bad.toml: {said}")
    assert caught.value.exit_code == 2


def test_route_without_a_waypoint_between_its_ends_takes_no_gate() -> None:
    with pytest.raises(ValueError, match="leave the gate out"):
        Route(name="r", waypoints_m=((0.0, 0.0, -1.0), (1.0, 0.0, -1.0)), total_time_s=3.0, gates=(SPHERE,))
