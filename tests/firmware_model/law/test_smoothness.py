"""Nodes that do not fit their neighbours: the wrong one is named, planned references never are."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest

from trimtab.firmware_model.law import smoothness
from trimtab.firmware_model.law.checks import check_reference
from trimtab.firmware_model.law.limits import from_parameters
from trimtab.firmware_model.law.reference import septic
from trimtab.firmware_model.law.reference_verdict import ReferenceReason
from trimtab.firmware_model.law.smoothness import SMOOTH_M_S2, SMOOTH_S, worst_misfit
from trimtab.host.models.model import Model
from trimtab.host.plan import plan, table
from trimtab.host.route import load_route
from trimtab.host.vehicle import load_vehicle, to_parameters
from trimtab.protocol.blobs import Node, Reference

VEHICLE = load_vehicle("research")
MODEL = Model(
    vehicle_id=VEHICLE.id,
    vehicle_name=VEHICLE.name,
    effects={"linear-drag": {"dx": 0.6, "dy": 0.3, "dz": 0.1}},
)
AIRFRAME, LIMITS = from_parameters(to_parameters(VEHICLE))
PLANS = [
    ("pretzel", "min-snap", 100),
    ("pretzel", "min-snap", 50),
    ("random:6131", "min-snap", 70),
    ("random:6132", "min-residual", 100),
    ("figure-eight", "min-control", 70),
]


@pytest.fixture(scope="module", params=PLANS, ids=lambda plan: "-".join(map(str, plan)))
def reference(request: pytest.FixtureRequest) -> Reference:
    """A planned reference at this spacing (ms) of its nodes."""
    route, kind, spacing_ms = request.param
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(table.knot_times, "__defaults__", (spacing_ms * 1e-3, None))
        model = MODEL if kind == "min-residual" else None
        return plan(load_route(route), VEHICLE, kind=kind, model=model).reference


def _check(nodes):
    return check_reference(nodes, [(0, 0.0, 0.0)], AIRFRAME, LIMITS, ends_at_rest=True)


def _off(nodes, k, quantity, axis, by):
    """The nodes, one number of node k off."""
    state = list(nodes[k].state)
    state[3 * quantity + axis] += by
    return [*nodes[:k], Node(nodes[k].t_us, tuple(state)), *nodes[k + 1 :]]


def test_planned_reference_fits_itself_with_room_to_spare(reference) -> None:
    worst = worst_misfit(reference.nodes)
    assert worst is not None
    assert worst.value < 0.7 * worst.bound


def test_acceleration_off_by_half_a_metre_is_refused_with_its_node(reference) -> None:
    nodes = reference.nodes_ned()
    chance = random.Random(8301)
    last = len(nodes) - 1
    for k in (1, 2, *chance.sample(range(3, last - 2), 12), last - 2, last - 1):
        for axis in range(3):
            verdict = _check(_off(nodes, k, 2, axis, chance.choice((-0.5, 0.5))))
            assert (verdict.reason_code, verdict.node) == (ReferenceReason.NOT_SMOOTH, k), (
                k,
                axis,
                verdict.message,
            )
            assert verdict.quantity == "acceleration"
            assert f"node {k} at " in verdict.message
    for k in (0, last):  # an end that should rest is refused as one that does not
        assert _check(_off(nodes, k, 2, 0, 0.5)).node == k


@pytest.mark.parametrize("quantity", range(4))
def test_any_number_off_by_twice_the_bound_names_its_own_node(quantity) -> None:
    """Exact nodes of a smooth path: the misfit is the error itself, and at the neighbours it counts less."""
    ends = ((0.0, 0.0, -1.5, *(0.0,) * 9), (4.0, 1.0, -1.5, *(0.0,) * 9))
    nodes = []
    for k in range(41):
        p, v, a, j, _ = septic(4.0, 0.1 * k, *ends)
        nodes.append(Node(100_000 * k, (*p, *v, *a, *j)))
    least = worst_misfit(nodes)
    assert least is not None
    assert least.value < 1e-9
    bound = smoothness.SHARES[quantity] * SMOOTH_M_S2 * 0.1 ** (2 - quantity)
    for k in (1, 7, 20, 39):
        worst = worst_misfit(_off(nodes, k, quantity, 1, -2.0 * bound))
        assert worst is not None
        assert (worst.node, worst.quantity) == (k, quantity)
        assert (worst.value, worst.bound) == pytest.approx((2.0 * bound, bound))


def test_bound_grows_with_the_square_of_a_coarse_spacing() -> None:
    rest = (0.0,) * 9
    nodes = [(k * 480_000, (0.0, 0.0, -1.0, *rest)) for k in range(3)]
    nodes[1] = (480_000, (0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 9.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    worst = worst_misfit(nodes)
    assert worst == (1, 2, 9.0, pytest.approx(SMOOTH_M_S2 * (0.48 / SMOOTH_S) ** 2))
    assert worst_misfit(nodes[:2]) is None


def test_refusal_says_quantity_value_bound_and_unit() -> None:
    rest = (0.0,) * 9
    nodes = [(k * 100_000, (0.0, 0.0, -1.0, *rest)) for k in range(4)]
    nodes[2] = (200_000, (0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0))
    verdict = check_reference(nodes, [(0, 0.0, 0.0)], AIRFRAME, replace(LIMITS, jerk_max_m_s3=1e3))
    assert verdict.text == "acceleration off its neighbours by 0.5, above 0.25 m/s^2"
    assert (verdict.node, verdict.value, verdict.bound) == (2, 0.5, 0.25)
