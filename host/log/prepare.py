"""Smoothed states of a flight's tracking phase on a regular grid, with their covariance.

Position, velocity and acceleration come from the camera alone, attitude from gyro and camera together, and
body rate from the gyro. No effect is corrected: if the camera is late, so are the states.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from scipy.spatial.transform import Rotation

from trimtab.host.log.errors import TooLittleData
from trimtab.host.log.one_flight import Flight
from trimtab.host.log.smoothing import Series, Smoothed, smooth
from trimtab.host.log.tracks import Control, Estimate

STEP_S = 0.02
_TOGETHER = 16
"""Flights that are smoothed together: more would not be faster and take memory."""

_JERK_DENSITY = 20.0
"""(m/s^3)^2/Hz. Follows a jerk of some 20 m/s^3; noise of 1 mm at 100 Hz becomes 0.3 mm and 7 mm/s."""
_DRIFT_DENSITY = 0.1
"""rad^2/s^5. Of the rotation between gyro and camera, which is mainly gyro bias."""
_TILT_MAX = np.deg2rad(80.0)
"""Limit of roll and pitch; beyond it, Euler angles approach their singularity."""
_GAP_S = 0.25
"""Time without a pose above which the states inside are extrapolated and do not count."""
_LEAST_STEPS, _LEAST_POSES = 25, 50


@dataclass(frozen=True, kw_only=True, eq=False)
class Prepared:
    """Smoothed states of a flight on a grid of step `step_s`.

    Attributes
    ----------
    start_s
        Start of the grid and of the tracking phase, s on the log's clock.
    interval_s
        Median interval between poses.
    x
        States: p, v (NED), Theta, body rate (FRD).
    a
        Acceleration, NED.
    path_covariance
        Covariance of p, v and a, the same for each axis.
    theta_sigma
        Standard deviation of the attitude, rad.
    seen
        Whether there are poses near each sample.
    notes
        Sentences about what was cut or left out.
    """

    flight: Flight
    start_s: float
    step_s: float
    interval_s: float
    x: Annotated[np.ndarray, "samples 12"]
    a: Annotated[np.ndarray, "samples 3"]
    path_covariance: Annotated[np.ndarray, "samples 3 3"]
    theta_sigma: Annotated[np.ndarray, "samples"]
    seen: Annotated[np.ndarray, "samples"]
    notes: tuple[str, ...]

    @property
    def at_s(self) -> Annotated[np.ndarray, "samples"]:
        """Times of the samples on the log's clock."""
        return self.start_s + self.step_s * np.arange(len(self.x))


def prepare(flights: Sequence[Flight], *, step_s: float = STEP_S, latency_s: float = 0.0) -> list[Prepared]:
    """Return the smoothed tracking phases of flights, with poses shifted back by `latency_s`.

    Several flights together take less time than one by one. A flight that leaves the range of Euler angles is
    cut at that point. Raises TooLittleData if a log has no poses, no control telemetry, no reference or no
    tracking phase, or if its usable part is too short.
    """
    prepared = []
    for first in range(0, len(flights), _TOGETHER):
        measured = [_measured(flight, step_s, latency_s) for flight in flights[first : first + _TOGETHER]]
        smoothed = smooth([each for m in measured for each in (m.path, m.turned)])
        pairs = zip(smoothed[0::2], smoothed[1::2], strict=True)
        prepared += [
            _prepared(m, path, turned, step_s) for m, (path, turned) in zip(measured, pairs, strict=True)
        ]
    return prepared


