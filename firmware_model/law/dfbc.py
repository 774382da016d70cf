"""The differential-flatness-based controller: PD translation, attitude, PID body rate.

    a_cmd   = a_r + s [K_p (p_r - p) + K_v (v_r - v)] - d_ff
    f       = upright(g e3 - a_cmd)       body z: z_des = f / |f|, thrust along -z_des, heading: yaw_r
    T       = m max(f . z_B, thrust_floor g)
    w_cmd   = bound(w_ff(f, j_r - d_ff', yaw_r, yaw_r') - K_att (e_R - e_0)),
    e_R     = 1/2 vee(R_des^T R - R^T R_des)
    tau     = J (K_w (w_cmd - w) + I - K_d w_f') + w x J w,        I' = K_i (w_cmd - w)

f is minus the commanded specific force; `upright` keeps feedback from turning it downward and from tilting it
by over TILT_MAX_DEG, and scales its sideways part down below LIFT_FULL; `bound` keeps it from rates above
RATE_MAX. d_ff is the residual acceleration, predicted plus observed; d_ff' is
the derivative of the predicted one. s <= 1 scales the feedback down to FEEDBACK_MAX. e_0 is the attitude
offset in roll and pitch. w_f' is the derivative of the body rate after a first-order filter. Paper sections
III-B and V-B ("a PD translational controller and a PID body rate controller"). `rate_loop` takes I and the
filtered rate and returns I'; `step` advances the filter.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.flatness import Body, heading, heading_matrix, heading_rates
from trimtab.firmware_model.law.ops import Ops, Scalar, Vector
from trimtab.firmware_model.law.rotations import attitude_error, cross

TILT_MAX_DEG = 75.0
"""Greatest tilt that feedback commands beyond what the reference itself asks for."""
_TILT_MAX_TAN = math.tan(math.radians(TILT_MAX_DEG))
LIFT_FULL = 0.5
"""Lift, as a share of the weight, from which feedback acts sideways in full. With less, torque already takes
more thrust than is commanded, so the same tilt accelerates more; in full, feedback would swing the vehicle.
A reference within a tilt of 60 deg with so little lift has little thrust as well.
"""
RATE_MAX = 8.0
"""Greatest body rate (rad/s) about roll and pitch, unless the reference itself asks for a greater one.
Faster, a vehicle overshoots, because its motors saturate.
"""
FEEDBACK_MAX = 15.0
"""Greatest acceleration (m/s^2) that position and velocity errors command together; more is scaled down."""


class Gains(NamedTuple):
    """Constants of the controller.

    Three values each along NED: position (1/s^2), velocity (1/s). Three values each along FRD: attitude
    (1/s), body rate (1/s), its integral (1/s^2) and its derivative (no unit). filter_rate: corner of the rate
    filter (rad/s). thrust_floor: least collective thrust as a share of the weight; without thrust a vehicle
    cannot change its attitude.
    """

    position: Vector
    velocity: Vector
    attitude: Vector
    rate: Vector
    rate_integral: Vector
    rate_derivative: Vector
    filter_rate: Any
    thrust_floor: Any


class FlatState(NamedTuple):
    """Flat outputs with their derivatives: p, v, a, j in NED, yaw and yaw rate."""

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
    ref: FlatState,
    ff_accel: Vector = (0.0, 0.0, 0.0),
    weights: Vector = (1.0, 1.0),
    ff_jerk: Vector = (0.0, 0.0, 0.0),
    attitude_offset: Vector = (0.0, 0.0),
) -> tuple[Scalar, Vector, Vector, Vector]:
    """Return collective thrust (N), torque (N m), rate command (rad/s) and derivative of the integral.

    The derivative of the rate integral is in rad/s^3.

    Runs both loops; `outer_loop` and `rate_loop` describe the parameters.
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
    ref: FlatState,
    ff_accel: Vector = (0.0, 0.0, 0.0),
    weights: Vector = (1.0, 1.0),
    ff_jerk: Vector = (0.0, 0.0, 0.0),
    attitude_offset: Vector = (0.0, 0.0),
) -> tuple[Scalar, Vector]:
    """Return collective thrust (N) and commanded body rate (rad/s) that follow the reference.

    Parameters
    ----------
    p, v
        Estimated position and velocity, NED.
    R
        Estimated R_ned_frd, 9 scalars.
    ff_accel, ff_jerk
        Predicted plus observed residual acceleration, and derivative of the predicted one, NED.
    weights
        Weights of position and of velocity feedback.
    attitude_offset
        Misalignment: roll and pitch that the poses show when thrust points exactly as intended.
    """
    feedback = [
        weights[0] * gains.position[i] * (ref.p[i] - p[i])
        + weights[1] * gains.velocity[i] * (ref.v[i] - v[i])
        for i in range(3)
    ]
    square = feedback[0] * feedback[0] + feedback[1] * feedback[1] + feedback[2] * feedback[2]
    bound_squared = FEEDBACK_MAX * FEEDBACK_MAX
    # Exactly 1 within the bound; beyond it the scaled magnitude equals the bound.
    scale = ops.sqrt(bound_squared / ops.maximum(square, bound_squared))
    asked = [ff_accel[i] - ref.a[i] for i in range(3)]
    lift_min = gains.thrust_floor * GRAVITY
    f = _upright(ops, [a - scale * e for a, e in zip(asked, feedback, strict=True)], asked, lift_min)
    thrust_axis = heading(ops, f, ref.yaw)

    thrust = f[0] * R[2] + f[1] * R[5] + f[2] * R[8]
    collective = model.mass_kg * ops.maximum(thrust, lift_min)

    error = attitude_error(heading_matrix(thrust_axis), R)
    error = (error[0] - attitude_offset[0], error[1] - attitude_offset[1], error[2])
    jerk = [ff_jerk[i] - ref.j[i] for i in range(3)]
    rate_ff = heading_rates(thrust_axis, jerk, ref.yaw_rate)
    rate_cmd = [w - k * e for w, k, e in zip(rate_ff, gains.attitude, error, strict=True)]
    asked_f = (asked[0], asked[1], ops.maximum(asked[2] + GRAVITY, lift_min))
    x, y, _ = heading_rates(heading(ops, asked_f, ref.yaw), jerk, ref.yaw_rate)
    bound_squared = ops.maximum(x * x + y * y, RATE_MAX * RATE_MAX)
    square = rate_cmd[0] * rate_cmd[0] + rate_cmd[1] * rate_cmd[1]
    scale = ops.sqrt(bound_squared / ops.maximum(square, bound_squared))
    return collective, [scale * rate_cmd[0], scale * rate_cmd[1], rate_cmd[2]]


