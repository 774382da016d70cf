"""The on-board estimator inside the closed loop: its errors, in the limit of many small corrections.

The estimate is truth plus error: p + e_p, v + e_v, R exp(e_q), gyro bias + e_b. Gyro and accelerometer are
assumed to be exact. A pose measured at t - age shows the vehicle at t - age - latency. The law compares it
with its estimate at age + prediction before t (`trimtab.firmware_model.law.estimator`); its gains are rates.

A tick's prediction uses the samples at its end for the whole tick, so velocity and attitude lead the truth by
half a tick of acceleration and body rate. The states are the errors less that lead. Corrections are jumps. An
innovation is taken before its jump, so it is larger than the mean over the jump by the factor
1 / (1 - half the jump it causes).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.estimator import EstimatorGains
from trimtab.firmware_model.law.ops import Ops
from trimtab.firmware_model.law.rotations import cross, mat_t_vec, mat_vec, quat_exp, quat_to_matrix
from trimtab.firmware_model.law.step import TICK_S

Scalar = Any
SIZE = 12
"""States: e_p (NED), e_v (NED), e_q (FRD, rad), e_b (FRD, rad/s); e_v and e_q less their lead."""
_LEAD_S = 0.5 * TICK_S


def errors_of(x: Sequence[Scalar], a: Sequence[Scalar], rate: Sequence[Scalar]) -> list[Scalar]:
    """Return the 12 errors, lead included, of the 12 states at acceleration a (NED) and body rate (FRD)."""
    v = [x[3 + i] + _LEAD_S * a[i] for i in range(3)]
    q = [x[6 + i] + _LEAD_S * rate[i] for i in range(3)]
    return [*x[0:3], *v, *q, *x[9:12]]


def turn(ops: Ops, R: Sequence[Scalar], e_q: Sequence[Scalar]) -> tuple[Scalar, ...]:
    """Return the estimated attitude R exp(e_q), 9 scalars."""
    E = quat_to_matrix(ops, quat_exp(ops, e_q))
    return tuple(
        R[3 * i] * E[k] + R[3 * i + 1] * E[3 + k] + R[3 * i + 2] * E[6 + k]
        for i in range(3)
        for k in range(3)
    )


def error_rates(  # noqa: PLR0913 (an equation of many variables)
    gains: EstimatorGains,
    errors: Sequence[Scalar],
    R: Sequence[Scalar],
    R_estimated: Sequence[Scalar],
    v: Sequence[Scalar],
    a: Sequence[Scalar],
    rate: Sequence[Scalar],
    rate_dot: Sequence[Scalar],
    age_s: Scalar,
    prediction_s: Scalar,
    latency_s: Scalar,
    interval_s: Scalar,
    imu_bias: Sequence[Scalar],
    tilted: Sequence[Scalar] = (0.0, 0.0, 0.0),
) -> list[Scalar]:
    """Return the derivatives of the 12 states at these errors (`errors_of`).

    v, a: true velocity and acceleration (NED). rate, rate_dot: true body rate and its derivative (FRD).
    age_s: declared age of a pose when it is used. prediction_s: the feed-forward block's addition to it.
    latency_s: undeclared age. interval_s: time between poses. imu_bias: of the accelerometer (FRD). tilted:
    gravity in the frame of the poses less (0, 0, g), unknown to the estimator.
    """
    e_p, e_v, e_q, e_b = errors[0:3], errors[3:6], errors[6:9], errors[9:12]
    back = age_s + prediction_s  # by which the estimate is predicted back
    late = age_s + latency_s  # true age of the pose
    force = mat_t_vec(R, (a[0] - tilted[0], a[1] - tilted[1], a[2] - tilted[2] - GRAVITY))
    predicted = mat_vec(R_estimated, [f + b for f, b in zip(force, imu_bias, strict=True)])
    e_a = (predicted[0] - a[0], predicted[1] - a[1], predicted[2] + GRAVITY - a[2])

    lead = back - late
    half_square = 0.5 * (late * late - back * back)
    half_back = 0.5 * back * back
    jump = 1.0 / (1.0 - 0.5 * interval_s * gains.position)
    innovation = [
        jump * (lead * v[i] + half_square * a[i] - e_p[i] + back * e_v[i] - half_back * e_a[i])
        for i in range(3)
    ]
    # Predicting the late attitude forward by exp(rate back) misses rate_dot late^2/2.
    jump = 1.0 / (1.0 - 0.5 * interval_s * gains.attitude)
    swing = 0.5 * late * late
    attitude = [jump * (lead * rate[i] + swing * rate_dot[i] - back * e_b[i] - e_q[i]) for i in range(3)]
    carried = cross(rate, e_q)
    return [
        *(e_v[i] + (gains.position + back * gains.velocity) * innovation[i] for i in range(3)),
        *(e_a[i] + gains.velocity * innovation[i] for i in range(3)),
        *((gains.attitude + back * gains.bias) * attitude[i] - e_b[i] - carried[i] for i in range(3)),
        *(-gains.bias * attitude[i] for i in range(3)),
    ]
