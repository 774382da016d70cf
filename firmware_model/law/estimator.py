"""Estimator of position, velocity, attitude and gyro bias from IMU samples and delayed poses.

Prediction is strapdown integration at the base tick. A correction extrapolates the present estimate back to
the time of the pose, with constant acceleration and body rate, and compares it with the pose. The correction
applies at the time of the pose and is carried forward to now: a velocity correction also moves position, by
the correction times the pose's age, and a bias correction turns the attitude. Errors therefore decay in the
same way at any age of the poses. The estimator stores no history. Gains are continuous rates, multiplied by
the time since the last correction, so a model of the loop can take the limit of many small corrections.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.ops import Ops, Scalar, Vector
from trimtab.firmware_model.law.rotations import (
    mat_vec,
    quat_conjugate,
    quat_exp,
    quat_multiply,
    quat_normalize,
    quat_to_matrix,
)

ACCELERATION_MAX = 40.0
"""Greatest acceleration (m/s^2) over the age of a pose. A shock on the floor is greater, but short."""
LATE_S, TURN_MAX = 0.03, 0.03
"""Age of a pose, and angle (rad) turned in the time beyond that age, from which on its attitude counts less:
the body rate was not constant.
"""
INTERVAL_MAX_S = 0.04
"""Greatest time that weighs a correction: after a longer gap the gains times the gap would overshoot."""


class EstimatorGains(NamedTuple):
    """Correction rates: position 1/s, velocity 1/s^2, attitude 1/s, gyro bias 1/s^2."""

    position: Any
    velocity: Any
    attitude: Any
    bias: Any


class Estimate(NamedTuple):
    """p_ned (m), v_ned (m/s), q_ned_frd (w first), gyro bias (rad/s, FRD)."""

    p: Vector
    v: Vector
    q: Vector
    bias: Vector


def predict(
    ops: Ops, est: Estimate, gyro: Vector, specific_force: Vector, dt: Scalar
) -> tuple[Estimate, Vector, Vector, Vector]:
    """Return the estimate after `dt`, and its body rate (FRD), acceleration (NED) and R_ned_frd (9 scalars).

    `gyro` and `specific_force` (FRD) are the samples at the end of `dt`, assumed constant over it.
    """
    rate = tuple(g - b for g, b in zip(gyro, est.bias, strict=True))
    q = quat_normalize(ops, quat_multiply(est.q, quat_exp(ops, [r * dt for r in rate])))
    R = quat_to_matrix(ops, q)
    fx, fy, fz = mat_vec(R, specific_force)
    a = (fx, fy, fz + GRAVITY)
    half = 0.5 * dt
    p = tuple(p + dt * (v + half * x) for p, v, x in zip(est.p, est.v, a, strict=True))
    v = tuple(v + dt * x for v, x in zip(est.v, a, strict=True))
    return Estimate(p, v, q, est.bias), rate, a, R


def correct(  # noqa: PLR0913 (an equation of many variables)
    ops: Ops,
    est: Estimate,
    rate: Vector,
    accel_ned: Vector,
    p_meas: Vector,
    q_meas: Vector,
    age_s: Scalar,
    dt_s_since_last: Scalar,
    gains: EstimatorGains,
) -> Estimate:
    """Return the estimate corrected by a pose measured `age_s` ago; unchanged if `dt_s_since_last` is 0.

    Positions are compared at the time of the pose: p - v age + a age^2 / 2, exact for constant acceleration
    within ACCELERATION_MAX. Attitudes are compared now: the measured one is rotated forward by exp(rate age),
    and counts less if that is much, see TURN_MAX. The signs of the quaternions do not matter. The corrections
    of velocity and gyro bias also act on position and attitude over `age_s`. The next prediction normalizes
    the quaternion.
    """
    dt = ops.minimum(dt_s_since_last, INTERVAL_MAX_S)
    most, square = ACCELERATION_MAX**2, sum(a_i * a_i for a_i in accel_ned)
    half = 0.5 * age_s * ops.sqrt(most / ops.maximum(square, most))
    k_v = dt * gains.velocity
    k_p = dt * gains.position + age_s * k_v
    p, v = [], []
    for measured, p_i, v_i, a_i in zip(p_meas, est.p, est.v, accel_ned, strict=True):
        innovation = measured - (p_i - age_s * (v_i - half * a_i))
        p.append(p_i + k_p * innovation)
        v.append(v_i + k_v * innovation)

    q_now = quat_multiply(q_meas, quat_exp(ops, [r * age_s for r in rate]))
    w, x, y, z = quat_multiply(quat_conjugate(est.q), q_now)
    sign = ops.where(w < 0.0, -2.0, 2.0)
    error = (
        sign * x,
        sign * y,
        sign * z,
    )  # rotation vector from the estimate to the pose, FRD, for small angles
    late_s = ops.maximum(age_s - LATE_S, 0.0)
    turned = late_s * late_s * (rate[0] * rate[0] + rate[1] * rate[1] + rate[2] * rate[2])
    trust = dt * (TURN_MAX**2 / ops.maximum(turned, TURN_MAX**2))
    k_b = trust * gains.bias
    k_q = trust * gains.attitude + age_s * k_b
    q = quat_multiply(est.q, quat_exp(ops, [k_q * e for e in error]))
    bias = tuple(b - k_b * e for b, e in zip(est.bias, error, strict=True))
    return Estimate(tuple(p), tuple(v), q, bias)


def converges(gain: float, rate_gain: float) -> bool:
    """Return whether errors of a value and its rate decay, with corrections at least every INTERVAL_MAX_S.

    gain (1/s) and rate_gain (1/s^2) are the gains of position and velocity, or of attitude and gyro bias.
    Over an interval h the error e of the value grows by h f, where f is the error of its rate. A correction
    then subtracts h gain e from e and h rate_gain e from f. The characteristic polynomial of one interval is

        z^2 - (2 - h gain - h^2 rate_gain) z + 1 - h gain.

    By the Jury criterion both roots lie within the unit circle if gain > 0, rate_gain > 0 and
    2 h gain + h^2 rate_gain < 4. With rate_gain = 0, f stays constant. The condition is strictest at the
    longest h. It does not depend on the age of the poses, because e is the error at the time of measurement;
    for attitude only while the vehicle turns slowly (TURN_MAX).
    """
    h = INTERVAL_MAX_S
    return gain > 0.0 <= rate_gain and 2.0 * h * gain + h * h * rate_gain < 4.0
