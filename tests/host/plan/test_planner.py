"""Plans: every kind within every limit, refusals with node and reason, the same reference every time."""

from __future__ import annotations

import functools
import math
import re
from typing import Any

import numpy as np
import pytest

from tests.narrowing import not_none
from tests.parts import part
from trimtab.firmware_model.law.checks import check_reference
from trimtab.firmware_model.law.limits import from_parameters
from trimtab.host.base.errors import UsageError
from trimtab.host.models.model import Model
from trimtab.host.models.network import Frame, Layout, Network
from trimtab.host.models.region import Region
from trimtab.host.plan import Plan, PlanRefused, PlanUnsolved, ResidualModel, Settings, Weights, plan
from trimtab.host.plan.judge import Passing, judge, measure
from trimtab.host.plan.planner import JobOptions
from trimtab.host.plan.table import evaluate, from_reference
from trimtab.host.route import TIME_MAX_S, Gate, LimitsOverride, Route, YawProfile, load_route, random_route
from trimtab.host.route.shapes import Cylinder
from trimtab.host.vehicle import ConfigurationError, load_vehicle, to_parameters
from trimtab.protocol.blobs import BLOB_BYTES_MAX, Reference, YawNode

VEHICLE = load_vehicle("research")
DRAG = ResidualModel(parts=(part("linear-drag", 0.5, 0.4, 0.1),))
ROUTE = Route(
    name="short",
    waypoints_m=((-1.6, -0.9, -1.2), (1.7, 1.2, -1.6), (0.0, 2.4, -2.0), (-2.0, 0.0, -1.4)),
    total_time_s=4.6,
)
ALL_KINDS = (
    "min-snap",
    "min-control",
    "min-control*",
    "min-control-r",
    "min-residual",
    "min-residual*",
    "min-error",
)


@functools.cache
def _planned(kind: str) -> Plan:
    return plan(ROUTE, VEHICLE, kind=kind, model=DRAG)


def _assert_flyable(made: Plan, **limits: Any) -> None:
    airframe, on_board = from_parameters(to_parameters(VEHICLE))
    reference = made.reference
    verdict = check_reference(
        reference.nodes, reference.yaw_nodes(), airframe, on_board, origin=reference.origin_ned
    )
    assert verdict.ok, verdict.message
    assert all(margin >= 0.0 for margin in made.margins.values())
    for name, least in limits.items():
        assert verdict.margins[name] >= least


@pytest.mark.parametrize("kind", ALL_KINDS)
def test_plan_of_any_kind_is_within_limits_and_passes_its_waypoints(kind: str) -> None:
    made = _planned(kind)
    _assert_flyable(made)
    assert made.duration_s == pytest.approx(4.6, abs=2e-6)
    assert (made.label, made.augmented) == (kind, kind.endswith(("*", "-r")))
    table = from_reference(made.reference)
    at = np.rint(np.array(made.waypoint_times_s) * 1e6)
    np.testing.assert_allclose(evaluate(table, at)[0].T, ROUTE.waypoints_m, atol=2e-5)
    assert np.abs(table.states_ned[[0, -1], 3:]).max() == 0.0
    spacing = np.diff(table.times_us)
    assert spacing.min() >= 50_000
    assert spacing.max() <= 200_000
    assert made.residual_rms_m_s2 is not None
    assert made.mean_speed_m_s == pytest.approx(made.path_length_m / made.duration_s)


@pytest.mark.parametrize("kind", ALL_KINDS[1:])
def test_plan_by_shooting_stays_within_two_millimetres_of_the_solver(kind: str) -> None:
    made = _planned(kind)
    assert made.deviation_m is not None
    assert made.deviation_m < 2e-3
    assert made.status in ("solved", "acceptable")
    assert made.iterations < 300


@pytest.mark.parametrize("kind", ALL_KINDS)
def test_plan_does_not_ripple_between_nodes(kind: str) -> None:
    table = from_reference(_planned(kind).reference)
    at = np.linspace(0.0, float(table.times_us[-1]), 4001)
    jerk = np.linalg.norm(evaluate(table, at)[3], axis=0)
    at_nodes = np.linalg.norm(table.states_ned[:, 9:], axis=1)
    assert jerk.max() <= 1.2 * at_nodes.max() + 1.0


