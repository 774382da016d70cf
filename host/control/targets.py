"""Targets of states and inputs along a reference, consistent with the prediction model.

A vehicle with residual acceleration d follows the reference at the attitude, body rate and thrust of the flat
outputs for the acceleration a - d. d in turn depends on attitude and thrust: two rounds of substitution are
enough, because d changes little with them.
"""

from __future__ import annotations

import casadi as ca

from trimtab.firmware_model.law.flatness import flat_attitude, flat_rates
from trimtab.firmware_model.law.rotations import matrix_to_euler
from trimtab.host.codegen import CASADI, held_interrupts
from trimtab.host.control.dynamics import INPUTS, STATES, ControlModel, network_acceleration
from trimtab.host.models.reference import FLAT_ROWS

_ROUNDS = 2


@held_interrupts()
def target_function(model: ControlModel, stages: int) -> ca.Function:
    """Return (flat, step_s, p, xi) -> targets of state and input (17) at the N + 1 nodes.

    flat: flat outputs (14) at the nodes. The inputs of a stage are those in its middle that turn one node's
    rate and thrust into the next one's through the lags. Those of the last node are its own rate and thrust.
    """
    flat = ca.MX.sym("flat", FLAT_ROWS, stages + 1)
    step_s, p = ca.MX.sym("step_s"), ca.MX.sym("p", len(model.parameters))
    xi = ca.MX.sym("xi", len(model.weights))
    state, residual, inputs = _state(model), _residual(model), _inputs(model)
    nodes = ca.horzsplit(flat)
    disturbances = [ca.MX(ca.DM.zeros(3))] * len(nodes)
    for _ in range(_ROUNDS):
        x = [state(node, d, ca.DM.zeros(3)) for node, d in zip(nodes, disturbances, strict=True)]
        learned = ca.horzsplit(network_acceleration(model, xi, ca.horzcat(*x)))
        disturbances = [residual(at, p) + d for at, d in zip(x, learned, strict=True)]
    states = []
    for i, node in enumerate(nodes):
        first, last = max(i - 1, 0), min(i + 1, stages)
        d_dot = (disturbances[last] - disturbances[first]) / (step_s * (last - first))
        states.append(state(node, disturbances[i], d_dot))
    columns = [
        ca.vertcat(now, inputs(now, following, step_s))
        for now, following in zip(states, [*states[1:], states[-1]], strict=True)
    ]
    return ca.Function(
        "targets", [flat, step_s, p, xi], [ca.horzcat(*columns)], ["flat", "step_s", "p", "xi"], ["targets"]
    )


def _state(model: ControlModel) -> ca.Function:
    """Return (flat outputs, d, d') -> state (13) on the reference under the residual acceleration d."""
    flat, d, d_dot = ca.SX.sym("flat", FLAT_ROWS), ca.SX.sym("d", 3), ca.SX.sym("d_dot", 3)
    p, v, a, j = (ca.vertsplit(flat[k : k + 3]) for k in (0, 3, 6, 9))
    yaw, yaw_rate = flat[12], flat[13]
    a_rotors = [a[i] - d[i] for i in range(3)]
    R, specific_thrust = flat_attitude(CASADI, a_rotors, yaw)
    rate = flat_rates(CASADI, a_rotors, [j[i] - d_dot[i] for i in range(3)], yaw, yaw_rate)
    roll, pitch, _ = matrix_to_euler(CASADI, R)
    x = ca.vertcat(*p, *v, roll, pitch, yaw, *rate, model.vehicle.mass_kg * specific_thrust)
    return ca.Function("flat_state", [flat, d, d_dot], [x], {"cse": True})


def _residual(model: ControlModel) -> ca.Function:
    x, p = ca.SX.sym("x", STATES), ca.SX.sym("p", len(model.parameters))
    return ca.Function("residual", [x, p], [ca.densify(model.residual(x, p))], {"cse": True})


def _inputs(model: ControlModel) -> ca.Function:
    """Return (x, x_next, step_s) -> inputs (4) between two nodes on the reference, through the lags."""
    now, following = ca.SX.sym("now", STATES), ca.SX.sym("following", STATES)
    step_s = ca.SX.sym("step_s")
    lags = ca.vertcat(*model.rate_lag_s, model.vehicle.motor_lag_s)
    first, last = now[STATES - INPUTS :], following[STATES - INPUTS :]
    u = 0.5 * (first + last) + lags * (last - first) / step_s
    return ca.Function("flat_inputs", [now, following, step_s], [u])
