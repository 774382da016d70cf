"""A reference at any time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from trimtab.host.log.tracking import reference_at
from trimtab.protocol.blobs import Reference


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """Flat outputs at N times after the start of a reference, NED.

    Attributes
    ----------
    t_s
        Times (N,), s.
    p_ned, v_ned, a_ned, j_ned
        Position, velocity, acceleration and jerk (N, 3): m, m/s, m/s^2, m/s^3.
    yaw, yaw_rate
        Heading (N,), rad, clockwise from north, and its rate (N,), rad/s.
    """

    t_s: Annotated[np.ndarray, "times"]
    p_ned: Annotated[np.ndarray, "times 3"]
    v_ned: Annotated[np.ndarray, "times 3"]
    a_ned: Annotated[np.ndarray, "times 3"]
    j_ned: Annotated[np.ndarray, "times 3"]
    yaw: Annotated[np.ndarray, "times"]
    yaw_rate: Annotated[np.ndarray, "times"]

    def to_dict(self) -> dict[str, Any]:
        """Return the samples that `trimtab export --format json` writes, as plain data."""
        return {
            "t_s": self.t_s.tolist(),
            "position_m": self.p_ned.tolist(),
            "velocity_m_s": self.v_ned.tolist(),
            "acceleration_m_s2": self.a_ned.tolist(),
            "jerk_m_s3": self.j_ned.tolist(),
            "yaw_rad": self.yaw.tolist(),
            "yaw_rate_rad_s": self.yaw_rate.tolist(),
        }


def sample(reference: Reference, t_s: ArrayLike) -> Samples:
    """Return a reference at any times.

    Parameters
    ----------
    reference
        Reference of a plan or of a flight.
    t_s
        Times (N,) after its start, s, rounded to microseconds.

    Returns
    -------
    Samples
        Position, velocity, acceleration and jerk (N, 3), NED, SI; yaw and yaw rate (N,), rad and rad/s.

    Raises
    ------
    ValueError
        For a time before its start or after its end.
    """
    times = np.atleast_1d(np.asarray(t_s, dtype=float))
    t_us = np.rint(1e6 * times)
    if not ((t_us >= 0) & (t_us <= reference.duration_us)).all():
        end_s = reference.duration_us * 1e-6
        raise ValueError(f"a time is outside the reference, which lasts from 0 to {end_s:g} s")
    flat = reference_at(reference, t_us.astype(np.int64))
    p, v, a, j, yaw = np.split(flat, [3, 6, 9, 12], axis=1)
    return Samples(t_s=times, p_ned=p, v_ned=v, a_ned=a, j_ned=j, yaw=yaw[:, 0], yaw_rate=yaw[:, 1])


def at_rate(reference: Reference, rate_hz: float) -> Samples:
    """Return samples from the start at this rate, and one at the end."""
    end_us = reference.duration_us
    t_us = np.rint(np.arange(0.0, end_us, 1e6 / rate_hz)).astype(np.int64)
    return sample(reference, np.append(t_us[t_us < end_us], end_us) * 1e-6)
