"""Smoothed trajectories from noisy samples at irregular times: position and velocity with their sigma.

A Kalman filter forward and a Rauch-Tung-Striebel pass back over (p, v, a), the acceleration a random walk.
Each axis has the same sigma, so one covariance serves all axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Smoothed:
    """p, v (n, axes) at the times asked for, and their sigma (n,)."""

    p: np.ndarray
    v: np.ndarray
    sigma_p: np.ndarray
    sigma_v: np.ndarray


def smooth(
    t_s: np.ndarray, samples: np.ndarray, sigma: float, at_s: np.ndarray, *, jerk_density: float
) -> Smoothed:
    """Position and velocity at times (n,) `at_s` from samples (m, axes) of sigma at times (m,) `t_s`.

    `jerk_density`: power of the white jerk, unit^2/s^5: larger follows faster changes and smooths less. Times
    must not run back. Raises ValueError for fewer than three samples.
    """
    if len(t_s) < 3:
        raise ValueError(f"smoothing needs at least 3 samples, got {len(t_s)}")
    times = np.concatenate([t_s, at_s])
    order = np.argsort(times, kind="stable")
    measured = order < len(t_s)
    values = np.concatenate([samples, np.zeros((len(at_s), samples.shape[1]))])[order]
    times = times[order]
    n, axes = values.shape

    x = np.zeros((3, axes))
    x[0] = samples[0]
    scale = max(float(np.ptp(samples)), 10.0 * sigma)
    P = np.diag([sigma**2 * 10.0, (10.0 * scale) ** 2, (100.0 * scale) ** 2])
    xs, Ps = np.empty((n, 3, axes)), np.empty((n, 3, 3))
    before_x, before_P = np.empty((n, 3, axes)), np.empty((n, 3, 3))
    steps, noise = _transitions(np.diff(times, prepend=times[0]), jerk_density)
    eye = np.eye(3)
    for k in range(n):
        F = steps[k]
        x, P = F @ x, F @ P @ F.T + noise[k]
        before_x[k], before_P[k] = x, P
        if measured[k]:
            gain = P[:, 0] / (P[0, 0] + sigma**2)
            x = x + gain[:, None] * (values[k] - x[0])
            # Joseph form: stays symmetric and positive over thousands of steps.
            keep = eye.copy()
            keep[:, 0] -= gain
            P = keep @ P @ keep.T + sigma**2 * gain[:, None] * gain
        xs[k], Ps[k] = x, P
    backs = np.linalg.solve(before_P[1:] + 1e-30 * eye, steps[1:] @ Ps[:-1]).swapaxes(1, 2)
    for k in range(n - 2, -1, -1):
        back = backs[k]
        xs[k] += back @ (xs[k + 1] - before_x[k + 1])
        Ps[k] += back @ (Ps[k + 1] - before_P[k + 1]) @ back.T
    where = np.flatnonzero(~measured)
    rank = np.argsort(order[where])  # back into the order of at_s
    xs, Ps = xs[where[rank]], Ps[where[rank]]
    spread = np.sqrt(np.maximum(np.einsum("nii->ni", Ps), 0.0))
    return Smoothed(p=xs[:, 0], v=xs[:, 1], sigma_p=spread[:, 0], sigma_v=spread[:, 1])


def _transitions(dt: np.ndarray, density: float) -> tuple[np.ndarray, np.ndarray]:
    """Transitions and process noise (n, 3, 3) of (p, v, a) over steps dt (n,)."""
    one, nought = np.ones_like(dt), np.zeros_like(dt)
    d2, d3 = dt * dt, dt * dt * dt
    F = [[one, dt, 0.5 * d2], [nought, one, dt], [nought, nought, one]]
    Q = [
        [d3 * d2 / 20.0, d2 * d2 / 8.0, d3 / 6.0],
        [d2 * d2 / 8.0, d3 / 3.0, d2 / 2.0],
        [d3 / 6.0, d2 / 2.0, dt],
    ]
    return np.moveaxis(np.array(F), 2, 0), density * np.moveaxis(np.array(Q), 2, 0)
