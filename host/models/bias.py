"""The accelerometer's bias in a flight, from what it does to the on-board estimate.

A bias b makes the estimator stand off the poses: its corrections must undo b, so the estimated velocity is
wrong by (K_p / K_v + age) R b, and the vehicle flies millimetres beside its reference. It differs from flight
to flight, is no effect, and shows in the log as the mean of estimate less camera.

So does what late poses do to the estimated attitude: turning while leaning, it is wrong to one side, and
thrust that points elsewhere than estimated looks like a bias. In quick flight that is more than the bias, so
both are passed through the estimator's equations (`trimtab.host.models.estimator`, linear) and told apart.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.estimator import EstimatorGains

_LED_IN_S = 2.0
"""Time before the first sample in which the vehicle is taken to have been as it was there."""


def standing_errors(gains: EstimatorGains, age_s: Any, interval_s: Any) -> tuple[Any, Any]:
    """Estimated less true position and velocity, over a constant excess of acceleration (s^2, s).

    Where corrections balance it: `trimtab.host.models.estimator` at rest.
    """
    jump = 1.0 / (1.0 - 0.5 * interval_s * gains.position)
    velocity = gains.position / gains.velocity + age_s
    return 1.0 / (gains.velocity * jump) + age_s * velocity - 0.5 * age_s**2, velocity


def accelerometer_bias(
    error: np.ndarray,
    R: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    rate: np.ndarray,
    *,
    gains: EstimatorGains,
    age_s: float,
    interval_s: float,
    step_s: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the bias (3,), m/s^2 FRD, that fits position errors of the estimate (n, 3), NED, and what of it
    is not the accelerometer's: (3, 2), by which it is less for each m/s^2 of gravity towards north and east
    in the poses' frame.

    A frame that leans makes the estimator stand off like a bias does, and as one it is read here: wholly
    where the heading stays. R (n, 3, 3): R_ned_frd; v, a (n, 3) NED and rate (n, 3) FRD, every `step_s`.
    Shares of the error that late poses and time stamps make are taken out. Poses are `age_s` old where used
    and come every `interval_s`.
    """
    k_p, k_v, k_q, k_b = (float(gain) for gain in gains)
    # Position and velocity behind an excess of acceleration, and behind a displacement of the poses.
    jump = 1.0 / (1.0 - 0.5 * interval_s * k_p)
    corrected = jump * np.array([k_p + age_s * k_v, k_v])
    walk = np.array([[0.0, 1.0], [0.0, 0.0]]) + np.outer(corrected, (-1.0, age_s))
    # Attitude and gyro bias behind a turn of the poses, about NED: the bias is taken to turn along.
    jump = 1.0 / (1.0 - 0.5 * interval_s * k_q)
    turned = jump * np.array([k_q + age_s * k_b, -k_b])
    turn = np.array([[0.0, -1.0], [0.0, 0.0]]) + np.outer(turned, (-1.0, -age_s))

    turning = np.einsum("nij,njk->nik", R, np.stack([rate, np.gradient(rate, step_s, axis=0)], axis=2))
    swung = _behind(turn, turned, turning, step_s)
    force = a - (0.0, 0.0, GRAVITY)
    tilted = np.cross(swung, force[:, :, None], axis=1)
    north_east = np.repeat(np.eye(3)[None, :, :2], len(R), axis=0)
    excess = np.concatenate([R, tilted, north_east], axis=2)
    pushed = _behind(walk, np.array([0.0, 1.0]) - 0.5 * age_s**2 * corrected, excess, step_s)
    moved = _behind(walk, corrected, np.stack([v, a], axis=2), step_s)
    # Poses that are late by l show -l v and turn by -l rate at once: one share for both.
    late = pushed[:, :, 3:4] + moved[:, :, 0:1]
    columns = [pushed[:, :, :3], late, pushed[:, :, 4:5], moved[:, :, 1:], v[:, :, None], a[:, :, None]]
    rows = np.concatenate(columns, axis=2).reshape(3 * len(R), -1)
    towards = pushed[:, :, 5:].reshape(-1, 2)
    found, *_ = np.linalg.lstsq(rows, np.column_stack([error.reshape(-1), towards]), rcond=None)
    return found[:3, 0], found[:3, 1:]


def _behind(A: np.ndarray, b: np.ndarray, u: np.ndarray, step_s: float) -> np.ndarray:
    """Return the first state of x' = A x + b u, u (n, 3, k) every `step_s`: trapezoid rule, from long
    before.
    """
    half = 0.5 * step_s
    ahead = np.linalg.inv(np.eye(2) - half * A)
    stay, given = ahead @ (np.eye(2) + half * A), half * (ahead @ b)
    n = len(u)
    before = round(_LED_IN_S / step_s)
    flat = np.concatenate([np.repeat(u[:1], before, axis=0), u]).reshape(before + n, -1)
    added = (flat[1:] + flat[:-1])[:, None, :] * given[:, None]
    x = np.zeros((2, flat.shape[1]))
    out = np.empty((before + n, flat.shape[1]))
    out[0] = x[0]
    for k, more in enumerate(added, start=1):
        x = stay @ x + more
        out[k] = x[0]
    return out[before:].reshape(u.shape)
