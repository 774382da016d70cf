"""Pieces of the study that nobody flew."""

from __future__ import annotations

from typing import Any

from trimtab.host.apps.paper.controllers.design import SPEEDS, cells
from trimtab.host.apps.paper.controllers.table import (
    BASELINE_TRAJECTORIES,
    MIN_ERROR,
    MIN_RESIDUAL,
    MIN_RESIDUAL_STAR,
    REGRESSORS,
    SETS,
    TRAJECTORIES,
)

BASE_M = 0.1
CONTROLLERS = {
    "dfbc": 1.0,
    "dfbc-do": 0.9,
    "dfbc-neural": 0.8,
    "dfbc-neural-do": 0.7,
    "dfbc-traced": 0.6,
    "dfbc-traced-do": 0.5,
    "mpc": 0.9,
    "mpc-l1": 0.8,
    "mpc-neural": 0.4,
    "mpc-neural-c": 0.5,
    "mpc-traced": 0.3,
}
"""Share of the baseline's error that each controller leaves on min-snap."""
SHARES = {MIN_RESIDUAL: 0.7, MIN_RESIDUAL_STAR: 0.3, MIN_ERROR: 0.25}
"""Share of the error on min-snap that a trajectory leaves; 1 for the others."""


def error_m(controller: str, trajectory: str) -> float:
    """Error that holds every claim: on the starred trajectory, differences between controllers are halved."""
    factor = CONTROLLERS[controller]
    return BASE_M * SHARES.get(trajectory, 1.0) * (factor**0.5 if trajectory == MIN_RESIDUAL_STAR else factor)


def row(controller: str, regressor: str, trajectory: str, **entries: Any) -> dict[str, Any]:
    """The row of a flight; keyword arguments replace entries."""
    error = error_m(controller, trajectory)
    found: dict[str, Any] = {
        "controller": controller,
        "regressor": regressor,
        "trajectory": trajectory,
        "anchor": False,
        "failed": None,
        "error_mean_m": error,
        "error_rmse_m": 1.1 * error,
        "error_max_m": 2.0 * error,
        "clipped_share": 0.0,
        "jerk_rms_m_s3": 10.0 / SHARES.get(trajectory, 1.0),
    }
    if controller.startswith("mpc"):
        found |= {"step_ms_p50": 4.0 * CONTROLLERS[controller], "step_ms_p99": 8.0 * CONTROLLERS[controller]}
    return found | entries


def full(course: int = 0, setting: str = "radio") -> dict[str, Any]:
    """A course like the paper's."""
    rows = [
        row(each.name, flown.regressor, kind)
        for flown in SETS
        for each in flown.controllers
        for kind in TRAJECTORIES
    ]
    return {
        "kind": "full",
        "course": course,
        "setting": setting,
        "selected": "effects and network",
        "rows": rows,
    }


def select(course: int) -> dict[str, Any]:
    """A tuning course for the trajectory of the baseline."""
    rows = [
        row("dfbc", regressor, kind, speed=speed)
        for speed in SPEEDS
        for regressor in REGRESSORS
        for kind in BASELINE_TRAJECTORIES
    ]
    return {"kind": "select", "course": course, "selected": "effects", "rows": rows}


def balanced(world: int, course: int) -> dict[str, Any]:
    """A course of the balanced design."""
    rows = []
    for cell in cells(course):
        where = {"speed": cell.speed, "family": cell.flown.family}
        rows += [
            row(each.name, cell.flown.regressor, kind, **where)
            for each in cell.flown.controllers
            for kind in TRAJECTORIES
        ]
        rows += [row("dfbc", cell.flown.regressor, kind, **where, anchor=True) for kind in cell.anchors]
    assert {each["speed"] for each in rows} == set(SPEEDS)
    return {"kind": "balanced", "world": world, "course": course, "selected": "effects", "rows": rows}


def front(world: int) -> dict[str, Any]:
    """A course with plans of three weights, one of which was refused."""
    flown = {"course": 0, "failed": None, "residual_rms_m_s2": 1.0}
    rows = [
        {**flown, "plan": "min-snap", "factor": None, "error_mean_m": 0.1, "jerk_rms_m_s3": 10.0},
        {**flown, "plan": "min-residual", "factor": 1.0, "error_mean_m": 0.07, "jerk_rms_m_s3": 16.0},
        {**flown, "plan": "min-residual", "factor": 0.1, "failed": "no path"},
    ]
    return {"kind": "front", "world": world, "rows": rows}


def needs(world: int, excitation: str) -> dict[str, Any]:
    """A course flown with a network of each frame, and one that could not be learned."""
    flown = {"course": 0, "flights": 12, "failed": None, "min_snap_m": 0.1, "within_region": True}
    rows = [
        {**flown, "frame": "body", "min_residual_m": 0.065},
        {**flown, "frame": "world", "min_residual_m": 0.09, "within_region": excitation == "aggressive"},
        {
            "course": 0,
            "flights": 4,
            "frame": "world",
            "failed": "learning: too little",
            "within_region": False,
        },
    ]
    return {"kind": "needs", "world": world, "excitation": excitation, "rows": rows}


def pieces(worlds: int, courses: int) -> dict[str, Any]:
    """All pieces of a study, by name."""
    found = {"full-radio-0": full(), "full-wired-0": full(setting="wired"), "select-0": select(0)}
    found |= {f"balanced-{w:02d}-{c}": balanced(w, c) for w in range(worlds) for c in range(courses)}
    found |= {f"front-{w:02d}": front(w) for w in range(worlds)}
    found |= {f"needs-00-{name}": needs(0, name) for name in ("gentle", "aggressive")}
    return {name: {"result": result} for name, result in found.items()}
