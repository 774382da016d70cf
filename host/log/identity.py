"""Whether two logs hold the same flight, although their files differ."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trimtab.host.log.one_flight import Flight
from trimtab.host.log.tracks import Mocap

_SESSION = ("session_uid", "arm_host_us")
"""Entries of the metadata that name a flight: the vehicle's session and the host's time of arming."""
_SOURCE = "source_id"
"""Entry of the metadata that names what was imported."""


def is_same_flight(first: Flight, second: Flight) -> bool:
    """Return whether two logs hold the same flight.

    This holds for logs of equal content. It also holds for a log and its recovered or edited copy: session
    and time of arming agree, and no pose that both logs contain differs. The poses decide between simulated
    flights of one seed, which share session and time of arming. And it holds for imports of one source,
    whatever their names, column maps and vehicles are.
    """
    if first.id == second.id:
        return True
    if _SOURCE in first.metadata and first.metadata[_SOURCE] == second.metadata.get(_SOURCE):
        return True
    if any(key not in each.metadata for key in _SESSION for each in (first, second)):
        return False
    if any(first.metadata[key] != second.metadata[key] for key in _SESSION):
        return False
    return first.mocap is None or second.mocap is None or _agree(first.mocap, second.mocap)


def log_parents(flights: Sequence[Flight], held_out: Sequence[Flight] = ()) -> dict[str, str]:
    """Return the ids of the logs that a model came from, by role, for its provenance."""
    used = {f"log {index}": flight.id for index, flight in enumerate(flights)}
    return used | {f"held-out log {index}": flight.id for index, flight in enumerate(held_out)}


def _agree(first: Mocap, second: Mocap) -> bool:
    """Return whether the poses that arrived at the same times are equal."""
    _, a, b = np.intersect1d(first.t_arrival_us, second.t_arrival_us, return_indices=True)
    return np.array_equal(first.p[a], second.p[b]) and np.array_equal(first.q[a], second.q[b])
