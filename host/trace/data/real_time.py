"""Parts of a flight in real time that a busy computer or network has spoiled.

The vehicle flies by the poses that the host forwards. One that comes late, or with a wrong stamp because the
clocks were compared while messages were late, moves it without any physical cause.
"""

from __future__ import annotations

import numpy as np

from trimtab.host.log import Flight
from trimtab.host.trace.data.stretches import merged_spans, runs_of
from trimtab.host.trace.decision.rules import RULES


def late_spans(flight: Flight) -> list[tuple[float, float]]:
    """Return the spans in s since arming that are left out because time ran late.

    There are none in a flight in lock-step, nor in one that is not judged at all.
    """
    spans = _spans(flight)
    return [] if _share(flight, spans) > RULES.late_share else spans


def is_too_late(flight: Flight) -> bool:
    """Return whether time ran late for so long that the flight as a whole is not judged."""
    return late_share(flight) > RULES.late_share


def late_share(flight: Flight) -> float:
    """Return the share of the tracking phase in which the vehicle flew by late or wrongly stamped poses."""
    return _share(flight, _spans(flight))


def _share(flight: Flight, spans: list[tuple[float, float]]) -> float:
    if flight.tracking is None:
        return 0.0
    start_s, end_s = (1e-6 * edge for edge in flight.tracking)
    return sum(max(0.0, min(b, end_s) - max(a, start_s)) for a, b in spans) / (end_s - start_s)


def _spans(flight: Flight) -> list[tuple[float, float]]:
    mocap = flight.mocap
    if flight.timing is None or mocap is None:
        return []
    wrong = mocap.late_us > 1e6 * RULES.late_pose_s
    if mocap.forwarded_us is not None:
        wrong |= np.abs(mocap.forwarded_us - mocap.t_us) > 1e6 * RULES.clock_jump_s
    runs = runs_of(1e-6 * mocap.t_us, wrong)
    return merged_spans([(begin, end + RULES.late_recovery_s) for begin, end in runs])
