"""Effect of a smaller residual in flight: min-residual against min-snap and min-control.

The comparison is the same as in `trimtab study paper-planning` (`apps.paper.planning.compare`), with the same
draws. In each sealed world, a model is learned from flights in that world. Held-out courses have the same
waypoints, time, limits and headroom for every kind, and the DFBC flies them without feed-forward through
firmware and radio.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trimtab.host.apps.paper.planning.compare import flown
from trimtab.host.apps.paper.planning.summary import failures, medians, ratio
from trimtab.host.vehicle import Vehicle

KIND = "min-residual"
KINDS = ("min-snap", "min-control", KIND)
_FIGURES = (
    "flights",
    "residual_mean_m_s2",
    "error_mean_m",
    "clipped_share",
    "path_length_m",
    "mean_speed_m_s",
)


@dataclass(frozen=True, kw_only=True)
class Size:
    """Number of worlds, and of courses flown in each."""

    worlds: int = 5
    courses: int = 4

    @property
    def steps(self) -> int:
        """Number of calls of `on_progress`."""
        return self.worlds * (self.courses + 1)


QUICK = Size(worlds=1)


def measure(
    vehicle: Vehicle,
    seed: int,
    on_progress: Callable[[str], None] = lambda step: None,
    *,
    size: Size | None = None,
) -> dict[str, Any]:
    """Return ratios, each a median over courses with a 95 % bootstrap interval, and medians by kind.

    `residual_ratio` is of the mean predicted residual along the references, less that at rest, m/s^2.
    `on_progress` is called `size.steps` times, as each step begins.
    """
    size = size or Size()
    courses = []
    with tempfile.TemporaryDirectory(prefix="trimtab-bench-") as folder:
        for world in range(size.worlds):
            place = Path(folder) / f"{world:02d}"
            found = flown(
                place,
                vehicle,
                seed,
                world,
                size.courses,
                kinds=KINDS,
                residuals=False,
                on_progress=on_progress,
            )
            courses += found["courses"]
    residual = ratio(courses, KIND, "min-snap", "residual_mean_m_s2")
    error, control = (ratio(courses, KIND, base, "error_mean_m") for base in ("min-snap", "min-control"))
    length = ratio(courses, KIND, "min-snap", "path_length_m")
    by_kind = {kind: medians(courses, kind) for kind in KINDS}
    return {
        "kind": KIND,
        "seed": seed,
        "worlds": size.worlds,
        "courses": len(courses),
        "residual_ratio": residual["median"],
        "residual_ratio_ci95": residual["ci95"],
        "error_ratio": error["median"],
        "error_ratio_ci95": error["ci95"],
        "error_ratio_min_control": control["median"],
        "error_ratio_min_control_ci95": control["ci95"],
        "length_ratio": length["median"],
        "kinds": {kind: {name: found[name] for name in _FIGURES} for kind, found in by_kind.items()},
        "failures": [f"{row['course']}, {row['kind']}: {row['why']}" for row in failures(courses)],
    }