@pytest.mark.parametrize("kind", ["min-snap", "min-residual"])
def test_plan_repeated_is_the_same_bytes(kind: str) -> None:
    again = plan(ROUTE, VEHICLE, kind=kind, model=DRAG)
    assert again.reference.to_bytes() == _planned(kind).reference.to_bytes()


def test_min_residual_predicts_less_residual_than_the_others() -> None:
    rms = {kind: _planned(kind).residual_rms_m_s2 or math.inf for kind in ALL_KINDS}
    assert rms["min-residual"] < 0.85 * rms["min-snap"]
    assert rms["min-residual*"] < 0.9 * rms["min-snap"]
    assert rms["min-residual"] < rms["min-control"]


@pytest.mark.parametrize(
    ("name", "theta", "share"),
    [
        ("thrust-gain", (0.8,), 0.97),
        ("ground-effect", (0.05,), 0.9),
        ("thrust-inflow", (0.5,), 0.8),
        ("com-offset", (0.03, 0.02), 0.93),
        ("gyroscopic", (40.0,), 0.8),
    ],
)
@pytest.mark.usefixtures("virtual_machine")
def test_min_residual_under_a_thrust_or_torque_effect_has_less_of_it(
    name: str, theta: tuple[float, ...], share: float
) -> None:
    model = ResidualModel(parts=(part(name, *theta),))
    made = {kind: plan(ROUTE, VEHICLE, kind=kind, model=model) for kind in ("min-control", "min-residual")}
    _assert_flyable(made["min-residual"])
    rms = {kind: one.residual_rms_m_s2 or math.inf for kind, one in made.items()}
    assert rms["min-residual"] < share * rms["min-control"]


def test_constant_bias_leaves_the_plan_as_it_is() -> None:
    bias = (part("torque-bias", 2.0, 1.0, 0.5), part("frame-tilt", 0.02, 0.01))
    made = plan(ROUTE, VEHICLE, kind="min-residual", model=ResidualModel(parts=(*DRAG.parts, *bias)))
    before = _planned("min-residual")
    assert made.residual_rms_m_s2 == pytest.approx(before.residual_rms_m_s2, rel=1e-6)
    found, wanted = (np.array([node.state[:3] for node in one.reference.nodes]) for one in (made, before))
    np.testing.assert_allclose(found, wanted, atol=1e-3)


def test_min_control_r_tracks_the_min_control_path_with_the_model_in_its_dynamics() -> None:
    first, refined = _planned("min-control"), _planned("min-control-r")
    assert refined.waypoint_times_s == pytest.approx(first.waypoint_times_s, abs=1e-3)
    assert refined.rounds > first.rounds
    loose = plan(
        ROUTE,
        VEHICLE,
        kind="min-control-r",
        model=DRAG,
        settings=Settings(weights=Weights(tracking=1e-3, thrust_rate=0.04)),
    )
    at = np.linspace(0.0, 4.6e6, 500)
    path = evaluate(from_reference(first.reference), at)[0]
    off, far = (
        float(np.linalg.norm(evaluate(from_reference(made.reference), at)[0] - path, axis=0).max())
        for made in (refined, loose)
    )
    assert off < 0.02
    assert far > 2.0 * off


@pytest.mark.parametrize("seed", [3, pytest.param(4, marks=pytest.mark.full)])
@pytest.mark.parametrize(
    ("better", "worse", "total_time_s", "share"),
    [
        ("min-residual", "min-snap", 5.0, 0.8),
        # Below the greatest speed, where the limits leave room.
        ("min-error", "min-residual", 6.5, 0.95),
    ],
)
def test_plan_is_tracked_better_under_drag_than_one_of_a_simpler_kind(
    better: str, worse: str, total_time_s: float, share: float, seed: int
) -> None:
    # The closed loop of the nominal law with drag, integrated: whole flights in phi.
    route = random_route(seed, count=4, total_time_s=total_time_s)
    errors = {kind: _tracking_rmse(plan(route, VEHICLE, kind=kind, model=DRAG)) for kind in (better, worse)}
    assert errors[better] < share * errors[worse]


