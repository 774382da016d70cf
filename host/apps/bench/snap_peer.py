"""Minimum-snap spline by minsnap-trajectories: closed form, septic, with continuous jerk, as ours."""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trimtab.host.apps.bench.timing import best_ms
from trimtab.host.plan.snap import solve_snap

Array = NDArray[np.float64]

SAME = 1e-6
"""Greatest difference from ours over the greatest entry, of each derivative."""


def installed() -> bool:
    """Return whether minsnap-trajectories can be imported."""
    return importlib.util.find_spec("minsnap_trajectories") is not None


def measure(waypoints_ned: Array, durations_s: Array, *, repeats: int = 100) -> dict[str, Any] | None:
    """Return the best times of both for waypoints (K, 3) and leg times (K - 1,): ms, ours_ms, differs.

    `differs` is the difference of position, velocity, acceleration and jerk at the waypoints, which determine
    the septics, each over its greatest entry. Returns None if the peer is not installed. Raises ValueError if
    its spline differs.
    """
    if not installed():
        return None
    import minsnap_trajectories as peer  # pyright: ignore[reportMissingImports]

    ours = solve_snap(waypoints_ned, durations_s)
    last = len(waypoints_ned) - 1
    rest = {name: np.zeros(3) for name in ("velocity", "acceleration", "jerk")}
    passed = [
        peer.Waypoint(time=float(t_s), position=p_ned, **(rest if k in (0, last) else {}))
        for k, (t_s, p_ned) in enumerate(zip(ours.times_s, waypoints_ned, strict=True))
    ]

    def run() -> Any:
        return peer.generate_trajectory(
            passed, degree=7, idx_minimized_orders=4, num_continuous_orders=4, algorithm="closed-form"
        )

    found = peer.compute_trajectory_derivatives(run(), ours.times_s, 4)
    wanted = ours.ends_ned.transpose(1, 0, 2)
    differs = float((np.abs(found - wanted).max(axis=(1, 2)) / np.abs(wanted).max(axis=(1, 2))).max())
    if not differs <= SAME:
        raise ValueError(f"minsnap-trajectories: the spline differs by {differs:.2g} of the greatest entry")
    return {
        "waypoints": last + 1,
        "ms": best_ms(run, repeats=repeats),
        "ours_ms": best_ms(lambda: solve_snap(waypoints_ned, durations_s), repeats=repeats),
        "differs": differs,
    }
