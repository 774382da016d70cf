"""Samples of a reference as CSV and JSON."""

from __future__ import annotations

import json
from collections.abc import Iterable

import numpy as np

from trimtab.host.export.samples import Samples, at_rate
from trimtab.protocol.blobs import Reference

_NED = ("north", "east", "down")
_FLAT = (("position", "m"), ("velocity", "m_s"), ("acceleration", "m_s2"), ("jerk", "m_s3"))


def csv_table(reference: Reference, rate_hz: float) -> str:
    """Return a table: time in s, then position, velocity, acceleration and jerk in NED, yaw and its rate."""
    names = [f"{name}_{axis}_{unit}" for name, unit in _FLAT for axis in _NED]
    header = ["t_s", *names, "yaw_rad", "yaw_rate_rad_s"]
    held = at_rate(reference, rate_hz)
    return _table(header, (f"{t:.6f}" for t in held.t_s), _columns(held))


def px4_table(reference: Reference, rate_hz: float) -> str:
    """Return a table with the field names of px4_msgs/TrajectorySetpoint, NED; timestamp in us from 0."""
    fields = [f"{name}[{k}]" for name, _ in _FLAT for k in range(3)]
    held = at_rate(reference, rate_hz)
    times = (f"{t:.0f}" for t in np.rint(1e6 * held.t_s))
    return _table(["timestamp", *fields, "yaw", "yawspeed"], times, _columns(held))


def json_table(reference: Reference, rate_hz: float) -> str:
    """Return the same samples as one JSON object, with the ids of reference and vehicle."""
    held = at_rate(reference, rate_hz)
    content = {
        "reference": reference.id,
        "vehicle": reference.vehicle_id,
        "frame": "NED",
        "rate_hz": rate_hz,
        **held.to_dict(),
    }
    return json.dumps(content, allow_nan=False) + "\n"


def _columns(held: Samples) -> np.ndarray:
    return np.column_stack([held.p_ned, held.v_ned, held.a_ned, held.j_ned, held.yaw, held.yaw_rate])


def _table(header: Iterable[str], times: Iterable[str], columns: np.ndarray) -> str:
    rows = [",".join(header)]
    for time, row in zip(times, columns.tolist(), strict=True):
        rows.append(",".join([time, *(f"{value:.9g}" for value in row)]))
    return "\n".join(rows) + "\n"
