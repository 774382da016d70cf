"""The solver against Ipopt on the same problem written plainly, and its status at the edges."""

from __future__ import annotations

import functools
import tracemalloc
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest

from tests.host.control.examples import DRAG, NETWORK, VEHICLE, reference, settings
from tests.parts import part
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.host.control.closed_loop import Plant, fly
from trimtab.host.control.dynamics import STATES, ControlModel, rate_lag_s
from trimtab.host.control.interface import SolveStatus
from trimtab.host.control.mpc import Mpc, cost_parameters
from trimtab.host.control.solver import Solution, TrackingSolver
from trimtab.host.models.reference import flat_outputs

RANGE_SHARE = 2e-4
"""Greatest difference of a command as a share of its range: twice the tolerance at which a solve ends."""
NEAR_BOUND_SHARE = 4e-3
"""The same where an input is about to reach or leave a bound, within 1 % of its range."""
MODEL = ControlModel(
    vehicle=VEHICLE,
    rate_lag_s=rate_lag_s(VEHICLE),
    parts=(part("linear-drag", *DRAG),),
    network=NETWORK,
)
SETTINGS = settings()


def _rotation(phi: ca.SX, theta: ca.SX, psi: ca.SX) -> ca.SX:
    """R_z(psi) R_y(theta) R_x(phi), multiplied out by CasADi."""
    c, s = ca.cos, ca.sin
    z = ca.blockcat([[c(psi), -s(psi), 0], [s(psi), c(psi), 0], [0, 0, 1]])
    y = ca.blockcat([[c(theta), 0, s(theta)], [0, 1, 0], [-s(theta), 0, c(theta)]])
    x = ca.blockcat([[1, 0, 0], [0, c(phi), -s(phi)], [0, s(phi), c(phi)]])
    return z @ y @ x


def _xdot(x: ca.SX, u: ca.SX) -> ca.SX:
    """The model's equations from the paper, the network layer by layer at every evaluation."""
    v, (phi, theta, psi), w, thrust = x[3:6], ca.vertsplit(x[6:9]), x[9:12], x[12]
    R = _rotation(phi, theta, psi)
    air = R.T @ v
    value = air if NETWORK.layout.frame == "body" else x[3:9]
    *hidden, last = NETWORK.layout.layers(NETWORK.xi)
    for weight, bias in hidden:
        value = ca.tanh(ca.DM(weight) @ value + ca.DM(bias))
    learned = R @ (ca.DM(last[0]) @ value + ca.DM(last[1]))
    a = ca.DM([0, 0, GRAVITY]) - R[:, 2] * thrust / VEHICLE.mass_kg - R @ (ca.DM(DRAG) * air) + learned
    W = ca.blockcat(
        [
            [1, ca.sin(phi) * ca.tan(theta), ca.cos(phi) * ca.tan(theta)],
            [0, ca.cos(phi), -ca.sin(phi)],
            [0, ca.sin(phi) / ca.cos(theta), ca.cos(phi) / ca.cos(theta)],
        ]
    )
    lag = ca.DM(MODEL.rate_lag_s)
    return ca.vertcat(v, a, W @ w, (u[:3] - w) / lag, (u[3] - thrust) / VEHICLE.motor_lag_s)


@functools.cache
def _ipopt() -> ca.Function:
    """Single shooting over the inputs, (x0, targets) as parameters."""
    n, h = SETTINGS.stages, SETTINGS.step_s
    w = SETTINGS.weights
    state = [*w.position_1_m2, *w.velocity_s2_m2, *w.attitude_1_rad2, *w.rate_s2_rad2, 0.0]
    inputs = [*w.rate_command_s2_rad2, w.thrust_command / (VEHICLE.mass_kg * GRAVITY) ** 2]
    x, u = ca.SX.sym("x", 13), ca.SX.sym("u", 4)
    k1 = _xdot(x, u)
    k2 = _xdot(x + h / 2 * k1, u)
    k3 = _xdot(x + h / 2 * k2, u)
    k4 = _xdot(x + h * k3, u)
    step = ca.Function("step", [x, u], [x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])
    U, X = ca.MX.sym("U", 4, n), ca.MX.sym("X", 13, n)
    x0, targets = ca.MX.sym("x0", 13), ca.MX.sym("targets", 17, n + 1)
    tilt_cos = np.cos(np.radians(VEHICLE.limits.tilt_max_deg))
    cost, gaps, now = ca.MX(0), [], x0
    for i in range(n + 1):
        factor = w.terminal if i == n else 1.0
        error = now - targets[:13, i]
        short = ca.fmax(0, tilt_cos - ca.cos(now[6]) * ca.cos(now[7]))
        cost += factor * ca.dot(ca.DM(state), error**2) / 2 + w.tilt * short**2 / 2
        if i < n:
            cost += ca.dot(ca.DM(inputs), (U[:, i] - targets[13:, i]) ** 2) / 2
            gaps.append(step(now, U[:, i]) - X[:, i])
            now = X[:, i]
    nlp = {"x": ca.veccat(U, X), "p": ca.veccat(x0, targets), "f": cost, "g": ca.vertcat(*gaps)}
    options = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-10}
    return ca.nlpsol("oracle", "ipopt", nlp, {**options, "expand": True})


