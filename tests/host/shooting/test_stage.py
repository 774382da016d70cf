"""Derivatives of intervals, in C and by CasADi over many at once, against those of the unrolled step."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from tests.parts import part
from trimtab.host.codegen import CASADI
from trimtab.host.models.airframe import THRUST, Part
from trimtab.host.models.network import Frame, Layout, Network
from trimtab.host.plan.dynamics import INPUTS, PATH_ROWS, STATES, Dynamics, Minimised, Weights
from trimtab.host.plan.residual import ResidualModel
from trimtab.host.plan.tracking_error import ERROR_RATE, ERROR_STATES
from trimtab.host.shooting import intervals
from trimtab.host.shooting import kernel as kernel_module
from trimtab.host.shooting.intervals import Engine, Intervals
from trimtab.host.shooting.kernel import kernel_key
from trimtab.host.shooting.stage import NETWORK_INPUTS, StageModel, build_stage
from trimtab.host.vehicle import Vehicle, load_vehicle

_VEHICLE = load_vehicle("research")
_FRAMES = (None, "world", "body")
_KNOWN = frozenset({"thrust-gain"})
_DRAG = (
    part("linear-drag", 0.5, 0.4, 0.1),
    part("wind", 1.0, -0.5),
    part("thrust-gain", 0.95),
)
_LOADS = {
    "mass": (part("mass", 1.1), part("frame-tilt", 0.02, -0.01)),
    "thrust": (
        part("ground-effect", 0.02),
        part("rotor-loss", 0.1, 0.0, -0.05, 0.0),
    ),
    "torque": (
        part("com-offset", 0.004, -0.006),
        part("gyroscopic", 6.0),
        part("inertia", 1.2, 0.9, 1.1),
        part("torque-bias", 2.0, 1.0, -0.5),
    ),
    "force and torque": (
        *_DRAG[:2],
        part("slung-payload", 0.1, 0.4, 0.05),
        part("thrust-inflow", 0.5),
    ),
}


@pytest.fixture(autouse=True)
def _narrow_blocks(monkeypatch) -> None:
    """Without a compiler, have several blocks, the last of them not full."""
    monkeypatch.setattr(intervals, "_WIDEST", 4)


def _dynamics(
    augmented: bool, frame: Frame | None, parts: tuple[Part, ...] = _DRAG, adjusted: frozenset[str] = _KNOWN
) -> Dynamics:
    learned = None
    if frame is not None:
        layout = Layout(hidden=(8, 5), frame=frame)
        learned = Network(layout=layout, xi=0.4 * np.random.default_rng(0).standard_normal(layout.size))
    model = ResidualModel(parts=parts, adjusted=adjusted, network=learned)
    return Dynamics(vehicle=_VEHICLE, model=model, augmented=augmented)


def _network(network: Network, state: ca.SX) -> ca.SX:
    """The network written down plainly."""
    layout = network.layout
    value = ca.vertcat(*layout.inputs(CASADI, ca.vertsplit(state)))
    for k, (weight, bias) in enumerate(layout.layers(network.xi)):
        value = ca.DM(weight) @ (ca.tanh(value) if k else value) + ca.DM(bias)
    return ca.vertcat(*layout.acceleration(CASADI, ca.vertsplit(state), ca.vertsplit(value)))


def _unrolled(model: StageModel) -> tuple[list[ca.SX], ca.SX, ca.SX, ca.SX]:
    """Arguments, next state, cost and path of an interval written down plainly."""
    x, u, h = ca.SX.sym("x", model.nx), ca.SX.sym("u", model.nu), ca.SX.sym("h")
    h0, p = ca.SX.sym("h0"), ca.SX.sym("p", model.np)

    def learned(state: ca.SX) -> ca.SX:
        return ca.SX(3, 1) if model.network is None else _network(model.network, state[NETWORK_INPUTS])

    def f(state: ca.SX) -> ca.SX:
        slope = model.derivative(state, u, p)
        if (rows := model.network_rows) is not None:
            slope = slope + ca.vertcat(ca.SX(rows.start, 1), learned(state), ca.SX(model.nx - rows.stop, 1))
        return slope

    step = h * h0
    k1 = f(x)
    k2 = f(x + step / 2 * k1)
    k3 = f(x + step / 2 * k2)
    k4 = f(x + step * k3)
    cost = model.effort(x, u, p)
    if model.residual is not None:
        d = model.residual(x, p)
        d = d + ca.vertcat(learned(x), ca.SX(d.shape[0] - 3, 1))
        cost = cost + ca.dot(d, d)
    cost = cost * step
    return [x, u, h, h0, p], x + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4), cost, model.path(x, u, p)


def _points(
    dynamics: Dynamics, count: int, states: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """x, u, h, h0_s and parameters of intervals, one a column."""
    rng = np.random.default_rng(7)
    x = np.concatenate(
        [
            2.0 * rng.standard_normal((6, count)),
            0.4 * rng.standard_normal((6, count)),
            rng.uniform(0.5, 1.5, (4, count)),
            0.1 * np.random.default_rng(8).standard_normal((states - STATES, count)),
        ]
    )
    p = dynamics.parameters(
        rng.uniform(-0.2, 0.2, count),
        smoothing=2.0,
        weights=Weights(control=0.3, thrust_rate=0.02, yaw=10.0, time=0.7),
        rest=np.array([0.2, -0.1, 0.3, 0.1, -0.3, 0.2]),
    )
    steps = rng.uniform(0.05, 0.1, count)
    return x, rng.standard_normal((INPUTS, count)), rng.uniform(0.8, 1.2, count), steps, p


def _on_both_engines(*cases: tuple[Any, ...], compiled: tuple[tuple[Any, ...], ...]) -> list[Any]:
    """Every case in the virtual machine and in C; in C those not in `compiled` are left to the full run."""
    rest = [case for case in cases if case not in compiled]
    return [
        *((*case, "vm") for case in cases),
        *((*case, "c") for case in compiled),
        *(pytest.param(*case, "c", marks=pytest.mark.full) for case in rest),
    ]


@pytest.mark.parametrize(
    ("augmented", "frame", "minimise", "engine"),
    _on_both_engines(
        *itertools.product((True, False), _FRAMES, ("residual", None)),
        *((False, frame, "error") for frame in _FRAMES),
        compiled=((True, None, "residual"), (True, "body", "residual"), (False, "body", "error")),
    ),
)
def test_derivatives_of_intervals_equal_those_of_the_unrolled_step(
    augmented: bool, frame: Frame | None, minimise: Minimised | None, engine: str, require
) -> None:
    if engine == "c":
        require("compiler")
    dynamics = _dynamics(augmented, frame)
    _check_derivatives(dynamics, dynamics.stage_model(minimise=minimise), engine)


@pytest.mark.parametrize("engine", ["vm", pytest.param("c", marks=pytest.mark.full)])
def test_derivatives_of_intervals_with_a_free_heading_equal_those_of_the_unrolled_step(
    engine: str, require
) -> None:
    if engine == "c":
        require("compiler")
    cases: tuple[tuple[bool, Minimised], ...] = ((True, "residual"), (False, "error"))
    for augmented, minimise in cases:
        dynamics = _dynamics(augmented, "body")
        model = dynamics.stage_model(minimise=minimise, free_yaw=True)
        assert model.path(*(ca.SX.zeros(n) for n in (model.nx, model.nu, model.np))).numel() == PATH_ROWS + 1
        _check_derivatives(dynamics, model, engine)


@pytest.mark.parametrize(
    ("loads", "rows", "augmented", "frame", "engine"),
    _on_both_engines(
        *(
            (*loads, augmented, frame)
            for *loads, frame in (
                ("mass", 3, None),
                ("thrust", 6, None),
                ("torque", 6, None),
                ("force and torque", 6, None),
                ("force and torque", 6, "body"),
            )
            for augmented in (True, False)
        ),
        compiled=(("torque", 6, False, None),),
    ),
)
def test_derivatives_with_a_residual_of_thrust_and_torque_equal_those_of_the_unrolled_step(
    loads: str, rows: int, augmented: bool, frame: Frame | None, engine: str, require
) -> None:
    if engine == "c":
        require("compiler")
    dynamics = _dynamics(augmented, frame, _LOADS[loads], frozenset())
    x = ca.SX.sym("x", STATES)
    d = dynamics.residual(x, ca.SX(dynamics.parameters(np.zeros(1))))
    assert d.shape == (rows, 1)
    assert ca.jacobian(d, x[THRUST]).nnz() > 0
    model = dynamics.stage_model(minimise="residual")
    _check_derivatives(dynamics, model, engine)


def _check_derivatives(dynamics: Dynamics, model: StageModel, engine: str) -> None:
    assert (model.nx - (ERROR_STATES if model.network_rows == ERROR_RATE else 0), model.nu) == (
        STATES,
        INPUTS,
    )
    arguments, x_next, cost, path = _unrolled(model)
    z, xu = ca.vertcat(*arguments[:3]), ca.vertcat(*arguments[:2])
    rows = path.shape[0]
    sigma, lam_x, lam_path = ca.SX.sym("sigma"), ca.SX.sym("lam_x", model.nx), ca.SX.sym("lam_p", rows)
    lagrangian = sigma * cost + ca.dot(lam_x, x_next) + ca.dot(lam_path, path)
    oracle = ca.Function(
        "oracle",
        [*arguments, sigma, lam_x, lam_path],
        [
            x_next, cost, path, ca.gradient(cost, z), ca.jacobian(x_next, z), ca.jacobian(path, xu),
            ca.triu(ca.hessian(lagrangian, z)[0]),
        ],
    )  # fmt: skip
    count = 11  # no multiple of the lanes
    x, u, h, h0_s, p = _points(dynamics, count, model.nx)
    rng = np.random.default_rng(5)
    weights = rng.standard_normal((count, model.nx)), rng.standard_normal((count, rows))
    made = Engine(model, engine)
    assert (made.kernel is not None) == (engine == "c")
    found = _evaluated(made.over(h0_s, p), rows, (x.T, u.T, h), weights)
    for k in range(count):
        expected = oracle(x[:, k], u[:, k], h[k], h0_s[k], p[:, k], 1.3, *(each[k] for each in weights))
        for value, wanted in zip(found, (np.array(each) for each in expected), strict=True):
            scale = max(1.0, np.abs(wanted).max())
            np.testing.assert_allclose(value[k], wanted, atol=1e-11 * scale)


def _evaluated(
    intervals: Intervals, rows: int, where: tuple[np.ndarray, ...], weights: tuple[np.ndarray, ...]
) -> list[np.ndarray]:
    """All outputs, (N, height, width) each; rows: of the path."""
    intervals.set(*where)
    intervals.values()
    intervals.slopes()
    states = where[0].shape[1]
    nz = states + INPUTS + 1
    gradient = intervals.cost_slope.dense(nz)
    intervals.gradient()
    np.testing.assert_array_equal(intervals.cost_slope.dense(nz), gradient)
    intervals.compute_hessian(1.3, *weights)
    return [
        intervals.x_next.dense(states),
        intervals.cost.dense(1),
        intervals.path.dense(rows),
        gradient,
        intervals.x_slope.dense(states, nz),
        intervals.path_slope.dense(rows, nz - 1),
        intervals.hessian.dense(nz, nz),
    ]


def test_results_are_the_same_bits_for_any_number_of_lanes(compiler_of_width, monkeypatch) -> None:
    dynamics = _dynamics(False, "body")
    model, count = dynamics.stage_model(minimise="residual"), 11
    x, u, h, h0_s, p = _points(dynamics, count, model.nx)
    results = []
    for lanes in (2, 4, 8):
        monkeypatch.setattr(
            "trimtab.host.codegen.compiler.find_compiler", lambda lanes=lanes: compiler_of_width(lanes)
        )
        intervals = Engine(model, "c").over(h0_s, p)
        rows, rng = intervals.path.rows.size, np.random.default_rng(5)
        weights = rng.standard_normal((count, model.nx)), rng.standard_normal((count, rows))
        results.append([part.tobytes() for part in _evaluated(intervals, rows, (x.T, u.T, h), weights)])
    assert results[1:] == results[:1] * 2


def test_other_weights_limits_and_values_need_no_other_kernel() -> None:
    first = _dynamics(True, "world", (*_LOADS["torque"], *_LOADS["force and torque"]))
    layout = Layout(hidden=(8, 5))
    other = ResidualModel(
        parts=tuple((effect, tuple(0.5 * value for value in theta)) for effect, theta in first.model.parts),
        adjusted=first.model.adjusted,
        network=Network(layout=layout, xi=np.ones(layout.size)),
    )
    models = [
        Dynamics(vehicle=_VEHICLE, model=model, augmented=True).stage_model(minimise="residual")
        for model in (first.model, other)
    ]
    assert kernel_key(models[0]) == kernel_key(models[1])


def test_kernel_key_follows_everything_that_its_source_does(monkeypatch: pytest.MonkeyPatch) -> None:
    def key(*hidden: int, vehicle: Vehicle = _VEHICLE, frame: Frame = "world", augmented: bool = True) -> str:
        layout = Layout(hidden=hidden, frame=frame)
        model = ResidualModel(network=Network(layout=layout, xi=np.ones(layout.size)))
        dynamics = Dynamics(vehicle=vehicle, model=model, augmented=augmented)
        return kernel_key(dynamics.stage_model(minimise="residual"))

    heavier = _VEHICLE.replace(mass_kg=1.01 * _VEHICLE.mass_kg)
    plain = Dynamics(vehicle=_VEHICLE, model=ResidualModel(), augmented=False)
    keys = [
        key(8, 5),
        key(5, 8),
        key(8, 5, frame="body"),
        key(8, 5, vehicle=heavier),
        key(8, 5, augmented=False),
        kernel_key(plain.stage_model(minimise=None)),
        kernel_key(plain.stage_model(minimise=None, free_yaw=True)),
    ]
    monkeypatch.setattr(kernel_module, "_generators", lambda: "another version")
    assert len({*keys, key(8, 5)}) == len(keys) + 1


def test_kernel_in_the_cache_is_found_without_its_source(
    monkeypatch: pytest.MonkeyPatch, require: Callable[[str], None]
) -> None:
    require("compiler")
    model = _dynamics(True, "world").stage_model(minimise="residual")
    Engine(model, "c")
    monkeypatch.setattr(kernel_module, "_Parts", None)
    assert Engine(model, "c").kernel is not None


def test_cost_of_a_tracked_path_is_its_weight_times_the_squared_distance() -> None:
    dynamics = _dynamics(True, None)
    tracked = np.array([[1.0], [2.0], [-1.5]])
    p = dynamics.parameters(np.zeros(1), weights=Weights(tracking=7.0), tracked_ned=tracked)
    plain, tracking = (dynamics.stage_model(minimise=None, track_path=track) for track in (False, True))
    x = dynamics.steady(0.0)
    x[:3] = (1.5, 2.0, -1.0)
    cost = [
        float(model.effort(ca.SX(x), ca.SX(INPUTS, 1), ca.SX(p[: model.np, 0])))
        for model in (plain, tracking)
    ]
    assert cost[1] - cost[0] == pytest.approx(7.0 * 0.5)
    assert p.shape[0] == tracking.np


def test_stage_functions_of_the_same_model_have_the_same_instructions() -> None:
    def model() -> StageModel:
        return _dynamics(True, "world").stage_model(minimise="residual")

    first, second = (build_stage(model(), 3) for _ in range(2))
    assert first.hessian.serialize() == second.hessian.serialize()


@pytest.mark.parametrize("frame", ["world", "body"])
def test_layers_of_a_network_give_its_output(frame: Frame) -> None:
    layout = Layout(hidden=(7, 4, 6), frame=frame)
    network = Network(layout=layout, xi=np.random.default_rng(1).standard_normal(layout.size))
    state = np.random.default_rng(2).standard_normal(6)
    value = np.array(ca.DM(_network(network, ca.SX(ca.DM(state)))))
    np.testing.assert_allclose(value, layout.arrays(network.xi, state[:, None]), atol=1e-14)
