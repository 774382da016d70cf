"""Tracking error of a flight, and evaluation of a reference at given times."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from trimtab.firmware_model.law.reference import hermite_yaw, septic
from trimtab.host.log.tracks import Flight, Floats, Times
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


def reference_at(reference: Reference, t_us: Annotated[Times, "times"]) -> Annotated[Floats, "times 14"]:
    """Return flat outputs at `t_us` after the start; outside it, those of the end nodes."""
    nodes = reference.nodes_ned()
    starts = np.array([node.t_us for node in nodes])
    states = np.array([node.state for node in nodes]).T
    inside = np.clip(t_us, 0, starts[-1])
    k = np.clip(np.searchsorted(starts, inside, side="right") - 1, 0, len(nodes) - 2)
    dt_s, s_s = (starts[k + 1] - starts[k]) * 1e-6, (inside - starts[k]) * 1e-6
    p, v, a, j, _ = septic(dt_s, s_s, list(states[:, k]), list(states[:, k + 1]))
    return np.stack([*p, *v, *a, *j, *_yaw_at(reference, inside)], axis=1)


def _yaw_at(reference: Reference, t_us: Times) -> tuple[Floats, Floats]:
    """Return yaw and yaw rate. Before the first and after the last yaw node, yaw is constant."""
    rows = reference.yaw_nodes()
    starts = np.array([row.t_us for row in rows])
    yaw, rate = np.array([row.yaw for row in rows]), np.array([row.yaw_rate for row in rows])
    if len(rows) == 1:
        return np.full(len(t_us), yaw[0]), np.zeros(len(t_us))
    k = np.clip(np.searchsorted(starts, t_us, side="right") - 1, 0, len(rows) - 2)
    dt_s = (starts[k + 1] - starts[k]) * 1e-6
    s_s = (np.clip(t_us, starts[0], starts[-1]) - starts[k]) * 1e-6
    inner, inner_rate = hermite_yaw(dt_s, s_s, yaw[k], rate[k], yaw[k + 1], rate[k + 1])
    held = (t_us < starts[0]) | (t_us > starts[-1])
    return inner, np.where(held, 0.0, inner_rate)


def tracking_errors_ned(flight: Flight) -> Annotated[Floats, "poses 3"] | None:
    """Return pose minus reference, m, whose norm `tracking_error` sums up; None where it has no figures."""
    if flight.reference is None or flight.tracking is None or flight.mocap is None:
        return None
    start_us, end_us = flight.tracking
    keep = (flight.mocap.t_us >= start_us) & (flight.mocap.t_us <= end_us)
    if not keep.any():
        return None
    p_ref = reference_at(flight.reference, flight.mocap.t_us[keep] - start_us)[:, :3]
    return flight.mocap.p[keep] - p_ref


def tracking_error(flight: Flight) -> TrackingError | None:
    """Return the error over the flown part of the tracking phase; None without reference, phase or poses."""
    errors = tracking_errors_ned(flight)
    if errors is None:
        return None
    distances = np.linalg.norm(errors, axis=1)
    return TrackingError(
        mean_m=float(distances.mean()),
        rmse_m=float(np.sqrt((distances**2).mean())),
        max_m=float(distances.max()),
        poses=len(distances),
    )
