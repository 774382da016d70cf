"""The state that the law is fed: the logged estimate, or the true state with the estimator's errors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from trimtab.firmware_model.law.estimator import EstimatorGains
from trimtab.firmware_model.law.ops import Ops
from trimtab.firmware_model.law.rotations import euler_to_matrix, mat_vec
from trimtab.host.models import estimator
from trimtab.host.models.airframe import RATE, THETA, P, Part, V
from trimtab.host.models.bias import standing_errors
from trimtab.host.models.drive import (
    ESTIMATED_P,
    ESTIMATED_RATE,
    ESTIMATED_THETA,
    ESTIMATED_V,
    FlightConstants,
)
from trimtab.host.models.slots import gravity_ned, mocap_latency_s

Scalar = Any


class Feedback(NamedTuple):
    """Position, velocity (NED), attitude R_ned_frd and body rate (FRD) that the law is fed.

    v_dot_ned: derivative of the estimated velocity. error_rates: derivatives of the estimator's error states,
    empty where the model has none.
    """

    p_ned: Sequence[Scalar]
    v_ned: Sequence[Scalar]
    R: Sequence[Scalar]
    rate_frd: Sequence[Scalar]
    v_dot_ned: Sequence[Scalar]
    error_rates: Sequence[Scalar] = ()

    def delayed(self, delay_s: Scalar, a_ned: Sequence[Scalar]) -> Feedback:
        """Return the feedback with position and velocity this much later, at acceleration a_ned."""
        p, v = self.p_ned, self.v_ned
        return self._replace(
            p_ned=[p[i] - delay_s * (v[i] - 0.5 * delay_s * a_ned[i]) for i in range(3)],
            v_ned=[v[i] - delay_s * a_ned[i] for i in range(3)],
        )


def logged_estimate(ops: Ops, drive: Sequence[Scalar], a_ned: Sequence[Scalar]) -> Feedback:
    """Return the feedback of the drive `estimate`, as logged; a_ned: the model's acceleration."""
    R = euler_to_matrix(ops, drive[ESTIMATED_THETA])
    return Feedback(drive[ESTIMATED_P], drive[ESTIMATED_V], R, drive[ESTIMATED_RATE], a_ned)


def estimate_with_error_states(
    ops: Ops,
    gains: EstimatorGains,
    constants: FlightConstants,
    parts: Sequence[Part],
    x: Sequence[Scalar],
    error_states: Sequence[Scalar],
    a_ned: Sequence[Scalar],
    rate_dot: Sequence[Scalar],
) -> Feedback:
    """Return the true state x plus the errors of the estimator, which are states of the model."""
    p, v, rate = x[P], x[V], x[RATE]
    R = euler_to_matrix(ops, x[THETA])
    tilted = gravity_ned(ops, parts)
    bias = constants.accelerometer_bias
    if tilted is not None:
        per_gravity = constants.bias_per_gravity
        bias = [
            b + per_gravity[2 * i] * tilted[0] + per_gravity[2 * i + 1] * tilted[1]
            for i, b in enumerate(bias)
        ]
    e = estimator.errors_of(error_states, a_ned, rate)
    R_estimated = estimator.turn(ops, R, e[6:9])
    error_rates = estimator.error_rates(
        gains, e, R, R_estimated, v, a_ned, rate, rate_dot,
        constants.mocap_age_s, constants.prediction_time_s, mocap_latency_s(ops, parts),
        constants.mocap_interval_s, bias, tilted or (0.0, 0.0, 0.0),
    )  # fmt: skip
    return Feedback(
        p_ned=[p[i] + e[i] for i in range(3)],
        v_ned=[v[i] + e[3 + i] for i in range(3)],
        R=R_estimated,
        rate_frd=[rate[i] - e[9 + i] for i in range(3)],
        v_dot_ned=[a_ned[i] + error_rates[3 + i] for i in range(3)],
        error_rates=error_rates,
    )


def estimate_with_standing_errors(
    ops: Ops,
    gains: EstimatorGains,
    constants: FlightConstants,
    x: Sequence[Scalar],
    a_ned: Sequence[Scalar],
) -> Feedback:
    """Return the true state x plus the constant errors that the accelerometer's bias causes."""
    p, v = x[P], x[V]
    R = euler_to_matrix(ops, x[THETA])
    excess = mat_vec(R, constants.accelerometer_bias)
    off_p, off_v = standing_errors(gains, constants.mocap_age_s, constants.mocap_interval_s)
    return Feedback(
        p_ned=[p[i] + off_p * excess[i] for i in range(3)],
        v_ned=[v[i] + off_v * excess[i] for i in range(3)],
        R=R,
        rate_frd=x[RATE],
        v_dot_ned=a_ned,
    )