def _oracle(x0: np.ndarray, targets: np.ndarray, start: np.ndarray) -> np.ndarray:
    n = SETTINGS.stages
    low, high = MODEL.input_bounds()
    states = np.full(13 * n, np.inf)
    found = _ipopt()(
        x0=np.concatenate([start.ravel(), targets[1:, :13].ravel()]),
        p=np.concatenate([x0, targets.ravel()]),
        lbx=np.concatenate([np.tile(low, n), -states]),
        ubx=np.concatenate([np.tile(high, n), states]),
        lbg=0.0,
        ubg=0.0,
    )
    assert _ipopt().stats()["success"]
    return np.array(found["x"]).ravel()[: 4 * n].reshape(n, 4)


def _make_solver() -> TrackingSolver:
    cost = cost_parameters(SETTINGS, MODEL)
    return TrackingSolver(
        MODEL, stages=SETTINGS.stages, step_s=SETTINGS.step_s, cost=cost, tolerance=SETTINGS.tolerance
    )


@functools.cache
def _solver() -> TrackingSolver:
    return _make_solver()


def _solve(x0: np.ndarray, targets: np.ndarray) -> Solution:
    solver = _solver()
    return solver.solve(x0, targets, solver.start(targets), iterations_max=100)


def _consecutive_problems() -> list[tuple[np.ndarray, np.ndarray]]:
    """Ten states of a flight at the times of control steps, and targets."""
    flown = fly(Mpc(SETTINGS, VEHICLE), Plant(MODEL), reference())
    horizon_s = SETTINGS.step_s * np.arange(SETTINGS.stages + 1)
    return [
        (flown.x[k], _solver().targets(flat_outputs(reference(), flown.t_s[k] + horizon_s)))
        for k in range(100, 110)
    ]


@functools.cache
def _flown_problems() -> list[tuple[np.ndarray, np.ndarray]]:
    """States of a flight that a nominal controller loses to drag, half of them disturbed, and targets."""
    flown = fly(Mpc(SETTINGS, VEHICLE), Plant(MODEL), reference())
    rng = np.random.default_rng(5)
    spread = np.repeat([0.4, 1.0, 0.3, 1.5, 1.0], [3, 3, 3, 3, 1])
    problems = []
    for i, k in enumerate(np.linspace(0, len(flown.t_s) - 1, 200).astype(int)):
        x0 = flown.x[k] + (i % 2) * spread * rng.uniform(-1.0, 1.0, STATES)
        times = flown.t_s[k] + SETTINGS.step_s * np.arange(SETTINGS.stages + 1)
        problems.append((x0, _solver().targets(flat_outputs(reference(), times))))
    return problems


def test_solution_at_200_states_equals_that_of_ipopt() -> None:
    low, high = MODEL.input_bounds()
    differs, near_bound, at_bound = [], [], 0
    for x0, targets in _flown_problems():
        solution = _solve(x0, targets)
        assert solution.status is SolveStatus.SOLVED
        assert solution.plan is not None
        expected = _oracle(x0, targets, solution.plan.u[:-1])
        room = np.minimum(expected - low, high - expected) / (high - low)
        differs.append(float((np.abs(solution.plan.u[0] - expected[0]) / (high - low)).max()))
        near_bound.append(bool((room < 0.01).any()))
        at_bound += bool((room[0] < 1e-4).any())
    far = ~np.array(near_bound)
    assert np.array(differs)[far].max() <= RANGE_SHARE
    assert max(differs) <= NEAR_BOUND_SHARE
    assert far.sum() >= 50
    assert at_bound >= 10  # the bounds are part of the comparison


