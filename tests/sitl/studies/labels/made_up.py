"""Worlds of the study of labels that nobody flew."""

from __future__ import annotations

from typing import Any

from trimtab.host.apps.paper.controllers.table import MIN_RESIDUAL, MIN_SNAP, REGRESSORS
from trimtab.sitl.studies.labels.summary import NEURAL, NOMINAL, SMOOTHED, TRUTH

ERRORS_M = {NOMINAL: 0.1, NEURAL: 0.02, SMOOTHED: 0.01, TRUTH: 0.008}


def made_up_world(world: int, courses: int = 2, failed: tuple[str, int] | None = None) -> dict[str, Any]:
    """Return the result of a world; `failed`: controller and course of flights that did not reach the end."""
    rows = [
        {"controller": name, "regressor": regressor, "trajectory": kind, "course": course}
        | (
            {"failed": "flight: tilted"}
            if failed == (name, course)
            else {"failed": None, "error_mean_m": error * (1.0 + world + course)}
        )
        for regressor in REGRESSORS
        for course in range(courses)
        for name, error in ERRORS_M.items()
        for kind in (MIN_SNAP, MIN_RESIDUAL)
    ]
    figures = {"samples": 6000, "label_rms_m_s2": 0.18, "residual_rms_m_s2": 1.2}
    figures |= {"networks_rms_m_s2": dict.fromkeys(REGRESSORS, 0.05)}
    return {"world": world, "selected": "effects", "labels": figures, "rows": rows}
