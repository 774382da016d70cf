"""Samples on a common lattice of times, so that several flights share one time axis."""

from __future__ import annotations

import base64
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np

from trimtab.firmware_model.law.rotations import matrix_to_euler, quat_from_euler, quat_to_matrix
from trimtab.host.codegen import NUMPY
from trimtab.host.log.tracks import Floats, Times

FINEST_US = 10_000
SAMPLES_MAX = 12_000
"""Most samples of a channel on a page, over all tracks."""
_GAP_US = 150_000
"""Time between samples above which a line is interrupted."""


@dataclass(frozen=True, kw_only=True)
class Track:
    """One flight or plan on a page.

    Times are on a lattice: sample i of each channel is at (first + i) * step_us after the time `zero`. A
    channel is (samples, width), NaN where there is no value. `what` is "flight", "import" or "plan".
    `group` is the heading under which a reader chooses the track, `shown` whether it is chosen at first.
    """

    name: str
    what: str
    simulated: bool
    reference_id: str | None
    zero: str
    first: int
    step_us: int
    channels: dict[str, Annotated[Floats, "samples width"]]
    events: tuple[dict[str, Any], ...] = ()
    vehicle: dict[str, Any] = field(default_factory=dict)
    group: str = ""
    shown: bool = True

    def to_json(self) -> dict[str, Any]:
        """Return the track for the page; channels as little-endian float32 in base64, row by row."""
        return {
            "name": self.name,
            "what": self.what,
            "simulated": self.simulated,
            "reference_id": self.reference_id,
            "zero": self.zero,
            "first": self.first,
            "step_s": self.step_us * 1e-6,
            "events": list(self.events),
            "vehicle": self.vehicle,
            "group": self.group,
            "shown": self.shown,
            "channels": {
                name: {"width": values.shape[1], "data": encoded(values)}
                for name, values in self.channels.items()
            },
        }


def encoded(values: Floats) -> str:
    """Return an array as little-endian float32 in base64."""
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode()


def step_for(total_us: int) -> int:
    """Return the step of the lattice for tracks of this total duration, us."""
    return FINEST_US * max(1, -(-total_us // (FINEST_US * SAMPLES_MAX)))


def lattice(start_us: int, end_us: int, step_us: int) -> Annotated[Times, "samples"]:
    """Return the multiples of the step from `start_us` to `end_us`, at least one."""
    first = -(-start_us // step_us)
    return step_us * np.arange(first, max(first, end_us // step_us) + 1, dtype=np.int64)


def sampled(
    at_us: Annotated[Times, "samples"], t_us: Annotated[Times, "rows"], values: Floats
) -> Annotated[Floats, "samples width"]:
    """Return values (rows,) or (rows, width) interpolated linearly; NaN in gaps and beyond the ends.

    An end value is kept for 10 ms, so that a line reaches the start of tracking between two samples.
    """
    columns = values.reshape(len(t_us), -1)
    rows = np.stack([np.interp(at_us, t_us, column) for column in columns.T], axis=1)
    k = np.searchsorted(t_us, at_us, side="right")
    before, after = t_us[np.clip(k - 1, 0, len(t_us) - 1)], t_us[np.clip(k, 0, len(t_us) - 1)]
    outside = (at_us < t_us[0] - FINEST_US) | (at_us > t_us[-1] + FINEST_US)
    wide = (after - before > _GAP_US) & (at_us != before)
    rows[outside | wide] = np.nan
    return rows


def peaks(at_us: Times, t_us: Times, values: Annotated[Floats, "rows"]) -> Annotated[Floats, "samples 1"]:
    """Return values as `sampled`, but no peak between two samples is lost."""
    rows = sampled(at_us, t_us, values)[:, 0]
    step_us = int(at_us[1] - at_us[0]) if len(at_us) > 1 else 1
    bins = np.rint((t_us - at_us[0]) / step_us).astype(int)
    inside = (bins >= 0) & (bins < len(rows))
    np.fmax.at(rows, bins[inside], values[inside])
    return rows[:, None]


def attitudes(at_us: Times, t_us: Times, q: Annotated[Floats, "rows 4"]) -> Annotated[Floats, "samples 4"]:
    """Return attitudes as unit quaternions, interpolated along the shorter way."""
    flips = np.where((q[1:] * q[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
    continuous = q * np.concatenate([[1.0], np.cumprod(flips)])[:, None]
    rows = sampled(at_us, t_us, continuous)
    with np.errstate(invalid="ignore"):
        return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def wrapped_deg(angle: Annotated[Floats, "samples"]) -> Annotated[Floats, "samples"]:
    """Return angles, rad, as degrees within -180 and 180."""
    return np.degrees(np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi)


def euler_deg(q: Annotated[Floats, "samples 4"]) -> Annotated[Floats, "samples 3"]:
    """Return roll, pitch and yaw (z-y-x), degrees, of quaternions w first."""
    return np.degrees(np.stack(matrix_to_euler(NUMPY, quat_to_matrix(NUMPY, tuple(q.T))), axis=1))


def quaternions(euler_rad: Annotated[Floats, "samples 3"]) -> Annotated[Floats, "samples 4"]:
    """Return quaternions, w first, of roll, pitch and yaw (z-y-x), rad; inverse of `euler_deg`."""
    return np.stack(quat_from_euler(NUMPY, *euler_rad.T), axis=1)
