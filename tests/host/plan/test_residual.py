"""The residual that a plan minimises: what counts, and what a model file makes of it."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from tests.parts import part
from trimtab.host.codegen import NUMPY
from trimtab.host.effects import load_effects
from trimtab.host.models.airframe import Part
from trimtab.host.models.dynamics import rigid_body
from trimtab.host.models.model import Model, Values
from trimtab.host.plan.dynamics import Dynamics
from trimtab.host.plan.residual import ResidualModel
from trimtab.host.vehicle import load_vehicle

EFFECTS = load_effects()
VEHICLE = load_vehicle("research")


def _evaluate(expression: ca.SX, *pairs: tuple[ca.SX, np.ndarray]) -> np.ndarray:
    function = ca.Function("f", [symbol for symbol, _ in pairs], [expression])
    return np.array(function(*[value for _, value in pairs])).ravel()


def test_residual_of_a_model_without_a_force_is_nothing_to_minimise() -> None:
    assert not ResidualModel(parts=(part("motor-lag", 0.01),)).has_residual(VEHICLE)
    assert ResidualModel(parts=(part("quadratic-drag", 0.02),)).has_residual(VEHICLE)


@pytest.mark.parametrize(
    ("name", "theta", "varies"),
    [
        ("torque-bias", (2.0, 1.0, 0.5), False),
        ("frame-tilt", (0.02, 0.01), False),
        ("battery-sag", (1.7,), False),
        ("com-offset", (0.0, 0.0), False),
        ("com-offset", (0.004, 0.0), True),
        ("thrust-gain", (0.9,), True),
        ("mass", (1.1,), True),
        ("inertia", (1.2, 1.0, 1.0), True),
        ("gyroscopic", (4.0,), True),
        ("ground-effect", (0.012,), True),
        ("rotor-loss", (0.1, 0.0, 0.0, 0.0), True),
    ],
)
def test_residual_that_is_the_same_in_every_state_is_nothing_to_minimise(
    name: str, theta: tuple[float, ...], varies: bool
) -> None:
    parts = (part(name, *theta),)
    assert ResidualModel(parts=parts).has_residual(VEHICLE) is varies
    assert not ResidualModel(parts=parts, adjusted=frozenset({name})).has_residual(VEHICLE)


def test_residual_of_a_drag_that_only_moved_within_tolerance_is_nothing_to_minimise() -> None:
    drag = {"linear-drag": {"dx": 0.012, "dy": -0.004, "dz": 0.0}, "quadratic-drag": {"c": 0.001}}

    def has_residual(effects: Values, adjustments: Values) -> bool:
        model = Model(
            vehicle_id=VEHICLE.id, vehicle_name=VEHICLE.name, effects=effects, adjustments=adjustments
        )
        return ResidualModel.of(model, EFFECTS).has_residual(VEHICLE)

    assert not has_residual({"motor-lag": {"extra_s": 0.01}}, drag)
    assert has_residual(drag, {})


def test_residual_model_of_a_file_holds_effects_and_adjustments() -> None:
    model = Model(
        vehicle_id=VEHICLE.id,
        vehicle_name=VEHICLE.name,
        effects={"linear-drag": {"dx": 0.4}},
        adjustments={"mass": {"factor": 1.01}},
    )
    taken = ResidualModel.of(model, EFFECTS)
    assert [(effect.name, theta) for effect, theta in taken.parts] == [
        ("linear-drag", part("linear-drag", 0.4)[1]),
        ("mass", (1.01,)),
    ]
    assert taken.id == model.id


def _flight(count: int) -> np.ndarray:
    """(16, n) states of flight well over the floor, thrusts in N."""
    rng = np.random.default_rng(4)
    x = np.concatenate([0.4 * rng.standard_normal((12, count)), rng.uniform(0.5, 1.5, (4, count))])
    x[2] -= 2.5
    x[12:] *= VEHICLE.mass_kg * 9.80665 / 4.0
    return x


def _acceleration(x: np.ndarray, parts: tuple[Part, ...]) -> np.ndarray:
    """(6, n) acceleration NED and angular acceleration."""
    rows = rigid_body(NUMPY, VEHICLE, parts, list(x))
    return np.array([np.broadcast_to(row, x.shape[1:]) for row in [*rows[3:6], *rows[9:12]]])


def test_residual_is_the_augmented_less_the_nominal_acceleration_with_torque_by_arm_and_mass() -> None:
    parts = (
        part("mass", 1.1),
        part("inertia", 1.2, 0.9, 1.1),
        part("rotor-loss", 0.1, 0.0, 0.0, 0.0),
        part("com-offset", 0.004, -0.002),
    )
    x = _flight(5)
    change = _acceleration(x, parts) - _acceleration(x, ())
    arm_m = 0.088 * np.sqrt(2.0)
    change[3:] *= np.array(VEHICLE.inertia_kg_m2)[:, None] / (arm_m * VEHICLE.mass_kg)
    found = ResidualModel(parts=parts).rows(NUMPY, VEHICLE, list(x))
    np.testing.assert_allclose(np.array(found), change, atol=1e-12)


def test_residual_beside_a_drag_is_the_drags() -> None:
    drag, offset = part("linear-drag", 0.4, 0.3, 0.2), part("com-offset", 0.004, -0.002)
    x = _flight(5)
    alone = ResidualModel(parts=(drag,)).rows(NUMPY, VEHICLE, list(x))
    np.testing.assert_array_equal(ResidualModel(parts=(drag, offset)).rows(NUMPY, VEHICLE, list(x)), alone)
    np.testing.assert_allclose(np.array(alone), (_acceleration(x, (drag,)) - _acceleration(x, ()))[:3])
    assert len(ResidualModel(parts=(offset,)).rows(NUMPY, VEHICLE, list(x))) == 6


def test_residual_of_effects_within_tolerance_counts_their_force_alone() -> None:
    drag, gain = part("linear-drag", 0.4, 0.3, 0.2), part("thrust-gain", 1.005)
    offset = part("com-offset", 0.004, -0.002, 0.0)
    x = _flight(5)

    def rows(*parts: Part) -> np.ndarray:
        model = ResidualModel(parts=parts, adjusted=frozenset({"thrust-gain"}))
        values = model.rows(NUMPY, VEHICLE, list(x))
        return np.array([np.broadcast_to(row, x.shape[1:]) for row in values])

    np.testing.assert_array_equal(rows(drag, gain), rows(drag))
    np.testing.assert_array_equal(rows(offset, gain)[:3], 0.0)
    np.testing.assert_allclose(rows(offset, gain)[3:], 1.005 * rows(offset)[3:], atol=1e-12)


def test_constant_bias_leaves_the_cost_and_the_figures_unchanged() -> None:
    offset = (part("com-offset", 0.004, -0.002),)
    bias = (part("torque-bias", 2.0, -1.0, 0.5), part("frame-tilt", 0.02, 0.01))
    x, found, figures = _flight(1)[:, 0], [], []
    for parts in (offset, offset + bias):
        dynamics = Dynamics(vehicle=VEHICLE, model=ResidualModel(parts=parts))
        state, rest = ca.SX.sym("x", 16), dynamics.model.at_rest(VEHICLE, 0.3)
        p = ca.SX(dynamics.parameters(np.zeros(1), rest=rest))
        found.append(_evaluate(dynamics.residual(state, p), (state, x)))
        figures.append(dynamics.model.along(VEHICLE, x[:, None]))
    assert np.abs(rest).max() > 0.1
    np.testing.assert_allclose(found[1], found[0], atol=1e-12)
    np.testing.assert_allclose(figures[1], figures[0], atol=1e-12)


@pytest.mark.parametrize(
    ("name", "theta"), [("linear-drag", (0.4, 0.3, 0.2)), ("rotor-loss", (0.1, 0.0, 0.0, 0.0))]
)
def test_figures_count_what_the_cost_counts_without_wind_or_a_network(
    name: str, theta: tuple[float, ...]
) -> None:
    parts = (part(name, *theta),)
    dynamics = Dynamics(vehicle=VEHICLE, model=ResidualModel(parts=parts))
    x = _flight(1)[:, 0]
    symbol, p = (
        ca.SX.sym("x", 16),
        dynamics.parameters(np.zeros(1), rest=dynamics.model.at_rest(VEHICLE, 0.0)),
    )
    scaled = x / np.array([1.0] * 12 + [dynamics.hover_n] * 4)
    counted = _evaluate(dynamics.residual(symbol, ca.SX(p)), (symbol, scaled))
    np.testing.assert_allclose(dynamics.model.along(VEHICLE, x[:, None])[:, 0], counted, atol=1e-12)
