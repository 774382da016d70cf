"""The accelerometer's bias in a flight, from what it does to the on-board estimate.

A bias b makes the estimator stand off the poses: its corrections must undo b, so the estimated velocity is
wrong by (K_p / K_v) R b, and the vehicle flies millimetres beside its reference. It differs from flight to
flight, is no effect, and shows in the log as the mean of estimate less camera.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from firmware_model.law.estimator import EstimatorGains


def standing_errors(gains: EstimatorGains, age_s: Any, interval_s: Any) -> tuple[Any, Any]:
    """Estimated less true position and velocity, over a constant excess of acceleration (s^2, s).

    Where corrections balance it: `host.models.estimator` at rest.
    """
    jump = 1.0 / (1.0 - 0.5 * interval_s * (gains.position - age_s * gains.velocity))
    velocity = gains.position / gains.velocity
    return 1.0 / (gains.velocity * jump) + age_s * velocity - 0.5 * age_s**2, velocity


def accelerometer_bias(
    error: np.ndarray, R: np.ndarray, v: np.ndarray, a: np.ndarray, per_bias: float
) -> np.ndarray:
    """The bias (3,), m/s^2 FRD, that fits position errors of the estimate (n, 3), NED.

    R (n, 3, 3): R_ned_frd; v, a (n, 3) NED: shares of the error that follow them (late poses, time stamps)
    are taken out. `per_bias`: standing position error over bias.
    """
    rows = np.concatenate([per_bias * R, v[:, :, None], a[:, :, None]], axis=2).reshape(-1, 5)
    found, *_ = np.linalg.lstsq(rows, error.reshape(-1), rcond=None)
    return found[:3]
