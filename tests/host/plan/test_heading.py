"""A free heading: less residual where drag differs along the body's axes, within its rate, and accepted."""

from __future__ import annotations

import functools
import re

import casadi as ca
import numpy as np
import pytest

from tests.parts import part
from trimtab.firmware_model.law.checks import check_reference
from trimtab.firmware_model.law.limits import from_parameters
from trimtab.host.base.errors import UsageError
from trimtab.host.models.airframe import THETA
from trimtab.host.models.network import Frame, Layout, Network
from trimtab.host.plan import Plan, ResidualModel, plan
from trimtab.host.plan.dynamics import Dynamics
from trimtab.host.plan.heading import SPACING_US, fastest_turn, yaw_nodes
from trimtab.host.plan.judge import judge
from trimtab.host.plan.planner import make_job
from trimtab.host.plan.rounds import first_round
from trimtab.host.plan.table import from_reference, yaw_at
from trimtab.host.route import YawProfile, load_route
from trimtab.host.shooting.stage import build_stage
from trimtab.host.vehicle import load_vehicle, to_parameters
from trimtab.protocol.blobs import YawNode

VEHICLE = load_vehicle("research")
SLENDER = ResidualModel(parts=(part("linear-drag", 0.5, 0.15, 0.1),))
ROUND = ResidualModel(parts=(part("linear-drag", 0.5, 0.5, 0.1),))
PRETZEL = load_route("pretzel")
START_DEG = 30.0
RATE = 1.2
FREE = PRETZEL.model_copy(update={"yaw": YawProfile(yaw_deg=(START_DEG,), free=True, rate_max_rad_s=RATE)})
GIVEN = PRETZEL.model_copy(update={"yaw": YawProfile(yaw_deg=(START_DEG,))})


@functools.cache
def _free(kind: str) -> Plan:
    return plan(FREE, VEHICLE, kind=kind, model=SLENDER)


def _network(frame: Frame) -> Network:
    layout = Layout(hidden=(8,), frame=frame)
    return Network(layout=layout, xi=layout.initial(np.random.default_rng(4)))


@pytest.mark.parametrize("kind", ["min-residual", "min-residual*"])
def test_free_heading_turns_the_slender_side_into_the_wind(kind: str) -> None:
    given = plan(GIVEN, VEHICLE, kind=kind, model=SLENDER)
    assert (_free(kind).residual_rms_m_s2 or np.inf) < 0.7 * (given.residual_rms_m_s2 or 0.0)


def test_free_heading_without_a_slender_side_costs_little() -> None:
    free, given = (plan(route, VEHICLE, kind="min-residual", model=ROUND) for route in (FREE, GIVEN))
    assert free.residual_rms_m_s2 == pytest.approx(given.residual_rms_m_s2, rel=0.05)


@pytest.mark.parametrize("kind", ["min-control", "min-residual", "min-residual*"])
def test_free_heading_is_accepted_on_board_and_keeps_its_rate_between_nodes(kind: str) -> None:
    made = _free(kind)
    reference = made.reference
    airframe, on_board = from_parameters(to_parameters(VEHICLE))
    verdict = check_reference(
        reference.nodes, reference.yaw_nodes(), airframe, on_board, origin=reference.origin_ned
    )
    assert verdict.ok, verdict.message
    yaws = reference.yaw_nodes()
    yaw, rate = yaw_at(yaws, np.linspace(0.0, reference.duration_us, 20_001))
    assert yaw[0] == pytest.approx(np.radians(START_DEG), abs=1e-6)
    assert abs(rate[[0, -1]]).max() < 1e-3
    assert abs(rate).max() <= RATE
    assert made.margins["yaw_rate_rad_s"] == pytest.approx(RATE - abs(rate).max(), abs=1e-4)
    assert np.diff([t_us for t_us, _, _ in yaws]).min() >= SPACING_US


def test_free_heading_repeated_is_the_same_bytes() -> None:
    again = plan(FREE, VEHICLE, kind="min-residual", model=SLENDER)
    assert again.reference.to_bytes() == _free("min-residual").reference.to_bytes()


