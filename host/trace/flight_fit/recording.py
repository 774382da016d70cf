"""Measurements of a whole flight as means of poses, body rate and rate integral over bins of 40 ms."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from scipy.sparse import csr_array

from trimtab.firmware_model.law import step as law_step
from trimtab.host.log import Flight
from trimtab.host.models.states import States, firmware_parameters_of
from trimtab.host.trace.data.real_time import late_spans
from trimtab.host.trace.data.signals import FlightData
from trimtab.host.trace.decision.rules import RULES

SAMPLE_S = 0.02
"""Interval between the samples of a roll-out."""

PER_BIN = 2
"""Sample intervals in a bin."""

FLIGHT_BIN_S = PER_BIN * SAMPLE_S
"""Length of a bin."""

_KEPT = 2
"""Latencies of which a recording keeps the matrix."""

_AT_LIMIT = 0.99
"""Share of its limit from which on the rate integral counts as at the limit."""
_ABOUT_LIMIT = 3
"""Bins before and after those in which the rate integral is at its limit; not compared either."""

LEAD_S = 0.3
"""Time after the start of the reference that is not compared. Errors of the initial state decay in it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """Measurements of one flight in bins of FLIGHT_BIN_S from the start of the reference.

    Attributes
    ----------
    states
        Initial state, control law and constants of the flight.
    pose_s
        Stamps in s since the start of the reference of each pose.
    poses
        Matrix (bins, poses) of the means over the poses of each bin.
    measured
        Bin values, three each: position NED m, Euler angles Theta rad, body rate FRD rad/s, rate
        integral FRD. The rate integral is the value in the middle of the bin; the others are means.
    known
        Mask of the bins in which all channels were measured, without those in which the rate integral
        reaches its limit, stays there or leaves it, and those in which time ran late.
    rates, integrals
        Matrices (bins, samples) that map states sampled every SAMPLE_S to what telemetry records of them.
        Gyro means cover whole telemetry intervals. The rate integral is interpolated linearly between
        received frames, also across lost frames.
    """

    states: States
    pose_s: Annotated[np.ndarray, "poses"]
    poses: csr_array
    measured: Annotated[np.ndarray, "bins 12"]
    known: Annotated[np.ndarray, "bins"]
    rates: csr_array
    integrals: csr_array
    _at_poses: dict[tuple[float, int], csr_array] = field(default_factory=dict, init=False, repr=False)

    @property
    def bins(self) -> int:
        """Number of bins."""
        return len(self.measured)

    def at_poses(self, latency_s: float, samples: int) -> csr_array:
        """Return the matrix (poses, samples) of states at the poses, which are late by latency_s.

        The latest matrices are kept: the lanes of a fit have one latency or two.
        """
        key = (latency_s, samples)
        if key not in self._at_poses:
            if len(self._at_poses) == _KEPT:
                del self._at_poses[next(iter(self._at_poses))]
            self._at_poses[key] = interpolation(self.pose_s - latency_s, samples)
        return self._at_poses[key]


def record(data: FlightData, states: States) -> Recording:
    """Return the recording of a flight whose log holds a reference, a control law and control telemetry.

    states: initial state, control law and constants of the same flight.
    """
    flight, s = data.flight, data.signals
    start = s.span_s[0]
    duration = min(states.reference.nodes[-1].t_us * 1e-6, s.span_s[1] - start)
    bins = int(duration / FLIGHT_BIN_S)
    t = s.pose_s - start
    inside = (t >= 0.0) & (t < bins * FLIGHT_BIN_S)
    pose_bin = bins_of_times(t[inside], bins)
    angles = _euler(s.R_ned_frd[inside])
    poses = np.column_stack([s.p_ned[inside], angles])
    count = np.bincount(pose_bin, minlength=bins)
    sums = np.column_stack([np.bincount(pose_bin, column, minlength=bins) for column in poses.T])
    samples = bins * PER_BIN + 1
    shares = _shares(FLIGHT_BIN_S * np.arange(bins + 1), s.imu_s - start)
    covered = shares.sum(1)
    shares = shares.multiply(1.0 / np.maximum(covered, 1e-9)[:, None]).tocsr()
    assert flight.control is not None
    frames_s = flight.control.sensed_us[:, 1] * 1e-6 - start
    between = _between_frames(FLIGHT_BIN_S * (np.arange(bins) + 0.5), frames_s)
    integral = between @ flight.control.rate_integral
    limited = _about(_at_limit(flight, integral))
    middle_s = FLIGHT_BIN_S * (np.arange(bins) + 0.5)
    unused = middle_s < LEAD_S
    for begin_s, end_s in late_spans(flight):
        unused |= (middle_s > begin_s - start) & (middle_s < end_s - start)
    return Recording(
        states=states,
        pose_s=t[inside],
        poses=csr_array(
            (1.0 / np.maximum(count, 1)[pose_bin], (pose_bin, np.arange(len(pose_bin)))),
            shape=(bins, len(pose_bin)),
        ),
        measured=np.column_stack(
            [
                sums / np.maximum(count, 1)[:, None],
                shares @ s.rate_frd,
                integral,
            ]
        ),
        known=(count > 0) & (covered > RULES.min_coverage * FLIGHT_BIN_S) & ~unused & ~limited,
        rates=shares @ _interval_means(s.imu_s - start, samples),
        integrals=between @ interpolation(frames_s, samples),
    )


def limited_share(data: FlightData) -> float:
    """Return the share of the tracking time that `record` leaves out since the rate integral is limited.

    0 without control telemetry.
    """
    control = data.flight.control
    if control is None:
        return 0.0
    start, end = data.signals.span_s
    t_s = control.sensed_us[:, 1] * 1e-6
    tracking = (t_s >= start) & (t_s <= end)
    limited = _at_limit(data.flight, control.rate_integral[tracking])
    return float(limited.mean()) if limited.size else 0.0


