"""The differential-flatness-based controller: PD translation, attitude, PID body rate.

    a_cmd   = a_r + K_p (p_r - p) + K_v (v_r - v) - d_ff
    f       = g e3 - a_cmd                        thrust direction: z_des = f / |f|, heading: yaw_r
    T       = m max(f . z_B, floor g)
    w_cmd   = w_ff(f, j_r - d_ff', yaw_r, yaw_r') - K_att e_R,     e_R = 1/2 vee(R_des^T R - R^T R_des)
    tau     = J (K_w (w_cmd - w) + I - K_d w_f') + w x J w,        I' = K_i (w_cmd - w)

with d_ff the residual acceleration fed forward, or observed, and w_f' the derivative of the body rate behind
a first-order filter. Paper sections III-B and V-B ("a PD translational controller and a PID body rate
controller"). Memory (I and the filter's state) comes in and its derivative goes out.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.flatness import Body, heading, heading_matrix, heading_rates
from trimtab.firmware_model.law.ops import Ops, Scalar, Vector
from trimtab.firmware_model.law.rotations import attitude_error, cross

GREATEST_FEEDBACK = 15.0
"""m/s^2 that position and velocity errors may ask for together; more is scaled down in its direction."""


class Gains(NamedTuple):
    """The controller's constants.

    Three each along NED: position (1/s^2), velocity (1/s); along FRD: attitude (1/s), body rate (1/s), its
    integral (1/s^2) and derivative (no unit). filter_rate: corner of the rate filter (rad/s). thrust_floor:
    least collective thrust as a share of the weight, since a vehicle without thrust cannot turn.
    """

    position: Vector
    velocity: Vector
    attitude: Vector
    rate: Vector
    rate_integral: Vector
    rate_derivative: Vector
    filter_rate: Any
    thrust_floor: Any


class Reference(NamedTuple):
    """Flat outputs: p, v, a, j in NED, yaw and yaw rate."""

    p: Vector
    v: Vector
    a: Vector
    j: Vector
    yaw: Any
    yaw_rate: Any


def control(  # noqa: PLR0913 (an equation of many variables)
    ops: Ops,
    gains: Gains,
    model: Body,
    p: Vector,
    v: Vector,
    R: Vector,
    rate: Vector,
    rate_filtered: Vector,
    integral: Vector,
    ref: Reference,
    ff_accel: Vector = (0.0, 0.0, 0.0),
    weights: Vector = (1.0, 1.0),
    ff_jerk: Vector = (0.0, 0.0, 0.0),
    attitude_offset: Vector = (0.0, 0.0),
) -> tuple[Scalar, Vector, Vector, Vector]:
    """Return collective thrust (N), torque (N m), commanded body rate (rad/s), the integral's derivative
    (rad/s^3).

    Both loops, one after the other; see `outer_loop` and `rate_loop` for what they take.
    """
    collective, rate_cmd = outer_loop(
        ops, gains, model, p, v, R, ref, ff_accel, weights, ff_jerk, attitude_offset
    )
    torque, integral_dot = rate_loop(gains, model, rate, rate_filtered, integral, rate_cmd)
    return collective, torque, rate_cmd, integral_dot


def outer_loop(  # noqa: PLR0913 (an equation of many variables)
    ops: Ops,
    gains: Gains,
    model: Body,
    p: Vector,
    v: Vector,
    R: Vector,
    ref: Reference,
    ff_accel: Vector = (0.0, 0.0, 0.0),
    weights: Vector = (1.0, 1.0),
    ff_jerk: Vector = (0.0, 0.0, 0.0),
    attitude_offset: Vector = (0.0, 0.0),
) -> tuple[Scalar, Vector]:
    """Return collective thrust (N) and commanded body rate (rad/s) that follow the reference.

    Parameters
    ----------
    p, v
        NED. R: R_ned_frd, 9 scalars.
    ff_accel, ff_jerk
        predicted residual acceleration, with the observed one added, and the predicted
        one's derivative, NED.
    weights
        of position and of velocity feedback.
    attitude_offset
        roll and pitch that the measured attitude shows where thrust points as it should.
    """
    feedback = [
        weights[0] * gains.position[i] * (ref.p[i] - p[i])
        + weights[1] * gains.velocity[i] * (ref.v[i] - v[i])
        for i in range(3)
    ]
    square = feedback[0] * feedback[0] + feedback[1] * feedback[1] + feedback[2] * feedback[2]
    most = GREATEST_FEEDBACK * GREATEST_FEEDBACK
    # Exactly 1 while within bounds; else the length goes down to the bound.
    scale = ops.sqrt(most / ops.maximum(square, most))
    f = [ff_accel[i] - ref.a[i] - scale * feedback[i] for i in range(3)]
    f[2] = f[2] + GRAVITY
    at = heading(ops, f, ref.yaw)

    thrust = f[0] * R[2] + f[1] * R[5] + f[2] * R[8]
    collective = model.mass_kg * ops.maximum(thrust, gains.thrust_floor * GRAVITY)

    error = attitude_error(heading_matrix(at), R)
    error = (error[0] - attitude_offset[0], error[1] - attitude_offset[1], error[2])
    ahead = heading_rates(at, [ff_jerk[i] - ref.j[i] for i in range(3)], ref.yaw_rate)
    return collective, [w - k * e for w, k, e in zip(ahead, gains.attitude, error, strict=True)]


def rate_loop(
    gains: Gains, model: Body, rate: Vector, rate_filtered: Vector, integral: Vector, rate_cmd: Vector
) -> tuple[Vector, Vector]:
    """Torque (N m) that brings the body rate to its command, and the integral's derivative (rad/s^3).

    rate, rate_filtered, rate_cmd (rad/s), integral (rad/s^2): FRD.
    """
    rate_error = [command - w for command, w in zip(rate_cmd, rate, strict=True)]
    jx, jy, jz = model.inertia
    spin = cross(rate, (jx * rate[0], jy * rate[1], jz * rate[2]))
    torque = []
    for i, inertia in enumerate((jx, jy, jz)):
        slope = gains.filter_rate * (rate[i] - rate_filtered[i])
        wanted = gains.rate[i] * rate_error[i] + integral[i] - gains.rate_derivative[i] * slope
        torque.append(inertia * wanted + spin[i])
    integral_dot = [k * e for k, e in zip(gains.rate_integral, rate_error, strict=True)]
    return torque, integral_dot
