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
) -> tuple[np.ndarray, np.ndarray]:
    """The bias (3,), m/s^2 FRD, that fits position errors of the estimate (n, 3), NED, and what of it is not
    the accelerometer's: (3, 2), by which it is less for each m/s^2 of gravity towards north and east in the
    poses' frame.

    A frame that leans makes the estimator stand off like a bias does, and as one it is read here: wholly
    where the heading stays. R (n, 3, 3): R_ned_frd; v, a (n, 3) NED: shares of the error that follow them
    (late poses, time stamps) are taken out. `per_bias`: standing position error over bias.
    """
    rows = np.concatenate([per_bias * R, v[:, :, None], a[:, :, None]], axis=2).reshape(-1, 5)
    towards = per_bias * np.tile(np.eye(3)[:, :2], (len(error), 1))
    found, *_ = np.linalg.lstsq(rows, np.column_stack([error.reshape(-1), towards]), rcond=None)
    return found[:3, 0], found[:3, 1:]
