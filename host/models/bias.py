"""The accelerometer's bias in a flight, from its influence on the on-board estimate.

A bias b causes a constant difference between estimate and poses. The estimator's corrections must balance b,
so the estimated velocity is wrong by (K_p / K_v + age) R b, and the vehicle flies millimetres beside its
reference. The bias differs from flight to flight and is no effect. In the log it shows as the mean of
estimate less camera.

Late poses cause a similar difference. When the vehicle turns while it leans, its estimated attitude is wrong
to one side, and thrust in a wrongly estimated direction looks like a bias. In fast flight this exceeds the
bias. Both are therefore passed through the linear equations of the estimator
(`trimtab.host.models.estimator`) and fitted together.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.estimator import EstimatorGains

_LED_IN_S = 2.0
"""Time before the first sample in which the vehicle is assumed to have been in that sample's state."""


def standing_errors(gains: EstimatorGains, age_s: Any, interval_s: Any) -> tuple[Any, Any]:
    """Return estimated less true position (s^2) and velocity (s), per constant excess of acceleration.

    The corrections balance the excess: `trimtab.host.models.estimator` at rest.
    """
    jump = 1.0 / (1.0 - 0.5 * interval_s * gains.position)
    velocity = gains.position / gains.velocity + age_s
    return 1.0 / (gains.velocity * jump) + age_s * velocity - 0.5 * age_s**2, velocity


def accelerometer_bias(  # noqa: PLR0913 (an equation of many variables)
    error: Annotated[np.ndarray, "samples 3"],
    R: Annotated[np.ndarray, "samples 3 3"],
    v: Annotated[np.ndarray, "samples 3"],
    a: Annotated[np.ndarray, "samples 3"],
    rate: Annotated[np.ndarray, "samples 3"],
    *,
    gains: EstimatorGains,
    age_s: float,
    interval_s: float,
    step_s: float,
) -> tuple[Annotated[np.ndarray, "3"], Annotated[np.ndarray, "3 2"]]:
    """Return the bias that fits the position errors, NED, of the estimate.

    A tilted frame of the poses causes errors like a bias, and with a constant heading it cannot be told from
    one. The errors that late poses and time stamps cause are fitted too, and left out of the bias.

    Parameters
    ----------
    R
        R_ned_frd.
    v, a, rate
        NED, NED and FRD, every `step_s`.
    age_s, interval_s
        Age of a pose when it is used, and time between poses.

    Returns
    -------
    bias
        m/s^2 FRD.
    per_gravity
        Decrease of the bias per m/s^2 of gravity towards north and east in the frame of the poses.
    """
    k_p, k_v, k_q, k_b = (float(gain) for gain in gains)
    # Response of position and velocity to an excess of acceleration, and to a displacement of the poses.
    jump = 1.0 / (1.0 - 0.5 * interval_s * k_p)
    by_displacement = jump * np.array([k_p + age_s * k_v, k_v])
    position_system = np.array([[0.0, 1.0], [0.0, 0.0]]) + np.outer(by_displacement, (-1.0, age_s))
    # Of attitude and gyro bias to a rotation of the poses, in NED; the bias is assumed to rotate too.
    jump = 1.0 / (1.0 - 0.5 * interval_s * k_q)
    by_rotation = jump * np.array([k_q + age_s * k_b, -k_b])
    attitude_system = np.array([[0.0, -1.0], [0.0, 0.0]]) + np.outer(by_rotation, (-1.0, -age_s))

    rotations = np.einsum("nij,njk->nik", R, np.stack([rate, np.gradient(rate, step_s, axis=0)], axis=2))
    attitude_error = _response(attitude_system, by_rotation, rotations, step_s)
    force = a - (0.0, 0.0, GRAVITY)
    tilted = np.cross(attitude_error, force[:, :, None], axis=1)
    north_east = np.repeat(np.eye(3)[None, :, :2], len(R), axis=0)
    excess = np.concatenate([R, tilted, north_east], axis=2)
    by_excess = _response(
        position_system, np.array([0.0, 1.0]) - 0.5 * age_s**2 * by_displacement, excess, step_s
    )
    by_motion = _response(position_system, by_displacement, np.stack([v, a], axis=2), step_s)
    # Poses that are late by l are displaced by -l v and rotated by -l rate: one coefficient for both.
    late = by_excess[:, :, 3:4] + by_motion[:, :, 0:1]
    columns = [
        by_excess[:, :, :3],
        late,
        by_excess[:, :, 4:5],
        by_motion[:, :, 1:],
        v[:, :, None],
        a[:, :, None],
    ]
    rows = np.concatenate(columns, axis=2).reshape(3 * len(R), -1)
    by_gravity = by_excess[:, :, 5:].reshape(-1, 2)
    solution, *_ = np.linalg.lstsq(rows, np.column_stack([error.reshape(-1), by_gravity]), rcond=None)
    return solution[:3, 0], solution[:3, 1:]


def _response(A: np.ndarray, b: np.ndarray, u: np.ndarray, step_s: float) -> np.ndarray:
    """Return the first state of x' = A x + b u, u (n, 3, k) every `step_s`, by the trapezoid rule."""
    half = 0.5 * step_s
    inverse = np.linalg.inv(np.eye(2) - half * A)
    stay, input_gain = inverse @ (np.eye(2) + half * A), half * (inverse @ b)
    n = len(u)
    before = round(_LED_IN_S / step_s)
    flat = np.concatenate([np.repeat(u[:1], before, axis=0), u]).reshape(before + n, -1)
    added = (flat[1:] + flat[:-1])[:, None, :] * input_gain[:, None]
    x = np.zeros((2, flat.shape[1]))
    out = np.empty((before + n, flat.shape[1]))
    out[0] = x[0]
    for k, more in enumerate(added, start=1):
        x = stay @ x + more
        out[k] = x[0]
    return out[before:].reshape(u.shape)