def test_min_error_refuses_a_model_without_acceleration() -> None:
    torque = ResidualModel(parts=(part("gyroscopic", 40.0),))
    assert plan(ROUTE, VEHICLE, kind="min-residual", model=torque).kind == "min-residual"
    with pytest.raises(UsageError, match="no tracking error"):
        plan(ROUTE, VEHICLE, kind="min-error", model=torque)
    with pytest.raises(UsageError, match="--model"):
        plan(ROUTE, VEHICLE, kind="min-error")


def _tracking_rmse(made: Plan) -> float:
    """RMSE of position in m, by RK4 at 5 ms."""
    from trimtab.host.models.drive import flight_constants
    from trimtab.host.models.phi import Phi
    from trimtab.host.models.reference import flat_outputs
    from trimtab.host.models.rollout import reference_drive

    phi = Phi(
        vehicle=VEHICLE, effects=tuple(effect for effect, _ in DRAG.parts), drive="reference", estimator=False
    )
    theta, constants, step_s = phi.theta(DRAG.parts), flight_constants(), 5e-3
    times = np.arange(0.0, made.duration_s, step_s / 2)
    flat = flat_outputs(made.reference, times)
    drive = reference_drive(made.reference, times).T
    x = phi.hover(flat[:3, 0].tolist(), float(flat[12, 0]))
    errors = []
    for k in range(0, len(times) - 2, 2):
        errors.append(x[:3] - flat[:3, k])

        def slope(state: np.ndarray, column: int) -> np.ndarray:
            return np.array(phi.function(state, drive[:, column], constants, theta, np.zeros(3))).ravel()

        k1 = slope(x, k)
        k2 = slope(x + step_s / 2 * k1, k + 1)
        k3 = slope(x + step_s / 2 * k2, k + 1)
        k4 = slope(x + step_s * k3, k + 2)
        x = x + step_s / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return float(np.sqrt((np.array(errors) ** 2).sum(axis=1).mean()))


def test_plan_with_headroom_keeps_it() -> None:
    tight = LimitsOverride(
        thrust_headroom=(0.12, 0.4), tilt_max_deg=35.0, body_rate_max_rad_s=(3.0, 3.0, 2.0)
    )
    made = plan(ROUTE, VEHICLE, kind="min-residual", model=DRAG, headroom=tight)
    _assert_flyable(made, tilt_deg=25.0, thrust_low=0.04, thrust_high=0.25)
    with pytest.raises(ConfigurationError, match="thrust_headroom"):
        plan(ROUTE, VEHICLE, headroom=LimitsOverride(thrust_headroom=(0.0, 0.4)))


def test_plan_with_a_turning_heading_follows_it() -> None:
    yaw = YawProfile(yaw_deg=(-30.0, 120.0), times_s=(0.0, 4.6))
    route = ROUTE.model_copy(update={"yaw": yaw})
    made = plan(route, VEHICLE, kind="min-residual", model=DRAG)
    _assert_flyable(made)
    rows = made.reference.yaw_nodes()
    assert [row.t_us for row in rows] == [0, 4_600_000]
    assert [row.yaw for row in rows] == pytest.approx(np.radians([-30.0, 120.0]), abs=1e-6)


def test_plan_with_waypoint_times_keeps_them() -> None:
    times = (0.0, 2.1, 3.0, 4.6)
    route = Route(name="timed", waypoints_m=ROUTE.waypoints_m, times_s=times)
    for kind in ("min-snap", "min-control"):
        assert plan(route, VEHICLE, kind=kind).waypoint_times_s == pytest.approx(times, abs=1e-6)


def test_plan_in_another_total_time_scales_the_heading_along() -> None:
    route = ROUTE.model_copy(update={"yaw": YawProfile(yaw_deg=(0.0, 90.0), times_s=(0.0, 4.6))})
    made = plan(route, VEHICLE, total_time_s=9.2)
    assert made.duration_s == pytest.approx(9.2)
    assert made.reference.yaw_nodes()[-1].t_us == 9_200_000


