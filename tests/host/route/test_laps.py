"""Closed courses: laps of a route file become one route, and what contradicts them is refused."""

from __future__ import annotations

import numpy as np
import pytest

from trimtab.host.plan import plan
from trimtab.host.plan.table import evaluate, from_reference
from trimtab.host.route import check_route, parse_route
from trimtab.host.vehicle import ConfigurationError, Vehicle, load_vehicle

CLOSED = """
name = "round"
total_time_s = 12.0
waypoints_m = [[0, 0, -1], [2, 0, -1.4], [1, 2, -1]]
closed = true
"""
RANDOM = """
name = "drawn"
closed = true
laps = 2
[random]
seed = 5
count = 4
box_m = [[-2, 2], [-2, 2], [-2, -1]]
leg_min_m = 1.5
mean_speed_m_s = 2.0
"""


@pytest.fixture(scope="module")
def research() -> Vehicle:
    return load_vehicle("research")


def test_closed_route_returns_to_its_first_waypoint_once_without_laps() -> None:
    route = parse_route(CLOSED, "r")
    assert route.waypoints_m == ((0, 0, -1), (2, 0, -1.4), (1, 2, -1), (0, 0, -1))
    assert route.duration_s == 12.0


def test_laps_repeat_waypoints_gates_and_times_within_one_total_time() -> None:
    gates = "[[gates]]\nwaypoint = 2\nradius_m = 0.2\n[[gates]]\nwaypoint = 1\nradius_m = 0.3\n"
    route = parse_route(CLOSED + "laps = 3\n" + gates, "r")
    lap = [(0, 0, -1), (2, 0, -1.4), (1, 2, -1)]
    assert list(route.waypoints_m) == [*lap, *lap, *lap, lap[0]]
    assert route.duration_s == 12.0
    assert [(gate.waypoint, gate.radius_m) for gate in route.gates or ()] == [
        (2, 0.2), (1, 0.3), (5, 0.2), (4, 0.3), (8, 0.2), (7, 0.3),
    ]  # fmt: skip
    timed = CLOSED.replace("total_time_s = 12.0", "times_s = [0, 2, 3.5, 5]") + "laps = 2\n"
    assert parse_route(timed, "r").times_s == (0, 2, 3.5, 5, 7, 8.5, 10)


def test_expanded_laps_read_back_equal() -> None:
    route = parse_route(CLOSED + "laps = 2\n[[gates]]\nwaypoint = 1\nradius_m = 0.3\n", "r")
    assert parse_route(route.to_toml(), "again") == route


def test_drawn_lap_gets_the_time_of_all_laps() -> None:
    once, twice = (parse_route(RANDOM.replace("laps = 2", f"laps = {n}"), "r") for n in (1, 2))
    assert twice.waypoints_m == once.waypoints_m + once.waypoints_m[1:]
    assert twice.duration_s - 1.0 == pytest.approx(2.0 * (once.duration_s - 1.0), abs=0.02)
    assert twice.duration_s == pytest.approx(twice.length_m / 2.0 + 1.0, abs=0.006)


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("closed = true", "laps = 2", "laps: only a closed route has laps, add closed = true"),
        ("[1, 2, -1]]", "[1, 2, -1], [0, 0, -1]]", "waypoints_m: the last is the first"),
        ("closed = true", "closed = true\nlaps = 0", "laps: 0 is out of range"),
        ("closed = true", "closed = true\nlaps = 101", "laps: 101 is out of range"),
        ("closed = true", "closed = 1", "closed: 1 is not true or false"),
        (
            "closed = true",
            "closed = true\nstart_velocity_m_s = [1, 0, 0]",
            "start_velocity_m_s: a closed route starts and ends at rest",
        ),
        (
            "closed = true",
            "closed = true\nend_velocity_m_s = [0, 0, 0]",
            "end_velocity_m_s: a closed route starts and ends at rest",
        ),
        (
            "total_time_s = 12.0",
            "times_s = [0, 1, 2]",
            "times_s: 3 for a lap through 3 waypoints_m, give 4",
        ),
        (
            "waypoints_m = [[0, 0, -1], [2, 0, -1.4], [1, 2, -1]]\nclosed = true",
            "closed = true\n[figure_eight]\ncentre_m = [0, 0, -1]\nlength_m = 2\nwidth_m = 1",
            "closed: a figure eight is closed as it is",
        ),
        (
            "closed = true",
            "closed = true\nlaps = 3\n[[gates]]\nwaypoint = 4\nradius_m = 0.2",
            "gates[0].waypoint: 4 is no waypoint between the first and the last, give one of 1 to 2",
        ),
    ],
)
def test_contradictory_lap_is_one_line_with_file_key_and_remedy(old: str, new: str, line: str) -> None:
    assert old in CLOSED
    with pytest.raises(ConfigurationError) as caught:
        parse_route(CLOSED.replace(old, new), "bad.toml")
    assert caught.value.exit_code == 2
    (told,) = caught.value.problems
    assert told.startswith(f"bad.toml: {line}")


def test_what_is_wrong_with_a_lap_is_told_once(research: Vehicle) -> None:
    text = CLOSED.replace("total_time_s = 12.0", "times_s = [0, 0.1, 3, 6]").replace(
        "[1, 2, -1]", "[1, 99, -1]"
    )
    for laps in (1, 3):
        with pytest.raises(ConfigurationError) as caught:
            check_route(parse_route(f"{text}laps = {laps}\n", "r"), research, "bad.toml")
        assert [line.split(":")[1] for line in caught.value.problems] == [
            " waypoints_m[2]", " times_s[1]", " times_s[2]", " times_s[3]",
        ]  # fmt: skip


@pytest.mark.parametrize("kind", ["min-snap", "min-control"])
def test_planned_laps_pass_every_gate_and_stop_only_at_the_end(kind: str, research: Vehicle) -> None:
    text = CLOSED + "laps = 2\n[[gates]]\nwaypoint = 1\nwidth_m = 0.6\nheight_m = 0.4\nheading_deg = 45\n"
    route = parse_route(text, "r")
    made = plan(route, research, kind=kind)
    assert made.duration_s == pytest.approx(12.0, abs=1e-5)
    table = from_reference(made.reference)
    p, v, *_ = evaluate(table, np.array(made.waypoint_times_s) * 1e6)
    speed = np.linalg.norm(v, axis=0)
    assert speed[[0, -1]] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert (speed[1:-1] > 0.3).all()
    for k, waypoint in enumerate(route.waypoints_m):
        if k in (1, 4):
            gate = (route.gates or ())[k // 4]
            assert gate.inside_m(p[:, k], waypoint) >= 0.0
        else:
            assert np.linalg.norm(p[:, k] - waypoint) < 1e-4