def _prepared(measured: _Measured, path: Smoothed, turned: Smoothed, step_s: float) -> Prepared:
    """Return the prepared flight from its measurements and their smoothed series."""
    flight, at = measured.flight, measured.path.at_s
    control, estimate = flight.control, flight.estimate
    assert control is not None
    assert estimate is not None
    theta = (Rotation.from_rotvec(turned.p) * measured.base * measured.gyro).as_euler("ZYX")[:, ::-1].copy()
    theta[:, 2] = np.unwrap(theta[:, 2])
    rate = _gyro(control, estimate, at, step_s)
    notes = [
        f"{flight.path.name}: {track.left_out} rows of {topic} with values that are not finite were left out"
        for topic, track in (("poses", flight.mocap), ("control", control), ("estimates", estimate))
        if track is not None and track.left_out
    ]
    leaning = np.abs(theta[:, :2]).max(1)
    beyond = np.flatnonzero(leaning > _TILT_MAX)
    end = int(beyond[0]) if len(beyond) else len(at)
    if len(beyond):
        where = f"{np.rad2deg(leaning[end]):.0f} deg of roll or pitch at {at[end] - at[0]:.2f} s"
        if end <= _LEAST_STEPS:
            raise TooLittleData(
                f"{flight.path.name}: leaves the range of Euler angles ({where}) after less than half a "
                "second of tracking; use a flight that stays below 80 deg"
            )
        notes.append(f"{flight.path.name}: leaves the range of Euler angles, {where}; cut there")
    seen = _near(at[:end], measured.pose_s)
    if not seen.all():
        first = at[:end][~seen][0] - at[0]
        notes.append(
            f"{flight.path.name}: no pose for more than {_GAP_S:g} s, first at {first:.2f} s; "
            f"{(~seen).sum()} of {end} samples do not count"
        )
    return Prepared(
        flight=flight,
        start_s=measured.start_s,
        step_s=step_s,
        interval_s=measured.interval_s,
        x=np.column_stack([path.p, path.v, theta, rate])[:end],
        a=path.a[:end],
        path_covariance=path.covariance[:end],
        theta_sigma=turned.sigma_p[:end],
        seen=seen,
        notes=tuple(notes),
    )


def _near(at: np.ndarray, pose_s: np.ndarray) -> np.ndarray:
    """Return whether the poses around each time are at most `_GAP_S` apart (n,)."""
    after = np.searchsorted(pose_s, at)
    before = pose_s[np.clip(after - 1, 0, len(pose_s) - 1)]
    behind = pose_s[np.clip(after, 0, len(pose_s) - 1)]
    return np.maximum(behind, at) - np.minimum(before, at) <= _GAP_S


@dataclass(frozen=True, kw_only=True, eq=False)
class _Measured:
    """Series of a flight to be smoothed.

    `path` holds positions. `turned` is the rotation of the camera's attitude from the gyro's, relative to
    `base`, the first such rotation. `gyro` is the gyro's attitude on the grid. `start_s` is the start of the
    tracking phase and of the grid, `pose_s` the times of the poses, `interval_s` their median interval.
    """

    flight: Flight
    start_s: float
    interval_s: float
    pose_s: Annotated[np.ndarray, "poses"]
    path: Series
    turned: Series
    base: Any
    gyro: Any


def _measured(flight: Flight, step_s: float, latency_s: float) -> _Measured:
    """Return the series of a flight to be smoothed. Raises TooLittleData."""
    needed = {
        "poses": flight.mocap,
        "control telemetry": flight.control,
        "on-board estimates": flight.estimate,
        "reference": flight.reference,
        "tracking phase": flight.tracking,
    }
    missing = [name for name, value in needed.items() if value is None]
    if missing:
        raise TooLittleData(
            f"{flight.path.name}: no {', no '.join(missing)}; use a flight tracked to its end"
        )
    mocap, control, tracking = flight.mocap, flight.control, flight.tracking
    assert mocap is not None
    assert control is not None
    assert tracking is not None
    start_s, end_s = (t * 1e-6 for t in tracking)
    steps = int((end_s - start_s) / step_s + 1e-6)
    at = start_s + step_s * np.arange(steps + 1)
    taken_s = mocap.t_us * 1e-6 - latency_s
    inside = (taken_s > start_s - 1.0) & (taken_s < end_s + 1.0)
    if steps < _LEAST_STEPS or inside.sum() < _LEAST_POSES:
        raise TooLittleData(f"{flight.path.name}: less than half a second of tracking with poses")
    pose_s, p = taken_s[inside], mocap.p[inside]
    path = Series(t_s=pose_s, samples=p, sigma=_noise(p), at_s=at, jerk_density=_JERK_DENSITY)
    turned, base, gyro = _attitude(pose_s, mocap.q[inside], control, at)
    return _Measured(
        flight=flight,
        start_s=start_s,
        interval_s=float(np.median(np.diff(pose_s))),
        pose_s=pose_s,
        path=path,
        turned=turned,
        base=base,
        gyro=gyro,
    )