@pytest.mark.parametrize("nodes", [60, 400])
def test_yaw_nodes_keep_to_the_solution(nodes: int) -> None:
    job = make_job(FREE, VEHICLE, kind="min-residual", model=SLENDER)
    _, _, solution = first_round(job, nodes=nodes)
    found = yaw_at(yaw_nodes(solution), solution.t_s * 1e6)[0]
    assert found == pytest.approx(solution.x[THETA.stop - 1], abs=1e-3)


def test_fastest_turn_is_found_inside_a_piece() -> None:
    # A rest-to-rest cubic turns 1.5 times as fast in its middle as on average.
    yaws = [YawNode(0, 0.0, 0.0), YawNode(1_000_000, 0.0, 0.0), YawNode(3_000_000, -1.0, 0.0)]
    assert fastest_turn(yaws) == pytest.approx((0.75, 2e6))


def test_judge_names_a_turn_that_is_too_fast() -> None:
    made = _free("min-residual")
    judged = judge(
        from_reference(made.reference), made.reference.yaw_nodes(), VEHICLE, made.limits, (),
        yaw_rate_max_rad_s=0.5,
    )  # fmt: skip
    assert not judged.ok
    assert re.search(r"node \d+ at .*: yaw rate 1\.1\d* above 0\.5 rad/s, at ", judged.message)


def test_min_snap_keeps_the_heading_it_starts_with() -> None:
    made = plan(FREE, VEHICLE, kind="min-snap")
    assert [yaw for _, yaw, _ in made.reference.yaw_nodes()] == [pytest.approx(np.radians(START_DEG))]
    assert "yaw_rate_rad_s" not in made.margins


@pytest.mark.parametrize(
    ("model", "match"),
    [
        (ResidualModel(network=_network("world")), "its network is in the world's frame; learn one"),
        (
            ResidualModel(parts=(*SLENDER.parts, part("wind", 1.0, 0.5))),
            "linear-drag with wind is fixed to the world; give the heading",
        ),
    ],
)
def test_free_heading_needs_a_model_that_turns_along(model: ResidualModel, match: str) -> None:
    for kind in ("min-residual", "min-control*"):
        with pytest.raises(UsageError, match=f"^mine.toml: yaw.free: .*{match}") as caught:
            plan(FREE, VEHICLE, kind=kind, model=model, source="mine.toml")
        assert caught.value.exit_code == 2
    assert plan(FREE, VEHICLE, kind="min-control", model=model).reference.yaws


@pytest.mark.usefixtures("virtual_machine")
def test_free_heading_takes_a_network_in_the_bodys_frame_and_wind_within_tolerance() -> None:
    parts = (*SLENDER.parts, part("wind", 0.02, 0.0))
    model = ResidualModel(parts=parts, adjusted=frozenset({"wind"}), network=_network("body"))
    made = plan(FREE, VEHICLE, kind="min-residual", model=model)
    assert made.residual_rms_m_s2


def test_residual_at_rest_turns_with_a_free_heading() -> None:
    """What a network in the body's frame predicts at rest is left out of the cost at every heading."""
    layout = Layout(hidden=(4,), frame="body")
    xi = layout.initial(np.random.default_rng(3))
    xi[[-11, -6, -1]] = 0.5, -0.2, 0.1  # the last layer's biases
    dynamics = Dynamics(vehicle=VEHICLE, model=ResidualModel(network=Network(layout=layout, xi=xi)))
    rest = dynamics.model.at_rest(VEHICLE, 0.0)
    assert rest == pytest.approx([0.5, -0.2, 0.1, 0.0, 0.0, 0.0])
    value = build_stage(dynamics.stage_model(minimise="residual", free_yaw=True), 1).value
    p = dynamics.parameters(np.zeros(1), rest=rest)[:, 0]
    costs = []
    for yaw in (0.0, 1.2, -2.9):
        x = dynamics.steady(yaw)
        costs.append(float(ca.DM(value(x, np.zeros(4), 1.0, 0.05, p)[1])))
    assert costs == pytest.approx([0.05 * 0.02 * 4.0] * 3, abs=1e-9)


def test_min_control_r_with_a_free_heading_is_refused() -> None:
    with pytest.raises(UsageError, match=r"yaw\.free: min-control-r tracks a path with its heading"):
        plan(FREE, VEHICLE, kind="min-control-r", model=ROUND)