def _upright(ops: Ops, f: Vector, asked: Vector, lift_min: Scalar) -> list[Scalar]:
    """Return f with gravity; feedback neither turns the thrust downward nor tilts it by over TILT_MAX_DEG.

    Below LIFT_FULL, feedback acts sideways in proportion to the lift. f, asked: minus the commanded specific
    force with and without feedback, without gravity. What the reference itself asks for is not limited.
    Within the limits, f is returned to the bit.
    """
    lift_asked = asked[2] + GRAVITY
    lift = ops.maximum(f[2] + GRAVITY, ops.minimum(lift_asked, lift_min))
    least = ops.maximum(lift, lift_min)
    full = ops.minimum(least / (LIFT_FULL * GRAVITY), 1.0)
    north, east = (full * x + (1.0 - full) * y for x, y in zip(f[:2], asked[:2], strict=True))
    most = _TILT_MAX_TAN * least
    most_squared = ops.maximum(most * most, asked[0] * asked[0] + asked[1] * asked[1])
    square = north * north + east * east
    share = ops.sqrt(most_squared / ops.maximum(square, most_squared))
    return [share * north, share * east, lift]


def rate_loop(
    gains: Gains, model: Body, rate: Vector, rate_filtered: Vector, integral: Vector, rate_cmd: Vector
) -> tuple[Vector, Vector]:
    """Return the torque (N m) of the body rate controller, and the derivative of its integral (rad/s^3).

    rate, rate_filtered, rate_cmd: rad/s, FRD. integral: rad/s^2, FRD.
    """
    rate_error = [command - w for command, w in zip(rate_cmd, rate, strict=True)]
    jx, jy, jz = model.inertia
    gyroscopic = cross(rate, (jx * rate[0], jy * rate[1], jz * rate[2]))
    torque = []
    for i, inertia in enumerate((jx, jy, jz)):
        derivative = gains.filter_rate * (rate[i] - rate_filtered[i])
        accel_cmd = gains.rate[i] * rate_error[i] + integral[i] - gains.rate_derivative[i] * derivative
        torque.append(inertia * accel_cmd + gyroscopic[i])
    integral_dot = [k * e for k, e in zip(gains.rate_integral, rate_error, strict=True)]
    return torque, integral_dot