def _at_limit(flight: Flight, integral: Annotated[np.ndarray, "values 3"]) -> Annotated[np.ndarray, "values"]:
    """Return the mask of the values of the rate integral at which an axis is at its limit, but not in all.

    A limited integral does not show how much torque is missing, and a prediction that reaches the limit
    earlier or later has an error that no linearisation and no autoregression expects. An axis that is at its
    limit throughout is so in the prediction too.
    """
    limit = np.array(law_step.integral_limit(law_step.parameter_vector(firmware_parameters_of(flight))))
    at_limit = np.abs(integral) > _AT_LIMIT * limit
    return np.any(at_limit & ~at_limit.all(0), axis=1)


def _about(at_limit: Annotated[np.ndarray, "bins"]) -> Annotated[np.ndarray, "bins"]:
    """Return the mask of the bins at a limit and of _ABOUT_LIMIT bins before and after them."""
    about = np.convolve(at_limit.astype(int), np.ones(2 * _ABOUT_LIMIT + 1, dtype=int))
    return about[_ABOUT_LIMIT : _ABOUT_LIMIT + len(at_limit)] > 0


def bins_of_times(t_s: Annotated[np.ndarray, "times"], bins: int) -> Annotated[np.ndarray, "times"]:
    """Return the bin of each time in [0, bins * FLIGHT_BIN_S).

    A time just before the end may divide to `bins` in floating point; it belongs to the last bin.
    """
    return np.minimum((t_s / FLIGHT_BIN_S).astype(int), bins - 1)


def _shares(edges_s: np.ndarray, interval_s: np.ndarray) -> csr_array:
    """Return the overlap (n, m) in s of n bins, between n + 1 edges, with m intervals (m, 2) in order."""
    cuts = np.unique(np.clip(np.concatenate([edges_s, interval_s.ravel()]), edges_s[0], edges_s[-1]))
    middle = 0.5 * (cuts[1:] + cuts[:-1])
    owner = np.maximum(np.searchsorted(interval_s[:, 0], middle, side="right") - 1, 0)
    inside = (middle > interval_s[owner, 0]) & (middle < interval_s[owner, 1])
    rows = np.searchsorted(edges_s, middle[inside], side="right") - 1
    shape = (len(edges_s) - 1, len(interval_s))
    return csr_array((np.diff(cuts)[inside], (rows, owner[inside])), shape=shape)


def _interval_means(interval_s: np.ndarray, samples: int) -> csr_array:
    """Return the matrix (m, samples) of means over intervals (m, 2) in s, by Simpson's rule.

    It applies to samples that are SAMPLE_S apart.
    """
    length = np.diff(interval_s, axis=1)[:, 0]
    parts = np.maximum(np.ceil(length / SAMPLE_S - 1e-6), 1.0).astype(int)
    owner = np.repeat(np.arange(len(interval_s)), parts)
    part = np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts)
    nodes = part[:, None] + np.array([0.0, 0.5, 1.0])
    at = interval_s[owner, :1] + nodes * (length / parts)[owner, None]
    weights = np.array([1.0, 4.0, 1.0]) / 6.0 / parts[owner, None]
    rule = csr_array(
        (weights.ravel(), (np.repeat(owner, 3), np.arange(weights.size))),
        shape=(len(interval_s), weights.size),
    )
    return rule @ interpolation(at.ravel(), samples)


def _between_frames(at_s: np.ndarray, frames_s: np.ndarray) -> csr_array:
    """Return the matrix (n, m) of linear interpolation at n times between m frames.

    Outside the frames it takes the value of the nearest frame.
    """
    k = np.clip(np.searchsorted(frames_s, at_s, side="right") - 1, 0, len(frames_s) - 2)
    u = np.clip((at_s - frames_s[k]) / np.maximum(frames_s[k + 1] - frames_s[k], 1e-9), 0.0, 1.0)
    rows = np.repeat(np.arange(len(at_s)), 2)
    columns = np.column_stack([k, k + 1]).ravel()
    weights = np.column_stack([1.0 - u, u]).ravel()
    return csr_array((weights, (rows, columns)), shape=(len(at_s), len(frames_s)))


def interpolation(t_s: Annotated[np.ndarray, "times"], samples: int) -> csr_array:
    """Return the matrix (times, samples) of cubic interpolation at times t_s.

    Samples are SAMPLE_S apart. The cubic goes through the four nearest samples.
    """
    t = np.clip(t_s / SAMPLE_S, 0.0, samples - 1.0)
    k = np.clip(t.astype(int), 1, samples - 3)
    u = t - k
    weights = np.column_stack(
        [
            -u * (u - 1.0) * (u - 2.0) / 6.0,
            (u + 1.0) * (u - 1.0) * (u - 2.0) / 2.0,
            -(u + 1.0) * u * (u - 2.0) / 2.0,
            (u + 1.0) * u * (u - 1.0) / 6.0,
        ]
    )
    columns = (k[:, None] + np.arange(-1, 3)).ravel()
    return csr_array((weights.ravel(), columns, 4 * np.arange(len(t) + 1)), shape=(len(t), samples))


def _euler(R: np.ndarray) -> np.ndarray:
    """Return Euler angles Theta (n, 3) in rad of R_ned_frd (n, 3, 3), with yaw unwrapped."""
    roll = np.arctan2(R[:, 2, 1], R[:, 2, 2])
    pitch = -np.arcsin(np.clip(R[:, 2, 0], -1.0, 1.0))
    return np.column_stack([roll, pitch, np.unwrap(np.arctan2(R[:, 1, 0], R[:, 0, 0]))])