def test_solution_predicts_states_of_its_inputs() -> None:
    x0, targets = _flown_problems()[41]
    plan = _solve(x0, targets).plan
    assert plan is not None
    np.testing.assert_array_equal(plan.x[0], x0)
    for k, u in enumerate(plan.u):
        x = _solver().advance(plan.x[k], u, SETTINGS.step_s)
        np.testing.assert_allclose(plan.x[k + 1], x, rtol=0.0, atol=1e-4)


def test_shifted_plan_of_a_solution_needs_fewer_iterations_than_the_targets() -> None:
    cold = warm = 0
    for (x0, targets), (x_next, targets_next) in pairwise(_consecutive_problems()):
        first = _solve(x0, targets)
        assert first.plan is not None
        again = _solver().solve(x_next, targets_next, first.plan.shifted(1), iterations_max=100)
        assert again.status is SolveStatus.SOLVED
        warm += again.iterations
        cold += _solve(x_next, targets_next).iterations
    assert warm < 0.5 * cold


def test_solve_after_a_spent_budget_goes_on_where_the_last_one_stopped() -> None:
    x0, targets = max(_flown_problems(), key=lambda problem: _solve(*problem).iterations)
    needed = _solve(x0, targets).iterations
    solver = _solver()
    solution = solver.solve(x0, targets, solver.start(targets), iterations_max=needed // 2)
    assert solution.status is SolveStatus.BUDGET_SPENT
    assert solution.plan is not None
    rest = solver.solve(x0, targets, solution.plan, iterations_max=needed)
    assert rest.status is SolveStatus.SOLVED


def test_solve_leaves_no_memory_behind_and_its_state_does_not_matter() -> None:
    x0, targets = _flown_problems()[41]
    first = _solve(x0, targets)
    _solve(np.full(STATES, np.nan), targets)
    again = _solve(x0, targets)
    assert first.plan is not None
    assert again.plan is not None
    assert first.plan.u.tobytes() == again.plan.u.tobytes()
    del again
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for _ in range(20):
        _solve(x0, targets)
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown < 20_000


def test_budget_of_one_iteration_is_spent_from_a_far_start() -> None:
    x0, targets = _flown_problems()[41]
    solver = _solver()
    start = solver.start(targets)
    solution = solver.solve(x0, targets, start, iterations_max=1)
    assert solution.status is SolveStatus.BUDGET_SPENT
    assert solution.iterations == 1
    assert solution.plan is not None


@pytest.mark.parametrize("value", [np.inf, np.nan, 1e200])
def test_start_that_cannot_be_predicted_is_infeasible(value: float) -> None:
    x0, targets = _flown_problems()[40]
    far = x0.copy()
    far[4] = value
    solution = _solve(far, targets)
    assert (solution.plan, solution.status) == (None, SolveStatus.INFEASIBLE)


def test_targets_are_met_by_their_own_inputs() -> None:
    # A vehicle on the targets that gets their inputs stays on them: residual, attitude and lags agree.
    solver = _solver()
    for t_s in (1.0, 3.0, 6.0):
        times = t_s + SETTINGS.step_s * np.arange(SETTINGS.stages + 1)
        targets = solver.targets(flat_outputs(reference(), times))
        x = targets[0, :STATES]
        for row in targets[:-1]:
            x = solver.advance(x, row[STATES:], SETTINGS.step_s)
        assert np.linalg.norm(x[:3] - targets[-1, :3]) < 2e-3


def test_solution_without_a_compiler_is_nearly_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    low, high = MODEL.input_bounds()
    problems = _flown_problems()[:6]
    compiled = [_solve(*problem) for problem in problems]
    monkeypatch.setenv("TRIMTAB_ENGINE", "vm")
    machine = _make_solver()
    for (x0, targets), expected in zip(problems, compiled, strict=True):
        got = machine.solve(x0, targets, machine.start(targets), iterations_max=100)
        assert got.status is SolveStatus.SOLVED
        assert got.plan is not None
        assert expected.plan is not None
        assert (np.abs(got.plan.u[0] - expected.plan.u[0]) / (high - low)).max() <= NEAR_BOUND_SHARE