def test_plan_with_free_total_time_stays_in_its_box() -> None:
    made = plan(ROUTE, VEHICLE, kind="min-control", settings=Settings(total_time_box=(0.9, 1.2)))
    assert 0.9 * 4.6 - 1e-5 <= made.duration_s <= 1.2 * 4.6 + 1e-5
    assert made.duration_s < 4.55  # effort is an integral over time: less time, less hovering


@pytest.mark.parametrize(
    "settings",
    [
        Settings(step_box=(0.9, 1.1)),
        Settings(relative_weights=False, weights=Weights(control=0.34, thrust_rate=0.02)),
    ],
)
@pytest.mark.usefixtures("virtual_machine")
def test_plan_with_other_settings_is_flyable(settings: Settings) -> None:
    _assert_flyable(plan(ROUTE, VEHICLE, kind="min-residual", model=DRAG, settings=settings))


def test_min_snap_too_fast_is_refused_with_node_and_reason() -> None:
    with pytest.raises(
        PlanRefused, match=r"node \d+ at .* s: .* (above|below) .*; give it more time"
    ) as caught:
        plan(ROUTE, VEHICLE, total_time_s=1.9)
    assert caught.value.exit_code == 1
    assert caught.value.verdict is not None
    assert caught.value.verdict.reason_code


def test_min_snap_too_fast_may_stretch_by_what_it_needs() -> None:
    made = plan(ROUTE, VEHICLE, total_time_s=1.9, stretch=True)
    _assert_flyable(made)
    assert made.stretch > 1.2
    assert made.duration_s == pytest.approx(1.9 * made.stretch, abs=1e-5)
    with pytest.raises(PlanRefused):
        plan(ROUTE, VEHICLE, total_time_s=1.9 * made.stretch * 0.99)


def test_min_control_without_a_way_is_refused() -> None:
    settings = Settings(iterations_max=40)
    named = r"no way within the limits was found \(.*\), the min-snap path breaks \w+ by \S+ at node \d+, "
    with pytest.raises(PlanRefused, match=named) as caught:
        plan(ROUTE, VEHICLE, kind="min-control", total_time_s=1.4, nodes=30, settings=settings)
    assert caught.value.exit_code == 1


def test_plan_out_of_iterations_is_a_solver_failure() -> None:
    with pytest.raises(PlanUnsolved, match="limit of iterations") as caught:
        plan(ROUTE, VEHICLE, kind="min-control", settings=Settings(iterations_max=2, rounds=1))
    assert caught.value.exit_code == 4


def test_min_residual_goes_round_a_keep_out_shape_that_min_snap_hits() -> None:
    table = from_reference(_planned("min-snap").reference)
    middle = evaluate(table, np.array([0.5 * table.times_us[-1]]))[0][:, 0]
    post = Cylinder(
        kind="cylinder", centre_m=(float(middle[0]), float(middle[1])), radius_m=0.25, down_m=(-5.0, 0.0)
    )
    route = ROUTE.model_copy(update={"keep_out": (post,)})
    with pytest.raises(PlanRefused, match=r"node \d+ .* inside keep_out\[0\] \(cylinder\)"):
        plan(route, VEHICLE)
    made = plan(route, VEHICLE, kind="min-residual", model=DRAG)
    assert made.margins["keep_out_m"] >= 0.0


GATES = (
    Gate(waypoint=1, radius_m=0.3),
    Gate(waypoint=2, width_m=0.8, height_m=0.6, heading_deg=200.0),
)


GATE_TIMES_S = (0.0, 1.8, 3.0, 4.6)
TIMED_KINDS = ("min-snap", "min-residual")
"""Kinds that `make test` plans through gates at given times; the full run has all."""


