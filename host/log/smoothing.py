"""Smoothed position, velocity and acceleration from noisy positions at irregular times, with covariance.

A Kalman filter and a Rauch-Tung-Striebel smoother over (p, v, a), where the acceleration is a random walk.
All axes have the same noise, so they share one covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

_FIRST = np.array([[1.0], [0.0], [0.0]])


@dataclass(frozen=True, kw_only=True)
class Smoothed:
    """p, v, a at the requested times, and their covariance, the same for each axis."""

    p: Annotated[np.ndarray, "times axes"]
    v: Annotated[np.ndarray, "times axes"]
    a: Annotated[np.ndarray, "times axes"]
    covariance: Annotated[np.ndarray, "times 3 3"]

    @property
    def sigma_p(self) -> Annotated[np.ndarray, "times"]:
        """Standard deviation of p."""
        return np.sqrt(np.maximum(self.covariance[:, 0, 0], 0.0))

    @property
    def sigma_v(self) -> Annotated[np.ndarray, "times"]:
        """Standard deviation of v."""
        return np.sqrt(np.maximum(self.covariance[:, 1, 1], 0.0))


@dataclass(frozen=True, kw_only=True)
class Series:
    """Samples with noise `sigma` at times `t_s`, to be smoothed at times `at_s`.

    `jerk_density` is the power density of the white jerk, unit^2/s^5. A larger one follows faster changes and
    smooths less. Times must not decrease. Raises ValueError for fewer than three samples.
    """

    t_s: Annotated[np.ndarray, "samples"]
    samples: Annotated[np.ndarray, "samples axes"]
    sigma: float
    at_s: Annotated[np.ndarray, "times"]
    jerk_density: float

    def __post_init__(self) -> None:
        if len(self.t_s) < 3:
            raise ValueError(f"smoothing needs at least 3 samples, got {len(self.t_s)}")


def smooth(series: Sequence[Series]) -> list[Smoothed]:
    """Return every series smoothed. All must have the same number of axes.

    They advance together, so many take little longer than one.
    """
    merged = [np.argsort(np.concatenate([s.t_s, s.at_s]), kind="stable") for s in series]
    n, count, axes = max(map(len, merged)), len(series), series[0].samples.shape[1]
    values, measured = np.zeros((n, count, axes)), np.zeros((n, count))
    steps, noise = np.zeros((n, count, 3, 3)), np.zeros((n, count, 3, 3))
    x, P = np.zeros((count, 3, axes)), np.zeros((count, 3, 3))
    # A shorter series keeps its state after its end.
    steps[:] = np.eye(3)
    for b, (s, order) in enumerate(zip(series, merged, strict=True)):
        length = len(order)
        values[:length, b] = np.concatenate([s.samples, np.zeros((len(s.at_s), axes))])[order]
        measured[:length, b] = order < len(s.t_s)
        times = np.concatenate([s.t_s, s.at_s])[order]
        steps[:length, b], noise[:length, b] = _transitions(np.diff(times, prepend=times[0]), s.jerk_density)
        x[b, 0] = s.samples[0]
        scale = max(float(np.ptp(s.samples)), 10.0 * s.sigma)
        P[b] = np.diag([s.sigma**2 * 10.0, (10.0 * scale) ** 2, (100.0 * scale) ** 2])
    variance = np.array([s.sigma**2 for s in series])
    xs, Ps = np.empty((n, *x.shape)), np.empty((n, *P.shape))
    before_x, before_P = np.empty_like(xs), np.empty_like(Ps)
    turned = steps.swapaxes(2, 3)
    keep = np.tile(np.eye(3), (count, 1, 1))
    for k in range(n):
        x, P = steps[k] @ x, steps[k] @ P @ turned[k] + noise[k]
        before_x[k], before_P[k] = x, P
        gain = P[:, :, :1] * (measured[k] / (P[:, 0, 0] + variance))[:, None, None]
        x = x + gain * (values[k] - x[:, 0])[:, None]
        # Joseph form: stays symmetric and positive over thousands of steps.
        keep[:, :, :1] = _FIRST - gain
        P = keep @ P @ keep.swapaxes(1, 2) + variance[:, None, None] * (gain * gain.swapaxes(1, 2))
        xs[k], Ps[k] = x, P
    backs = np.linalg.solve(before_P[1:] + 1e-30 * np.eye(3), steps[1:] @ Ps[:-1]).swapaxes(2, 3)
    forth = backs.swapaxes(2, 3)
    for k in range(n - 2, -1, -1):
        xs[k] += backs[k] @ (xs[k + 1] - before_x[k + 1])
        Ps[k] += backs[k] @ (Ps[k + 1] - before_P[k + 1]) @ forth[k]
    out = []
    for b, (s, order) in enumerate(zip(series, merged, strict=True)):
        rows = np.argsort(order)[len(s.t_s) :]  # back into the order of at_s
        pva = xs[rows, b]
        out.append(Smoothed(p=pva[:, 0], v=pva[:, 1], a=pva[:, 2], covariance=Ps[rows, b]))
    return out


def _transitions(dt: np.ndarray, density: float) -> tuple[np.ndarray, np.ndarray]:
    """Return transition matrices and process noise (n, 3, 3) of (p, v, a) over steps dt (n,)."""
    one, zero = np.ones_like(dt), np.zeros_like(dt)
    d2, d3 = dt * dt, dt * dt * dt
    F = [[one, dt, 0.5 * d2], [zero, one, dt], [zero, zero, one]]
    Q = [
        [d3 * d2 / 20.0, d2 * d2 / 8.0, d3 / 6.0],
        [d2 * d2 / 8.0, d3 / 3.0, d2 / 2.0],
        [d3 / 6.0, d2 / 2.0, dt],
    ]
    return np.moveaxis(np.array(F), 2, 0), density * np.moveaxis(np.array(Q), 2, 0)
