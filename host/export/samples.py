"""A reference at any time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from trimtab.host.log.tracking import reference_at
from trimtab.protocol.blobs import Reference


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """Flat outputs at times after the start of a reference: NED, SI, radians; yaw rate is that of the yaw."""

    t_s: Annotated[np.ndarray, "times"]
    p_ned: Annotated[np.ndarray, "times 3"]
    v_ned: Annotated[np.ndarray, "times 3"]
    a_ned: Annotated[np.ndarray, "times 3"]
    j_ned: Annotated[np.ndarray, "times 3"]
    yaw: Annotated[np.ndarray, "times"]
    yaw_rate: Annotated[np.ndarray, "times"]


def sample(reference: Reference, t_s: ArrayLike) -> Samples:
    """Return the reference at times in seconds (N,), rounded to microseconds.

    Raises ValueError for a time before its start or after its end.
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