@pytest.mark.parametrize(
    ("kind", "times_s"),
    [
        *((kind, None) for kind in ALL_KINDS),
        *((kind, GATE_TIMES_S) for kind in TIMED_KINDS),
        *(
            pytest.param(kind, GATE_TIMES_S, marks=pytest.mark.full)
            for kind in ALL_KINDS
            if kind not in TIMED_KINDS
        ),
    ],
)
def test_plan_passes_gates_inside_and_by_shooting_makes_use_of_them(
    kind: str, times_s: tuple[float, ...] | None
) -> None:
    timed = {} if times_s is None else {"times_s": times_s, "total_time_s": None}
    made = plan(
        ROUTE.model_copy(update={"gates": GATES, **timed}), VEHICLE, kind=kind, model=DRAG, clearance_m=0.0
    )
    _assert_flyable(made)
    at = np.rint(np.array(made.waypoint_times_s) * 1e6)
    p = evaluate(from_reference(made.reference), at)[0].T
    inside = [gate.inside_m(p[gate.waypoint], ROUTE.waypoints_m[gate.waypoint]) for gate in GATES]
    assert made.margins["gates_m"] == pytest.approx(min(inside), abs=1e-9)
    off = np.linalg.norm(p - ROUTE.waypoints_m, axis=1)
    assert off[[0, 3]].max() < 2e-5
    if kind == "min-snap":
        assert off.max() < 2e-5
        assert min(inside) == pytest.approx(0.3, abs=2e-5)
    else:
        assert min(inside) > 0.0099
        assert off[1:3].min() > 0.1
        assert made.deviation_m is not None
        assert made.deviation_m < 2e-3


def test_plan_with_gates_has_less_residual_than_through_their_centres() -> None:
    made = plan(
        ROUTE.model_copy(update={"gates": GATES}), VEHICLE, kind="min-residual", model=DRAG, clearance_m=0.0
    )
    assert made.residual_rms_m_s2 is not None
    assert made.residual_rms_m_s2 < 0.95 * (_planned("min-residual").residual_rms_m_s2 or 0.0)


@pytest.mark.parametrize("kind", ALL_KINDS)
def test_plan_starts_and_ends_at_the_velocities_asked_for_with_nothing_accelerating(kind: str) -> None:
    start, end = (1.5, 1.0, 0.0), (-1.5, -1.0, 0.25)
    route = ROUTE.model_copy(update={"start_velocity_m_s": start, "end_velocity_m_s": end})
    made = plan(route, VEHICLE, kind=kind, model=DRAG, total_time_s=3.6)
    assert all(margin >= 0.0 for margin in made.margins.values())
    assert made.reference.free_ends
    ends = from_reference(made.reference).states_ned[[0, -1]]
    np.testing.assert_allclose(ends[:, 3:6], [start, end], atol=1e-6)
    assert not ends[:, 6:].any()
    airframe, on_board = from_parameters(to_parameters(VEHICLE))
    reference = Reference.from_bytes(made.reference.to_bytes())
    origin = reference.origin_ned
    nodes, yaws = reference.nodes, reference.yaw_nodes()
    assert check_reference(nodes, yaws, airframe, on_board, origin=origin, ends_at_rest=False).ok
    assert not check_reference(nodes, yaws, airframe, on_board, origin=origin).ok


def test_plan_at_rest_at_both_ends_makes_a_reference_that_the_vehicle_arms_for() -> None:
    assert not _planned("min-control").reference.free_ends


def test_judge_names_the_gate_that_is_missed() -> None:
    table = from_reference(_planned("min-snap").reference)
    far = (1.7, 1.2, -2.4)
    passing = Passing(
        gate=GATES[0], centre_ned=far, t_us=round(_planned("min-snap").waypoint_times_s[1] * 1e6)
    )
    judged = judge(table, [YawNode(0, 0.0, 0.0)], VEHICLE, VEHICLE.limits, (), [passing])
    assert not judged.ok
    assert re.fullmatch(r"node \d+ at \d\.\d+ s: 0\.5 m outside gates\[0\]", judged.message)
    assert judged.margins["gates_m"] == pytest.approx(-0.5, abs=1e-4)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"kind": "min-time"}, "no such kind"),
        ({"kind": "min-snap*"}, "no such kind"),
        ({"kind": "min-residual"}, "needs a model"),
        ({"kind": "min-control*"}, "needs a model"),
        ({"kind": "min-control-r"}, "min-control-r needs a model"),
        ({"kind": "min-control-r*"}, "no such kind"),
        ({"kind": "min-residual", "model": ResidualModel()}, "no network and names no effect"),
        ({"kind": "min-control", "nodes": 5}, "--nodes 5: give"),
        ({"total_time_s": -1.0}, "--time-s -1: give a time above 0"),
        ({"total_time_s": float("nan")}, "--time-s nan: give"),
        ({"total_time_s": 1e9}, "--time-s 1e\\+09: .* at most 500 s"),
        (
            {"kind": "min-residual", "model": Model(vehicle_id="0" * 12, vehicle_name="other")},
            "of vehicle other",
        ),
        (
            {
                "kind": "min-residual",
                "model": Model(
                    vehicle_id=VEHICLE.id, vehicle_name=VEHICLE.name, effects={"gremlins": {"n": 1.0}}
                ),
            },
            "gremlins",
        ),
    ],
)
def test_plan_of_bad_arguments_is_a_usage_error(arguments: dict[str, Any], match: str) -> None:
    with pytest.raises(UsageError, match=match) as caught:
        plan(ROUTE, VEHICLE, **arguments)
    assert caught.value.exit_code == 2