def _noise(samples: np.ndarray) -> float:
    """Return the standard deviation of white noise, from third differences, which motion hardly affects."""
    third = np.diff(samples, 3, axis=0)
    return max(float(1.4826 * np.median(np.abs(third)) / np.sqrt(20.0)), 1e-5)


def _attitude(pose_s: np.ndarray, q: np.ndarray, control: Control, at: np.ndarray) -> tuple[Series, Any, Any]:
    """Return the gyro-to-camera rotation relative to the first, the first, and the gyro's attitude at `at`.

    The rotation changes with the gyro's drift.
    """
    length = 1e-6 * (control.t1_us - control.t0_us)
    gap = np.diff(control.t1_us * 1e-6, prepend=control.t0_us[0] * 1e-6)
    covered = np.where(
        np.abs(gap - length) < 1e-4, length, gap
    )  # the next mean also covers an invalid interval
    turns = Rotation.from_rotvec(control.gyro_mean * covered[:, None])
    knots_s = _knots_s(control)
    gyro = _cumulated(turns)
    camera = Rotation.from_quat(q[:, [1, 2, 3, 0]])
    drift = camera * _between(knots_s, gyro, turns, pose_s).inv()
    base = drift[0]
    offset = (drift * base.inv()).as_rotvec()
    series = Series(t_s=pose_s, samples=offset, sigma=_noise(offset), at_s=at, jerk_density=_DRIFT_DENSITY)
    return series, base, _between(knots_s, gyro, turns, at)


def _cumulated(turns: Any) -> Any:
    """Return the products of the first 0, 1, .. n of n rotations.

    Python's floats are faster here than a call for each product.
    """
    x, y, z, w = 0.0, 0.0, 0.0, 1.0
    products = [(x, y, z, w)]
    for a, b, c, d in turns.as_quat().tolist():
        x, y, z, w = (
            w * a + x * d + y * c - z * b,
            w * b - x * c + y * d + z * a,
            w * c + x * b - y * a + z * d,
            w * d - x * a - y * b - z * c,
        )
        products.append((x, y, z, w))
    return Rotation.from_quat(products)


def _knots_s(control: Control) -> np.ndarray:
    """Return times (n + 1,), s: the start of the first gyro mean's interval, then the end of each."""
    sensed_us = control.sensed_us
    return np.concatenate([sensed_us[:1, 0], sensed_us[:, 1]]) * 1e-6


def _between(knots_s: np.ndarray, gyro: Any, turns: Any, at: np.ndarray) -> Any:
    """Return the gyro's attitude at times `at`, at a constant rate between knots."""
    k = np.clip(np.searchsorted(knots_s, at, side="right") - 1, 0, len(knots_s) - 2)
    share = np.clip((at - knots_s[k]) / np.maximum(knots_s[k + 1] - knots_s[k], 1e-9), 0.0, 1.0)
    return gyro[k] * Rotation.from_rotvec(turns[k].as_rotvec() * share[:, None])


def _gyro(control: Control, estimate: Estimate, at: np.ndarray, step_s: float) -> np.ndarray:
    """Return the body rate (n, 3): the gyro's mean over the step around each time, less the on-board bias."""
    edges = _knots_s(control)
    turned = np.concatenate(
        [np.zeros((1, 3)), np.cumsum(control.gyro_mean * np.diff(edges)[:, None], axis=0)]
    )
    half = 0.5 * step_s
    rate = np.column_stack(
        [
            (np.interp(at + half, edges, turned[:, i]) - np.interp(at - half, edges, turned[:, i])) / step_s
            for i in range(3)
        ]
    )
    bias = np.column_stack([np.interp(at, estimate.t_us * 1e-6, estimate.gyro_bias[:, i]) for i in range(3)])
    return rate - bias
