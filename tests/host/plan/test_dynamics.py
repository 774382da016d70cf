"""The planner's dynamics: units, rest, jerk and weights."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from tests.parts import part
from trimtab.host.effects import load_effects
from trimtab.host.models.network import Layout, Network
from trimtab.host.plan.dynamics import Dynamics, Weights
from trimtab.host.plan.residual import ResidualModel
from trimtab.host.vehicle import load_vehicle

EFFECTS = load_effects()
VEHICLE = load_vehicle("research")


def _evaluate(expression: ca.SX, *pairs: tuple[ca.SX, np.ndarray]) -> np.ndarray:
    function = ca.Function("f", [symbol for symbol, _ in pairs], [expression])
    return np.array(function(*[value for _, value in pairs])).ravel()


@pytest.mark.parametrize("velocity", [(0.0, 0.0, 0.0), (2.0, -1.0, 0.5)])
@pytest.mark.parametrize("augmented", [True, False])
def test_steady_state_does_not_accelerate(augmented: bool, velocity: tuple[float, float, float]) -> None:
    layout = Layout(hidden=(6,))
    network = Network(layout=layout, xi=0.2 * np.random.default_rng(0).standard_normal(layout.size))
    parts = (
        part("linear-drag", 0.4, 0.3, 0.2),
        part("wind", 2.0, -1.0),
        part("thrust-gain", 0.93),
        part("com-offset", 0.003, -0.002),
    )
    dynamics = Dynamics(
        vehicle=VEHICLE, model=ResidualModel(parts=parts, network=network), augmented=augmented
    )
    rest = dynamics.steady(0.7, velocity)
    x, u, p = ca.SX.sym("x", 16), ca.SX.sym("u", 4), ca.SX(dynamics.parameters(np.array([0.7])))
    slope = _evaluate(dynamics.derivative(x, u, p), (x, rest), (u, np.zeros(4)))
    if augmented:
        slope[3:6] += network.acceleration_ned(rest[3:6, None], rest[6:9, None]).ravel()
        assert np.abs(rest[6:8]).max() > 0.01
    else:
        np.testing.assert_allclose(rest[12:], 1.0)
    np.testing.assert_allclose(slope[:3], velocity)
    assert np.abs(slope[3:]).max() < 1e-9
    assert rest[8] == 0.7


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_planner_sentence_of_an_effect_says_nothing_exactly_where_plans_do_not_change(name: str) -> None:
    effect = EFFECTS[name]
    theta = tuple(parameter.neutral + parameter.typical for parameter in effect.parameters)
    drag = part("linear-drag", 0.4, 0.3, 0.2)
    beside = (drag,) if effect.requires_any else ()
    x, u = ca.SX.sym("x", 16), ca.SX.sym("u", 4)
    rng = np.random.default_rng(2)
    state = np.concatenate([0.3 * rng.standard_normal(12), rng.uniform(0.5, 1.5, 4)])
    state[2] -= 2.0  # well over the floor
    at = (x, state), (u, np.ones(4))

    def changes(augmented: bool) -> bool:
        seen = []
        for parts in (beside, (*beside, (effect, theta))):
            dynamics = Dynamics(vehicle=VEHICLE, model=ResidualModel(parts=parts), augmented=augmented)
            rest = dynamics.model.at_rest(VEHICLE, 0.0)
            p = ca.SX(dynamics.parameters(np.zeros(1), rest=rest))
            d = dynamics.residual(x, p)
            d = ca.vertcat(d, ca.SX(6 - d.shape[0], 1))
            seen.append(_evaluate(ca.vertcat(dynamics.derivative(x, u, p), d), *at))
        return bool(np.abs(seen[1] - seen[0]).max() > 1e-9)

    said = effect.closing.planner
    assert said.startswith("nothing") == (not changes(augmented=False))
    assert said.startswith("nothing:") == (not changes(augmented=True))


def test_hover_with_a_model_that_cannot_rest_raises() -> None:
    parts = (part("linear-drag", 3.0, 3.0, 3.0), part("wind", 1e3, 1e3))
    dynamics = Dynamics(vehicle=VEHICLE, model=ResidualModel(parts=parts), augmented=True)
    with pytest.raises(ValueError, match="no state of rest"):
        dynamics.steady(0.0)


def test_jerk_equals_the_acceleration_s_finite_difference() -> None:
    dynamics = Dynamics(vehicle=VEHICLE)
    x, u, p = ca.SX.sym("x", 16), ca.SX.sym("u", 4), ca.SX(dynamics.parameters(np.zeros(1)))
    derivative = ca.Function("f", [x, u], [dynamics.derivative(x, u, p)])
    squared = ca.Function("j", [x, u], [dynamics.jerk_squared(x, u)])
    rng = np.random.default_rng(1)
    state = np.concatenate([rng.standard_normal(6), 0.3 * rng.standard_normal(6), rng.uniform(0.5, 1.5, 4)])
    rates = rng.standard_normal(4)
    slope = np.array(derivative(state, rates)).ravel()
    step = 1e-6
    after, before = (np.array(derivative(state + s * step * slope, rates)).ravel()[3:6] for s in (1, -1))
    jerk = (after - before) / (2 * step)
    assert float(squared(state, rates)) == pytest.approx(float(jerk @ jerk), rel=1e-6)


def test_weights_that_are_not_positive_raise() -> None:
    with pytest.raises(ValueError, match="thrust_rate"):
        Weights(thrust_rate=0.0)
    assert Weights().scaled(2.0).control == 2.0 * Weights().control


def test_residual_at_rest_is_left_out_of_the_cost() -> None:
    layout = Layout(hidden=(6,), frame="body")
    network = Network(layout=layout, xi=np.random.default_rng(0).standard_normal(layout.size))
    parts = (part("linear-drag", 0.4, 0.3, 0.2), part("wind", 2.0, -1.0))
    dynamics = Dynamics(vehicle=VEHICLE, model=ResidualModel(parts=parts, network=network))
    rest = dynamics.model.at_rest(VEHICLE, 0.7)
    x = ca.SX.sym("x", 16)
    p = ca.SX(dynamics.parameters(np.array([0.7]), rest=rest))
    state = dynamics.steady(0.7)
    d = _evaluate(dynamics.residual(x, p), (x, state))
    d += network.acceleration_ned(state[3:6, None], state[6:9, None])[:, 0]
    assert np.abs(rest).max() > 0.3
    np.testing.assert_allclose(d, 0.0, atol=1e-12)