def test_plan_larger_than_the_vehicles_memory_is_refused() -> None:
    # Each of 1,200 headings takes a row of its own beside the 5,001 nodes of 500 s.
    yaw = YawProfile(
        yaw_deg=tuple(0.1 * (k % 2) for k in range(1200)), times_s=tuple(0.4 * k for k in range(1200))
    )
    hover = Route(
        name="long", waypoints_m=((0.0, 0.0, -1.0), (1.0, 0.0, -1.0)), total_time_s=TIME_MAX_S, yaw=yaw
    )
    with pytest.raises(UsageError, match=f"long: 5001 nodes take .* room for {BLOB_BYTES_MAX}; give"):
        plan(hover, VEHICLE)
    made = plan(hover.model_copy(update={"yaw": YawProfile()}), VEHICLE)
    assert len(made.reference.to_bytes()) <= BLOB_BYTES_MAX


def test_augmented_plan_with_a_model_that_cannot_hover_is_a_usage_error() -> None:
    parts = (part("linear-drag", 3.0, 3.0, 3.0), part("wind", 1e3, 1e3))
    with pytest.raises(UsageError, match="no state of rest"):
        plan(ROUTE, VEHICLE, kind="min-control*", model=ResidualModel(parts=parts))


def test_plan_of_a_contradictory_route_is_refused_before_solving() -> None:
    with pytest.raises(ConfigurationError, match=r"needs .* m/s") as caught:
        plan(ROUTE, VEHICLE, kind="min-control", total_time_s=0.5)
    assert caught.value.exit_code == 2


@pytest.mark.usefixtures("virtual_machine")
def test_plan_with_a_network_stays_where_it_was_trained() -> None:
    layout = Layout(hidden=(8,))
    network = Network(layout=layout, xi=0.3 * np.random.default_rng(2).standard_normal(layout.size))
    region = Region(speed_max_m_s=3.2, tilt_max_deg=30.0, thrust_min_n=5.0, thrust_max_n=10.0)
    model = ResidualModel(parts=DRAG.parts, network=network, region=region)
    made = plan(ROUTE, VEHICLE, kind="min-residual", model=model)
    assert made.margins["speed_m_s"] >= 0.0
    speed = np.linalg.norm(evaluate(from_reference(made.reference), np.linspace(0, 4.6e6, 500))[1], axis=0)
    assert speed.max() <= 1.1 * 3.2 + 1e-6


def test_measured_residual_is_that_of_the_drag() -> None:
    made = _planned("min-snap")
    table = from_reference(made.reference)
    isotropic = ResidualModel(parts=(part("linear-drag", 0.5, 0.5, 0.5),))
    figures = measure(VEHICLE, isotropic, table, made.reference.yaw_nodes())
    at = np.linspace(0.0, float(table.times_us[-1]), 4001)
    speed = np.linalg.norm(evaluate(table, at)[1], axis=0)
    assert figures.residual_rms_m_s2 == pytest.approx(0.5 * np.sqrt((speed**2).mean()), rel=2e-3)
    assert figures.path_length_m == pytest.approx(np.trapezoid(speed, at * 1e-6), rel=1e-4)


