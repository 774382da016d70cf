"""Route files: shipped ones, generators, and routes that contradict themselves."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trimtab.firmware_model.law.ops import FLOAT
from trimtab.host.plan.table import SPACING_S
from trimtab.host.route import (
    TIME_MAX_S,
    Box,
    Cylinder,
    Route,
    Sphere,
    YawProfile,
    check_route,
    list_routes,
    load_route,
    parse_route,
    random_route,
    route_file,
)
from trimtab.host.vehicle import ConfigurationError, Vehicle, load_vehicle
from trimtab.protocol.blob_fields import HEADER_BYTES
from trimtab.protocol.blobs import BLOB_BYTES_MAX, NODE_BYTES

SHIPPED = (
    "circuit",
    "climbs-descents",
    "doublets",
    "fast-lemniscate",
    "figure-eight",
    "hover",
    "hover-turns",
    "long-hover",
    "low",
    "low-high",
    "pretzel",
    "random",
    "speed-sweep",
    "sprint",
    "stop-and-go",
)
GOOD = """
name = "good"
total_time_s = 6.0
waypoints_m = [[0, 0, -1], [3, 0, -1], [0, 3, -1]]
"""


@pytest.fixture(scope="module")
def research() -> Vehicle:
    return load_vehicle("research")


def problems(text: str, vehicle: Vehicle) -> list[str]:
    """The lines that reading and checking `text` raises."""
    with pytest.raises(ConfigurationError) as caught:
        check_route(parse_route(text, "bad.toml"), vehicle)
    return list(caught.value.problems)


def test_shipped_routes_are_listed() -> None:
    assert tuple(list_routes()) == SHIPPED


@pytest.mark.parametrize("name", [*SHIPPED, "random:7"])
def test_shipped_route_fits_the_research_vehicle_and_reads_back_equal(name: str, research: Vehicle) -> None:
    route = load_route(name)
    assert check_route(route, research) == research.limits
    again = parse_route(route.to_toml(), "again")
    assert again == route
    assert again.id == route.id


def test_pretzel_has_the_papers_waypoints_and_time() -> None:
    # Section V-B: 7 waypoints, N = 280 steps of 0.03 s.
    route = load_route("pretzel")
    assert len(route.waypoints_m) == 7
    assert route.duration_s == pytest.approx(280 * 0.03)


def test_figure_eight_crosses_its_centre_twice_a_turn() -> None:
    route = load_route("figure-eight")
    assert sum(point == (0.0, 0.0, -1.5) for point in route.waypoints_m) == 5
    assert max(point[0] for point in route.waypoints_m) == 2.5
    assert max(point[1] for point in route.waypoints_m) == 1.5


def test_random_route_repeats_with_its_seed_and_differs_without(research: Vehicle) -> None:
    assert random_route(3) == random_route(3)
    assert random_route(3).waypoints_m != random_route(4).waypoints_m
    assert load_route("random:3").waypoints_m == random_route(3).waypoints_m


@given(seed=st.integers(0, 2**32), count=st.integers(2, 12))
def test_random_waypoints_stay_in_the_box_and_apart(seed: int, count: int) -> None:
    box = ((-2.0, 2.0), (-1.0, 3.0), (-2.0, -1.0))
    route = random_route(seed, count=count, box_m=box, leg_min_m=1.0)
    assert len(route.waypoints_m) == count
    for point in route.waypoints_m:
        assert all(low <= value <= high for value, (low, high) in zip(point, box, strict=True))
    legs = [math.dist(a, b) for a, b in zip(route.waypoints_m, route.waypoints_m[1:], strict=False)]
    assert min(legs) >= 1.0


def test_contradictions_are_all_told_before_solving(research: Vehicle) -> None:
    lines = problems(
        """
        name = "bad"
        total_time_s = 1.0
        waypoints_m = [[0, 0, -0.2], [30, 0, -1], [0, 3, -1]]
        yaw = { yaw_deg = [0.0, 180.0], times_s = [0.0, 1.2] }
        limits = { speed_max_m_s = 20.0, geofence_m = [[-1, 1], [-20, 4], [-3, 0]] }
        [[keep_out]]
        kind = "box"
        min_m = [-1, 2, -2]
        max_m = [1, 4, 0]
        [[keep_out]]
        kind = "cylinder"
        centre_m = [0, 3]
        radius_m = 0.3
        down_m = [-2, 0]
        """,
        research,
    )
    assert [line.split(":")[1].strip() for line in lines] == [
        "limits.speed_max_m_s",
        "limits.geofence_m[1]",
        "waypoints_m[0]",
        "waypoints_m[1]",
        "waypoints_m[2]",
        "waypoints_m[2]",
        "total_time_s",
        "yaw.times_s",
        "yaw.yaw_deg",
    ]
    assert "lies 1.00 m inside keep_out[0] (box)" in lines[4]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("total_time_s = 6.0", "", "give either total_time_s or times_s"),
        ("total_time_s = 6.0", "total_time_s = 6.0\ntimes_s = [0, 2, 4]", "and not both"),
        ("total_time_s = 6.0", "times_s = [0, 2]", "2 times_s for 3 waypoints_m"),
        (
            "total_time_s = 6.0",
            "total_time_s = 6.0\nstart_velocity_m_s = [8, 6, 1]",
            "start_velocity_m_s: 10.05 m/s, the limit is 10; lower it",
        ),
        (
            "total_time_s = 6.0",
            "total_time_s = 6.0\nend_velocity_m_s = [1, 2]",
            "end_velocity_m_s[2]: missing",
        ),
        ("total_time_s = 6.0", "times_s = [0, 2, 2]", "must start at 0 and increase"),
        ("total_time_s = 6.0", "times_s = [0, 0.1, 2]", "times_s[1]: leg 0 needs 30.0 m/s"),
        ("[3, 0, -1]", "[0, 0, -1]", "waypoints 0 and 1 are the same point"),
        ("[3, 0, -1]", "[3, 0, 0.2]", "waypoints_m[1]: lies below the floor"),
        (
            "[3, 0, -1]",
            "[30, 0, -1]",
            "waypoints_m[1]: north 30 m is outside the vehicle's geofence [-10, 10]",
        ),
        (
            'name = "good"',
            'name = "good"\nlimits.geofence_m = [[-1, 1], [-5, 5], [-3, 0]]',
            "waypoints_m[1]: north 3 m is outside the route's own geofence [-1, 1]",
        ),
        (
            'name = "good"',
            'name = "good"\nlimits.geofence_m = [[-5, 5], [-5, 5], [0, 3]]',
            "limits.geofence_m: down from 0 to 3 m lies below the floor",
        ),
        ("[3, 0, -1]", "[3, 0]", "waypoints_m[1][2]: missing"),
        ("[3, 0, -1], [0, 3, -1]", "", "waypoints_m: 1 entries; give at least 2"),
        ('name = "good"', 'name = "good"\nspeed = 3', "speed: unknown key"),
        ('name = "good"', 'name = "good"\nkeep_out = [{kind = "cone"}]', "keep_out[0].kind: unknown; choose"),
        ('name = "good"', 'name = "good"\n[random]\nseed = 1', "random.count: missing"),
        ('name = "good"', 'name = "good', "not valid TOML"),
    ],
)
def test_bad_route_is_named_with_its_key(research: Vehicle, old: str, new: str, said: str) -> None:
    assert old in GOOD
    lines = problems(GOOD.replace(old, new), research)
    assert any(said in line for line in lines), lines


def test_malformed_waypoint_is_not_called_a_missing_one(research: Vehicle) -> None:
    text = GOOD.replace("[3, 0, -1], [0, 3, -1]", "[0, 3]")
    assert problems(text, research) == ["bad.toml: waypoints_m[1][2]: missing; add it"]


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("total_time_s = 6.0", "total_time_s = 1e9", "total_time_s"),
        ("total_time_s = 6.0", "times_s = [0, 2, 501]", "times_s"),
    ],
)
def test_route_longer_than_the_vehicle_can_hold_is_refused(
    research: Vehicle, old: str, new: str, key: str
) -> None:
    (line,) = problems(GOOD.replace(old, new), research)
    assert line.startswith(f"good: {key}: ")
    assert line.endswith("give at most 500")


def test_key_wrong_by_itself_hides_no_contradiction_of_the_others(research: Vehicle) -> None:
    text = """
        name = "?"
        total_time_s = -1.0
        waypoints_m = [[0, 0, -0.2], [30, 0, -1]]
        yaw = { yaw_deg = [0.0, 180.0], times_s = [0.0, 0.2] }
        limits = { speed_max_m_s = 20.0 }
        [[keep_out]]
        kind = "cone"
        """
    with pytest.raises(ConfigurationError) as caught:
        parse_route(text, "bad.toml", research)
    assert [line.split(": ")[:2] for line in caught.value.problems] == [
        ["bad.toml", key]
        for key in (
            "name",
            "total_time_s",
            "keep_out[0].kind",
            "limits.speed_max_m_s",
            "waypoints_m[0]",
            "waypoints_m[1]",
            "yaw.yaw_deg",
        )
    ]


def test_contradictions_are_not_made_up_where_waypoints_or_times_are_wrong(research: Vehicle) -> None:
    for old, new, count in (
        ("[3, 0, -1]", "[3, 0]", 1),
        ("total_time_s = 6.0", "times_s = [0, 2]", 1),
        ("total_time_s = 6.0", "", 1),
    ):
        with pytest.raises(ConfigurationError) as caught:
            parse_route(GOOD.replace(old, new), "bad.toml", research)
        assert len(caught.value.problems) == count


def test_greatest_time_is_what_nodes_of_the_planners_spacing_leave_room_for() -> None:
    nodes = round(TIME_MAX_S / SPACING_S) + 1
    assert 0.99 * BLOB_BYTES_MAX < HEADER_BYTES + nodes * NODE_BYTES <= BLOB_BYTES_MAX


def test_problem_names_the_file_it_was_read_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, research: Vehicle
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "routes").mkdir()
    (tmp_path / "routes" / "mine.toml").write_text(GOOD.replace("[3, 0, -1]", "[3, 0]"))
    with pytest.raises(ConfigurationError, match=r"^routes/mine\.toml: waypoints_m\[1\]"):
        load_route("mine", tmp_path)
    assert route_file("mine", tmp_path) == "routes/mine.toml"


def test_velocities_at_the_ends_are_read_and_left_out_of_routes_at_rest() -> None:
    moving = parse_route(GOOD + "end_velocity_m_s = [1, 0, -0.5]\n", "r")
    assert moving.end_velocities_ned == ((0.0, 0.0, 0.0), (1.0, 0.0, -0.5))
    assert parse_route(moving.to_toml(), "again") == moving
    assert "velocity" not in parse_route(GOOD, "r").to_toml()


def test_two_sources_of_waypoints_are_refused(research: Vehicle) -> None:
    text = GOOD + "[figure_eight]\ncentre_m = [0, 0, -1]\nlength_m = 2\nwidth_m = 1\n"
    assert problems(text, research) == [
        "bad.toml: give exactly one of waypoints_m, [figure_eight] and [random]"
    ]


def test_random_box_too_small_for_its_legs_is_refused() -> None:
    with pytest.raises(ValueError, match="does not fit the box"):
        random_route(1, box_m=((0.0, 1.0), (0.0, 1.0), (-2.0, -1.0)), leg_min_m=3.0)


@pytest.mark.parametrize("name", ["random:x", "pretzel:3", "random:-1"])
def test_seed_behind_a_name_needs_a_random_table(name: str) -> None:
    with pytest.raises(ConfigurationError, match="SEED is a whole number"):
        load_route(name)


def test_workspace_route_is_found_by_name(tmp_path: Path) -> None:
    (tmp_path / "routes").mkdir()
    (tmp_path / "routes" / "mine.toml").write_text(GOOD)
    assert load_route("mine", tmp_path).name == "good"
    with pytest.raises(ConfigurationError, match=r"mine: no such route \(known: circuit, climbs-descents"):
        load_route("mine")


def test_tighter_limits_replace_the_vehicles(research: Vehicle) -> None:
    route = parse_route(GOOD + "[limits]\nspeed_max_m_s = 4.0\n", "r")
    limits = check_route(route, research)
    assert limits.speed_max_m_s == 4.0
    assert limits.tilt_max_deg == research.limits.tilt_max_deg


def test_yaw_profile_passes_its_values_without_overshoot() -> None:
    profile = YawProfile(yaw_deg=(0.0, 90.0, 180.0, 90.0), times_s=(0.0, 2.0, 4.0, 6.0))
    rows = profile.nodes()
    assert [math.degrees(yaw) for _, yaw, _ in rows] == pytest.approx([0.0, 90.0, 180.0, 90.0])
    assert [rate for _, _, rate in rows] == pytest.approx([0.0, math.radians(45.0), 0.0, 0.0])
    # A rest-to-rest cubic turns 1.5 times as fast in its middle as on average.
    assert profile.rate_max() == pytest.approx(1.5 * math.radians(45.0))


@pytest.mark.parametrize(
    ("yaw", "line"),
    [
        ("free = true", "yaw: free: a free heading needs rate_max_rad_s, add it"),
        ("rate_max_rad_s = 1.0", "yaw: rate_max_rad_s: only a free heading has it, add free = true"),
        ("free = false\nrate_max_rad_s = 1.0", "yaw: rate_max_rad_s: only a free heading has it"),
        (
            "free = true\nrate_max_rad_s = 1.0\nyaw_deg = [0, 90]\ntimes_s = [0, 2]",
            "yaw: yaw_deg: 2 headings, but free; give the one it starts with",
        ),
        ("free = true\nrate_max_rad_s = 0.0", "yaw.rate_max_rad_s: 0.0 is out of range"),
        (
            "free = true\nrate_max_rad_s = 9.0",
            "yaw.rate_max_rad_s: 9 is above the limit of the body rate, 3; lower it",
        ),
    ],
)
def test_free_heading_that_contradicts_itself_is_one_line(yaw: str, line: str, research: Vehicle) -> None:
    (told,) = problems(f"{GOOD}[yaw]\n{yaw}\n", research)
    assert line in told
    assert told.startswith("bad.toml: " if "above" not in line else "good: ")


def test_free_heading_is_read_and_left_out_of_routes_that_give_theirs() -> None:
    free = parse_route(GOOD + "[yaw]\nyaw_deg = [90]\nfree = true\nrate_max_rad_s = 1.5\n", "r")
    assert parse_route(free.to_toml(), "again") == free
    assert free.yaw.nodes() == ((0.0, math.radians(90.0), 0.0),)
    assert "free" not in parse_route(GOOD, "r").to_toml()


def test_constant_yaw_is_one_node_at_rest() -> None:
    assert YawProfile(yaw_deg=(90.0,)).nodes() == ((0.0, math.radians(90.0), 0.0),)
    assert (
        Route(name="r", waypoints_m=((0.0, 0.0, -1.0), (1.0, 0.0, -1.0)), total_time_s=3.0).yaw.rate_max()
        == 0.0
    )


BOX = Box(kind="box", min_m=(0.0, 0.0, -2.0), max_m=(2.0, 2.0, 0.0))
SPHERE = Sphere(kind="sphere", centre_m=(0.0, 0.0, -1.0), radius_m=0.5)
CYLINDER = Cylinder(kind="cylinder", centre_m=(1.0, 0.0), radius_m=1.0, down_m=(-2.0, 0.0))


@pytest.mark.parametrize(
    ("shape", "point", "distance"),
    [
        (BOX, (1.0, 1.0, -1.0), -1.0),
        (BOX, (5.0, 6.0, -1.0), 5.0),
        (SPHERE, (0.0, 3.0, -5.0), 4.5),
        (SPHERE, (0.0, 0.0, -1.0), -0.5),
        (CYLINDER, (5.0, 0.0, -5.0), math.sqrt(18)),
        (CYLINDER, (1.0, 0.0, -0.2), -0.2),
    ],
)
def test_signed_distance_of_shape_is_the_hand_computed_one(
    shape: Box | Sphere | Cylinder, point: tuple[float, float, float], distance: float
) -> None:
    assert shape.signed_distance(FLOAT, point) == pytest.approx(distance, abs=2e-6)
