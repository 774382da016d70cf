"""The chain rule of one interval against CasADi's own differentiation of the unrolled step."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from host.effects import load_effects
from host.models.network import Layout, Network
from host.plan.dynamics import INPUTS, PARAMETERS, STATES, Dynamics, ResidualModel, Weights, layers
from host.plan.stage import NETWORK_INPUTS, Layers, StageModel, build_stage
from host.route.shapes import Sphere
from host.vehicle import load_vehicle

_EFFECTS = load_effects()


def _stage_model(augmented: bool, network: bool, minimise: bool, weigh_time: bool) -> StageModel:
    vehicle = load_vehicle("research")
    parts = (
        (_EFFECTS["linear-drag"], (0.5, 0.4, 0.1)),
        (_EFFECTS["wind"], (1.0, -0.5)),
        (_EFFECTS["thrust-gain"], (0.95,)),
    )
    learned = None
    if network:
        layout = Layout(hidden=(8, 5))
        learned = Network(layout=layout, xi=0.4 * np.random.default_rng(0).standard_normal(layout.size))
    dynamics = Dynamics(
        vehicle=vehicle, model=ResidualModel(parts=parts, network=learned), augmented=augmented
    )
    return dynamics.stage_model(
        minimise_residual=minimise,
        weights=Weights(control=0.3, thrust_rate=0.02, yaw=10.0),
        limits=vehicle.limits,
        keep_out=[Sphere(kind="sphere", centre_m=(5.0, 0.0, 0.0), radius_m=1.0)],
        weigh_time=weigh_time,
    )


def _network(network: Layers, inputs: ca.SX) -> ca.SX:
    value = inputs
    for k, (weight, bias) in enumerate(network):
        value = ca.DM(weight) @ (ca.tanh(value) if k else value) + ca.DM(bias)
    return value


def _unrolled(model: StageModel) -> tuple[list[ca.SX], ca.SX, ca.SX, ca.SX]:
    """Arguments, next state, cost and path of an interval written down plainly."""
    x, u, h = ca.SX.sym("x", model.nx), ca.SX.sym("u", model.nu), ca.SX.sym("h")
    h0, p = ca.SX.sym("h0"), ca.SX.sym("p", model.np)

    def learned(state: ca.SX) -> ca.SX:
        return ca.SX(3, 1) if model.network is None else _network(model.network, state[NETWORK_INPUTS])

    def f(state: ca.SX) -> ca.SX:
        slope = model.derivative(state, u)
        if model.augmented:
            slope = slope + ca.vertcat(ca.SX(3, 1), learned(state), ca.SX(model.nx - 6, 1))
        return slope

    step = h * h0
    k1 = f(x)
    k2 = f(x + step / 2 * k1)
    k3 = f(x + step / 2 * k2)
    k4 = f(x + step * k3)
    cost = model.effort(x, u, p)
    if model.residual is not None:
        d = model.residual(x) + learned(x)
        cost = cost + ca.dot(d, d)
    cost = cost * step if model.weigh_time else cost
    return [x, u, h, h0, p], x + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4), cost, model.path(x, u, p)


def _point(seed: int) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    x = np.concatenate([2.0 * rng.standard_normal(6), 0.4 * rng.standard_normal(6), rng.uniform(0.5, 1.5, 4)])
    return [x, rng.standard_normal(INPUTS), np.array(1.1), np.array(0.08), np.array([0.1, 2.0])]


@pytest.mark.parametrize("weigh_time", [True, False])
@pytest.mark.parametrize("minimise", [True, False])
@pytest.mark.parametrize("network", [True, False])
@pytest.mark.parametrize("augmented", [True, False])
def test_stage_derivatives_equal_those_of_the_unrolled_step(
    augmented: bool, network: bool, minimise: bool, weigh_time: bool
) -> None:
    model = _stage_model(augmented, network, minimise, weigh_time)
    assert (model.nx, model.nu, model.np) == (STATES, INPUTS, PARAMETERS)
    stage = build_stage(model)
    arguments, x_next, cost, path = _unrolled(model)
    z, xu = ca.vertcat(*arguments[:3]), ca.vertcat(*arguments[:2])
    sigma, lam_x, lam_path = (
        ca.SX.sym("sigma"),
        ca.SX.sym("lam_x", model.nx),
        ca.SX.sym("lam_p", path.shape[0]),
    )
    lagrangian = sigma * cost + ca.dot(lam_x, x_next) + ca.dot(lam_path, path)
    oracle = ca.Function(
        "oracle",
        [*arguments, sigma, lam_x, lam_path],
        [
            x_next, cost, path, ca.gradient(cost, z), ca.jacobian(x_next, z), ca.jacobian(path, xu),
            ca.triu(ca.hessian(lagrangian, z)[0]),
        ],
    )  # fmt: skip
    rng = np.random.default_rng(5)
    for seed in range(3):
        point = _point(seed)
        weights = [np.array(1.3), rng.standard_normal(model.nx), rng.standard_normal(path.shape[0])]
        found = [
            *stage.value(*point),
            stage.gradient(*point),
            *stage.slopes(*point),
            stage.hessian(*point, *weights),
        ]
        for value, expected in zip(found, oracle(*point, *weights), strict=True):
            scale = max(1.0, np.abs(np.array(expected)).max())
            np.testing.assert_allclose(np.array(value), np.array(expected), atol=1e-11 * scale)


def test_stage_functions_of_the_same_model_have_the_same_instructions() -> None:
    first, second = (build_stage(_stage_model(True, True, True, True)) for _ in range(2))
    assert first.hessian.serialize() == second.hessian.serialize()


def test_layers_of_a_network_give_its_output() -> None:
    layout = Layout(hidden=(7, 4, 6))
    network = Network(layout=layout, xi=np.random.default_rng(1).standard_normal(layout.size))
    inputs = np.random.default_rng(2).standard_normal(6)
    value = np.array(ca.DM(_network(layers(network), ca.SX(ca.DM(inputs)))))
    np.testing.assert_allclose(value, layout.arrays(network.xi, inputs[:, None]), atol=1e-14)
