"""The rigid-body model f(x, u): paper equation 1, first-order lag on rotor thrust, and the effects' slots.

The same source runs on floats, CasADi scalars and numpy arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.ops import Ops
from trimtab.firmware_model.law.rotations import euler_rates, euler_to_matrix, mat_vec
from trimtab.host.models.airframe import RATE, THETA, THRUST, Airframe, Part, V
from trimtab.host.models.slots import (
    add,
    driven_thrusts_n,
    gravity_ned,
    inertia,
    loads,
    mass_kg,
    motor_lag_s,
    rotor_lags_s,
    thrust_rate_torque_frd,
)

Scalar = Any


def derivative(  # noqa: PLR0913 (an equation of many variables)
    ops: Ops,
    vehicle: Airframe,
    effects: Sequence[Part],
    x: Sequence[Scalar],
    thrust_command: Sequence[Scalar],
    voltage_ratio: Scalar = 1.0,
    t_s: Scalar = 0.0,
    acceleration_ned: Sequence[Scalar] | None = None,
    rate_dot_frd: Sequence[Scalar] | None = None,
) -> list[Scalar]:
    """Return xdot, 16 scalars, for commanded rotor thrusts in N; other arguments as of `rigid_body`."""
    body = rigid_body(ops, vehicle, effects, x, voltage_ratio, t_s, acceleration_ned, rate_dot_frd)
    lag_s = motor_lag_s(ops, vehicle, effects)
    rates = thrust_rates(ops, vehicle, effects, x[THRUST], thrust_command, lag_s)
    return [*with_thrust_rates(ops, vehicle, effects, x, body, rates), *rates]


def rigid_body(  # noqa: PLR0913 (an equation of many variables)
    ops: Ops,
    vehicle: Airframe,
    effects: Sequence[Part],
    x: Sequence[Scalar],
    voltage_ratio: Scalar = 1.0,
    t_s: Scalar = 0.0,
    acceleration_ned: Sequence[Scalar] | None = None,
    rate_dot_frd: Sequence[Scalar] | None = None,
    memory: Sequence[Scalar] = (),
) -> list[Scalar]:
    """Return the derivative of p, v, Theta and rate, 12 scalars (paper equation 1).

    `acceleration_ned` and `rate_dot_frd` are added to the translational and angular acceleration: the learned
    residual d(x) of paper equation 2, or a disturbance being estimated. `memory` holds the effects' states,
    one effect after the other; without it they are as at rest. `trimtab.host.effects.effect` explains the
    slots.
    """
    v, rate = x[V], x[RATE]
    R = euler_to_matrix(ops, x[THETA])
    load = loads(ops, vehicle, effects, x, R, voltage_ratio, t_s, memory)
    tau = rotor_torque(vehicle, load.thrust)
    if load.torque_frd is not None:
        tau = add(tau, load.torque_frd)

    up = load.collective / load.mass
    if load.specific_force_frd is None:
        a = (-R[2] * up, -R[5] * up, GRAVITY - R[8] * up)
    else:
        fx, fy, fz = load.specific_force_frd
        ax, ay, az = mat_vec(R, (fx, fy, fz - up))
        a = (ax, ay, az + GRAVITY)
    alpha = _angular_acceleration(inertia(ops, vehicle, effects, load.mass), rate, tau)
    tilted = gravity_ned(ops, effects)
    if tilted is not None:
        a = add(a, tilted)
    if acceleration_ned is not None:
        a = add(a, acceleration_ned)
    if rate_dot_frd is not None:
        alpha = add(alpha, rate_dot_frd)
    return [*v, *a, *euler_rates(ops, x[THETA], rate), *alpha]


def with_thrust_rates(
    ops: Ops,
    vehicle: Airframe,
    effects: Sequence[Part],
    x: Sequence[Scalar],
    body: Sequence[Scalar],
    rates: Sequence[Scalar],
) -> list[Scalar]:
    """Return `body` with the torque of effects that depends on the derivatives of the rotor thrusts.

    body: the result of `rigid_body`. rates: derivatives of the rotor thrusts (4), N/s.
    """
    torque = thrust_rate_torque_frd(ops, vehicle, effects, x, rates)
    if torque is None:
        return list(body)
    elements = inertia(ops, vehicle, effects, mass_kg(ops, vehicle, effects))
    more = _angular_acceleration(elements, (0.0, 0.0, 0.0), torque)
    return [*body[: RATE.start], *add(body[RATE], more)]


def _angular_acceleration(
    elements: Sequence[Scalar], rate: Sequence[Scalar], tau: Sequence[Scalar]
) -> tuple[Scalar, Scalar, Scalar]:
    """Return J^-1 (tau - rate x J rate), rad/s^2 FRD; elements: xx, yy, zz and xy of J (kg m^2)."""
    jx, jy, jz, jxy = elements
    wx, wy, wz = rate
    tau_x = tau[0] - (jz - jy) * wy * wz + jxy * wx * wz
    tau_y = tau[1] - (jx - jz) * wz * wx - jxy * wy * wz
    tau_z = tau[2] - (jy - jx) * wx * wy - jxy * (wx * wx - wy * wy)
    pitch = (tau_y - jxy / jx * tau_x) / (jy - jxy / jx * jxy)
    return (tau_x - jxy * pitch) / jx, pitch, tau_z / jz


def thrust_rates(
    ops: Ops,
    vehicle: Airframe,
    effects: Sequence[Part],
    thrust: Sequence[Scalar],
    command: Sequence[Scalar],
    lag_s: Scalar,
) -> list[Scalar]:
    """Return the derivatives of the rotor thrusts: a first-order lag towards what the commands drive them to.

    lag_s: time constant of all rotors, before the factors of each.
    """
    driven = driven_thrusts_n(ops, vehicle, effects, command)
    lags = rotor_lags_s(ops, effects, lag_s, driven, thrust)
    return [(wanted - now) * (1.0 / lag) for wanted, now, lag in zip(driven, thrust, lags, strict=True)]


def rotor_torque(vehicle: Airframe, thrust: Sequence[Scalar]) -> tuple[Scalar, Scalar, Scalar]:
    """Return the rotors' torque (FRD): r x (0, 0, -T), and their reaction torque about z."""
    tau_x = tau_y = tau_z = 0.0
    for rotor, T in zip(vehicle.rotors, thrust, strict=True):
        spin = 1.0 if rotor.spin == "ccw" else -1.0
        tau_x = tau_x - rotor.position_m[1] * T
        tau_y = tau_y + rotor.position_m[0] * T
        tau_z = tau_z + spin * vehicle.torque_per_thrust_m * T
    return tau_x, tau_y, tau_z
