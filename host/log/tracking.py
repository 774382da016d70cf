"""Tracking error and fading of the feed-forward in a flight, and evaluation of a reference at given times."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from trimtab.firmware_model.law.reference import cubic_at, cubic_coefficients, septic_at, septic_coefficients
from trimtab.host.log.one_flight import Flight
from trimtab.host.log.tracks import Floats, Times
from trimtab.protocol.blobs import Reference

FLAT_SIZE = 14
"""p, v, a, j (NED, 3 each), yaw, yaw rate."""


@dataclass(frozen=True, kw_only=True)
class TrackingError:
    """Distance between camera pose and reference over the tracking phase, m, from this number of poses."""

    mean_m: float
    rmse_m: float
    max_m: float
    poses: int


class ReferencePath:
    """A reference as arrays, prepared once for many evaluations."""

    def __init__(self, reference: Reference) -> None:
        nodes, rows = reference.nodes_ned(), reference.yaw_nodes()
        self._starts_us = np.array([node.t_us for node in nodes])
        states = np.array([node.state for node in nodes]).T
        dt_s = np.diff(self._starts_us) * 1e-6
        self._pieces = np.array(septic_coefficients(dt_s, list(states[:, :-1]), list(states[:, 1:])))
        self._yaw_starts_us = np.array([row.t_us for row in rows])
        yaw, rate = np.array([row.yaw for row in rows]), np.array([row.yaw_rate for row in rows])
        dt_s = np.diff(self._yaw_starts_us) * 1e-6
        self._yaw_pieces = np.array(cubic_coefficients(dt_s, yaw[:-1], rate[:-1], yaw[1:], rate[1:]))
        self._yaw = float(yaw[0])

    def at(self, t_us: Annotated[Times, "times"]) -> Annotated[Floats, "times 14"]:
        """Return flat outputs at `t_us` after the start; outside it, those of the end nodes."""
        starts = self._starts_us
        inside = np.clip(t_us, 0, starts[-1])
        k = _piece(starts, inside)
        p, v, a, j, _ = septic_at(list(self._pieces[:, k]), (inside - starts[k]) * 1e-6)
        return np.stack([*p, *v, *a, *j, *self._yaw_at(inside)], axis=1)

    def _yaw_at(self, t_us: Times) -> tuple[Floats, Floats]:
        """Return yaw and yaw rate. Before the first and after the last yaw node, yaw is constant."""
        starts = self._yaw_starts_us
        if len(starts) == 1:
            return np.full(len(t_us), self._yaw), np.zeros(len(t_us))
        k = _piece(starts, t_us)
        s_s = (np.clip(t_us, starts[0], starts[-1]) - starts[k]) * 1e-6
        inner, inner_rate = cubic_at(list(self._yaw_pieces[:, k]), s_s)
        held = (t_us < starts[0]) | (t_us > starts[-1])
        return inner, np.where(held, 0.0, inner_rate)


def _piece(starts_us: Times, t_us: Times) -> Times:
    """Return the index of the piece that each time is in."""
    return np.clip(np.searchsorted(starts_us, t_us, side="right") - 1, 0, len(starts_us) - 2)


def reference_at(reference: Reference, t_us: Annotated[Times, "times"]) -> Annotated[Floats, "times 14"]:
    """Return flat outputs at `t_us` after the start; outside it, those of the end nodes."""
    return ReferencePath(reference).at(t_us)


def within(
    times_us: Annotated[Times, "times"], interval_us: tuple[int, int]
) -> Annotated[np.ndarray, "times"]:
    """Return whether each time is in the interval, ends included, as in `Flight.tracking`."""
    return (times_us >= interval_us[0]) & (times_us <= interval_us[1])


def tracking_errors_ned(flight: Flight, *, pose_age_s: float = 0.0) -> Annotated[Floats, "poses 3"] | None:
    """Return pose minus reference, m, whose norm `tracking_error` sums up; None where it has no figures."""
    if flight.reference is None or flight.tracking is None or flight.mocap is None:
        return None
    t_us = flight.mocap.t_us - round(1e6 * pose_age_s)
    keep = within(t_us, flight.tracking)
    if not keep.any():
        return None
    return flight.mocap.p[keep] - reference_at(flight.reference, t_us[keep] - flight.tracking[0])[:, :3]


def tracking_error(flight: Flight, *, pose_age_s: float = 0.0) -> TrackingError | None:
    """Return the error over the flown part of the tracking phase; None without reference, phase or poses.

    pose_age_s: by how much poses are older than their stamps.
    """
    errors = tracking_errors_ned(flight, pose_age_s=pose_age_s)
    if errors is None:
        return None
    distances = np.linalg.norm(errors, axis=1)
    return TrackingError(
        mean_m=float(distances.mean()),
        rmse_m=float(np.sqrt((distances**2).mean())),
        max_m=float(distances.max()),
        poses=len(distances),
    )


def feedforward_faded_s(flight: Flight) -> float | None:
    """Return how long the feed-forward was faded in the tracking phase, s; None without one or a phase.

    Resolved to the interval between statuses.
    """
    status = flight.status
    if flight.feedforward is None or flight.tracking is None or status is None:
        return None
    start_us, end_us = flight.tracking
    edges_us = np.clip(np.append(status.t_us, max(end_us, status.t_us[-1])), start_us, end_us)
    return int(np.diff(edges_us)[status.feedforward_faded > 0].sum()) / 1e6
