"""Position, velocity, attitude and gyro bias: gyro and accelerometer, corrected by poses that arrive late.

Prediction is strapdown integration at the base tick. A correction compares the late pose with what the
present estimate says about that moment, under constant acceleration and constant body rate since then, and
corrects the state of that moment: what is wrong with velocity and gyro bias has since moved position and
attitude too. So errors die out in the same way however old the poses are. No history is kept. Gains are
continuous rates, multiplied by the time since the last correction, so that a model of the loop may take the
limit of many small corrections.
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

LONGEST_INTERVAL_S = 0.04
"""A correction after a longer gap weighs no more than this: the gains times a long gap would overshoot."""


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
    """Return the estimate `dt` later, the body rate (FRD), the acceleration (NED) and R_ned_frd (9) of that
    moment.

    `gyro` and `specific_force` (FRD) are the samples of the later moment, held over `dt`.
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
    """Return the estimate drawn towards a pose measured `age_s` ago; unchanged where `dt_s_since_last` is 0.

    Position is compared `age_s` back, p - v age + a age^2 / 2 (exact for constant acceleration); attitude by
    turning the measured one forward by exp(rate age). The sign of either quaternion does not matter. What
    this does to velocity and gyro bias has acted for `age_s`. The next prediction takes rounding out of the
    quaternion's length.
    """
    dt = ops.minimum(dt_s_since_last, LONGEST_INTERVAL_S)
    half = 0.5 * age_s
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
    k_b = dt * gains.bias
    k_q = dt * gains.attitude + age_s * k_b
    q = quat_multiply(est.q, quat_exp(ops, [k_q * e for e in error]))
    bias = tuple(b - k_b * e for b, e in zip(est.bias, error, strict=True))
    return Estimate(tuple(p), tuple(v), q, bias)


def converges(gain: float, rate_gain: float) -> bool:
    """Whether errors of a value and of its rate die out, corrected every LONGEST_INTERVAL_S or more often.

    gain (1/s) and rate_gain (1/s^2): EstimatorGains' position and velocity, or attitude and bias. Over h the
    error e of the value grows by h times the rate's, f; then a correction takes h gain e from e and
    h rate_gain e from f. Both roots of that step,

        z^2 - (2 - h gain - h^2 rate_gain) z + 1 - h gain,

    lie within the unit circle (Jury) where gain and rate_gain are above 0 and 2 h gain + h^2 rate_gain < 4;
    with a rate_gain of 0 f stays as it is. The bound is tightest at the longest h. The age of poses is not in
    it: e is that of the moment of measurement.
    """
    h = LONGEST_INTERVAL_S
    return gain > 0.0 <= rate_gain and 2.0 * h * gain + h * h * rate_gain < 4.0