@pytest.mark.parametrize("vehicle", ["research", "nano"])
@pytest.mark.parametrize("route", ["pretzel", "figure-eight", "random"])
def test_shipped_routes_can_be_planned_for_every_vehicle(route: str, vehicle: str) -> None:
    made = plan(load_route(route), load_vehicle(vehicle), stretch=True)
    assert made.stretch < (1.0 + 1e-9 if vehicle == "research" else 1.4)


def test_many_short_legs_are_planned(require) -> None:
    # Fifty legs of four intervals: hardly a stage has freedom, and eliminated rows would appear dependent.
    require("compiler")
    points = tuple((0.02 * k, 0.3 * (k % 2), -1.0) for k in range(52))
    made = plan(Route(name="zigzag", waypoints_m=points, total_time_s=40.0), VEHICLE, kind="min-control")
    assert made.status == "solved"


def test_free_total_time_is_shorter_where_a_second_costs_more() -> None:
    route = load_route("pretzel")
    drag = ResidualModel(parts=(part("linear-drag", 0.5, 0.5, 0.1),))
    made = [
        plan(route, VEHICLE, kind="min-residual", model=drag, time_box=(0.7, 1.4), time_weight=weight)
        for weight in (0.3, 3.0)
    ]
    slow, quick = (each.duration_s for each in made)
    assert 0.7 * route.duration_s - 1e-3 <= quick < slow - 0.3
    assert slow <= 1.4 * route.duration_s + 1e-3
    assert not_none(made[1].residual_rms_m_s2) > not_none(made[0].residual_rms_m_s2)
    assert all(min(each.margins.values()) >= 0.0 for each in made)


@pytest.mark.parametrize(
    ("kind", "options", "named"),
    [
        ("min-control", {"time_box": (1.1, 1.3)}, "--time-box 1.1 1.3"),
        ("min-control", {"time_box": (0.01, 1.3)}, "--time-box 0.01 1.3"),
        ("min-control", {"time_weight": 1.0}, "--time-weight goes with --time-box"),
        ("min-control", {"time_box": (0.8, 1.3), "time_weight": -1.0}, "--time-weight -1"),
        ("min-snap", {"time_box": (0.8, 1.3)}, "--time-box goes with min-control"),
    ],
)
def test_freedom_of_time_that_makes_no_sense_is_refused(kind: str, options: JobOptions, named: str) -> None:
    with pytest.raises(UsageError, match=re.escape(named)):
        plan(load_route("pretzel"), VEHICLE, kind=kind, **options)


def test_free_total_time_of_a_route_with_times_is_refused() -> None:
    route = Route(name="timed", waypoints_m=((0, 0, -1), (1, 0, -1), (2, 1, -1)), times_s=(0.0, 2.0, 4.0))
    with pytest.raises(UsageError, match="its waypoints have times"):
        plan(route, VEHICLE, kind="min-control", time_box=(0.8, 1.3))


@pytest.mark.parametrize("frame", [pytest.param("world", marks=pytest.mark.full), "body"])
def test_plan_with_a_network_is_the_same_in_c_and_in_the_virtual_machine(
    frame: Frame, monkeypatch: pytest.MonkeyPatch, require
) -> None:
    require("compiler")
    layout = Layout(hidden=(8,), frame=frame)
    network = Network(layout=layout, xi=0.3 * np.random.default_rng(3).standard_normal(layout.size))
    made = []
    for engine in ("c", "vm"):
        monkeypatch.setenv("TRIMTAB_ENGINE", engine)
        made.append(
            plan(
                load_route("pretzel"), VEHICLE, kind="min-residual*", model=ResidualModel(network=network),
                nodes=60,
            )
        )  # fmt: skip
    assert made[0].residual_rms_m_s2 == pytest.approx(made[1].residual_rms_m_s2, rel=0.02)


@pytest.mark.usefixtures("virtual_machine")
def test_star_with_an_effect_of_the_floor_starts_at_rest_where_the_route_does() -> None:
    floor = ResidualModel(parts=(part("ground-effect", 0.03),))
    made = plan(ROUTE, VEHICLE, kind="min-residual*", model=floor)
    _assert_flyable(made)
