"""The predicted tracking error: the response of the position loop, and the bounds of its states."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
import scipy.signal

from tests.parts import part
from trimtab.host.plan import ResidualModel
from trimtab.host.plan.dynamics import INPUTS, STATES, Dynamics
from trimtab.host.plan.planner import make_job
from trimtab.host.plan.rounds import first_round
from trimtab.host.plan.tracking_error import ERROR, ERROR_RATE, error_cost, error_derivative
from trimtab.host.route import random_route
from trimtab.host.vehicle import load_vehicle

VEHICLE = load_vehicle("research")
DRAG = ResidualModel(parts=(part("linear-drag", 0.5, 0.4, 0.1),))


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("omega_rad_s", [0.5, 3.0, 10.0])
def test_response_to_a_residual_is_that_of_the_position_loop(axis: int, omega_rad_s: float) -> None:
    """Amplitude under d = sin(omega t) against the loop's transfer function 1 / (s^2 + k_v s + k_p)."""
    x, d = ca.SX.sym("x", ERROR_RATE.stop), ca.SX.sym("d", 3)
    slope = ca.Function("slope", [x, d], [ca.vertcat(*error_derivative(VEHICLE, x, d))])
    state, step_s = np.zeros(ERROR_RATE.stop), 2e-3
    times_s = np.arange(0.0, 30.0, step_s)
    errors = []
    for t_s in times_s:
        errors.append(state[ERROR][axis])
        d_ned = np.zeros(3)
        d_ned[axis] = np.sin(omega_rad_s * (t_s + step_s / 2))
        middle = state.copy()
        middle[STATES:] += step_s / 2 * np.array(slope(state, d_ned)).ravel()
        state[STATES:] += step_s * np.array(slope(middle, d_ned)).ravel()
    gains = VEHICLE.gains
    loop = scipy.signal.TransferFunction([1.0], [1.0, gains.velocity_d[axis], gains.position_p[axis]])
    expected = abs(scipy.signal.freqresp(loop, [omega_rad_s])[1][0])
    settled = np.array(errors)[times_s > 15.0]
    assert np.ptp(settled) / 2 == pytest.approx(expected, rel=5e-3)


def test_cost_of_a_settled_horizontal_error_is_that_of_its_residual() -> None:
    x, d_m_s2 = ca.DM.zeros(ERROR_RATE.stop), 0.7
    x[ERROR.start] = d_m_s2 / VEHICLE.gains.position_p[0]
    assert float(error_cost(VEHICLE, ca.SX(x))) == pytest.approx(d_m_s2**2)


def test_states_of_a_plan_start_without_error_and_follow_the_nominal_dynamics() -> None:
    job = make_job(random_route(3, count=4, total_time_s=5.0), VEHICLE, kind="min-error", model=DRAG)
    engine, problem, solution = first_round(job, nodes=60)
    assert engine.model.nx == solution.x.shape[0] == ERROR_RATE.stop
    assert not solution.x[ERROR.start :, 0].any()
    assert np.abs(solution.x[ERROR]).max() > 1e-3
    nominal = Dynamics(vehicle=VEHICLE)
    p = nominal.parameters(np.zeros(1))[:, 0]
    for k in (7, 31):
        state, change = ca.SX(solution.x[:, k]), ca.SX(solution.u[:, k])
        with_error = engine.model.derivative(state, change, ca.SX(problem.parameters[:, k]))
        plain = nominal.derivative(state[:STATES], change, ca.SX(p))
        assert change.shape == (INPUTS, 1)
        np.testing.assert_array_equal(np.array(ca.DM(with_error[:STATES])), np.array(ca.DM(plain)))
