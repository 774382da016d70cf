"""Figures of the study from the results of its pieces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trimtab.host.apps.paper.controllers.claims import Cell, cells_of, claims, on_all, over_courses
from trimtab.host.apps.paper.controllers.needs import TARGET
from trimtab.host.apps.paper.controllers.pieces import RADIO
from trimtab.host.apps.paper.controllers.statistics import FAILED_M, Effect, effect, error_m, holm, interval
from trimtab.host.apps.paper.controllers.table import (
    BASELINE,
    BASELINE_TRAJECTORIES,
    CONTROLLERS,
    MIN_SNAP,
    REGRESSORS,
    SETS,
    TRAJECTORIES,
)
from trimtab.host.apps.paper.controllers.tables import tables
from trimtab.host.apps.paper.text import text

Row = dict[str, Any]
Result = Mapping[str, Any]
_FAMILY = {each.name: each.family for each in CONTROLLERS}


def summary(answer: Mapping[str, Any], found: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return the study's outcome: `answer`, `tables` by title, `lines`, and what the pictures show."""
    results = {name: piece["result"] for name, piece in found.items()}
    by_kind = {
        kind: [result for result in results.values() if result["kind"] == kind]
        for kind in ("full", "select", "balanced", "front", "needs")
    }
    cells = cells_of(by_kind["balanced"])
    tuning = [row for result in by_kind["full"] if result["setting"] == RADIO for row in result["rows"]]
    selecting = [row for result in by_kind["select"] for row in result["rows"]]
    steps = step_times(by_kind["balanced"])
    figures: Row = {
        "flights": sum(
            "error_mean_m" in row and not row["anchor"]
            for result in by_kind["balanced"]
            for row in result["rows"]
        ),
        "rows": rows_of(cells, by_kind["balanced"]),
        "claims": claims(cells),
        "error_ratio_baseline": of_baseline(selecting, cells),
        "baseline": baseline_rows(cells, by_kind["balanced"]),
        "best": best_pair(tuning, cells),
        "steps": steps,
        "mpc_step_ms_p99": max((row["p99_ms"] for row in steps), default=None),
        "closed_form_in_mpc": closed_form_in_mpc(cells),
        "full": [row for result in by_kind["full"] for row in full_rows(result)],
        "needs": needs_rows(by_kind["needs"]),
        "front": front_rows(by_kind["front"]),
        "selected": sorted({f"{result['selected']}" for result in by_kind["balanced"]}),
        "failed_as_m": FAILED_M,
        "failed": failures(results),
    }
    made = tables(figures)
    return {
        "answer": {**answer, **figures},
        "tables": made,
        "lines": [line for title, rows in made.items() for line in ("", title, *text(rows))][1:],
        "cells": cells,
    }


def rows_of(cells: Sequence[Cell], results: Sequence[Result]) -> list[Row]:
    """Return errors and ratios to the baseline on min-snap, by controller, regressor and trajectory."""
    lost = [row for result in results for row in result["rows"] if not row["anchor"] and row["failed"]]
    rows: list[Row] = []
    for flown in SETS:
        chosen_cells = [cell for cell in cells if cell.flown == flown]
        for controller in flown.controllers:
            for trajectory in TRAJECTORIES:
                key = controller.name, trajectory
                errors = [cell.errors_m[key] for cell in chosen_cells]
                ci = interval(errors)
                over = over_courses(
                    chosen_cells, lambda cell, key=key: [cell.errors_m[key] / cell.baseline_m]
                )
                rows.append(
                    {
                        "controller": controller.name,
                        "regressor": flown.regressor,
                        "trajectory": trajectory,
                        "cells": len(errors),
                        "failed": sum(
                            (row["controller"], row["trajectory"], row["regressor"])
                            == (*key, flown.regressor)
                            for row in lost
                        ),
                        "error_mean_m": float(np.median(errors)) if errors else None,
                        "ci95_m": None if ci is None else list(ci),
                        "over_baseline": over.to_json(),
                    }
                )
    corrected = holm([row["over_baseline"]["p"] for row in rows])
    for row, p in zip(rows, corrected, strict=True):
        row["over_baseline"]["p_holm"] = p
    return rows


def of_baseline(selecting: Sequence[Row], cells: Sequence[Cell]) -> Row | None:
    """Return the baseline's residual trajectory that the tuning flights select, measured on held-out courses.

    Selected is the least mean logarithm of the error.
    """
    ranked = _ranked([row for row in selecting if row["trajectory"] != MIN_SNAP])
    if not ranked:
        return None
    regressor, _, kind = ranked[0]
    return {"regressor": regressor, "trajectory": kind, **_over_min_snap(cells, regressor, kind).to_json()}


def _over_min_snap(cells: Sequence[Cell], regressor: str, kind: str) -> Effect:
    """Return the effect of a trajectory over min-snap for the baseline, planned with a regressor."""
    return over_courses(
        [cell for cell in cells if cell.flown.regressor == regressor],
        lambda cell: [cell.baseline(kind) / cell.baseline_m],
    )


def baseline_rows(cells: Sequence[Cell], results: Sequence[Result]) -> list[Row]:
    """Return error and jerk of each of the baseline's trajectories, planned with each regressor."""
    flown = [row for result in results for row in result["rows"] if row["controller"] == BASELINE.name]
    rows = []
    for regressor in REGRESSORS:
        for kind in BASELINE_TRAJECTORIES:
            errors = [cell.baseline(kind) for cell in cells if cell.flown.regressor == regressor]
            jerks = [
                row["jerk_rms_m_s3"]
                for row in flown
                if (row["regressor"], row["trajectory"]) == (regressor, kind) and "jerk_rms_m_s3" in row
            ]
            rows.append(
                {
                    "regressor": regressor,
                    "trajectory": kind,
                    "error_mean_m": float(np.median(errors)) if errors else None,
                    "jerk_rms_m_s3": float(np.median(jerks)) if jerks else None,
                    "over_min_snap": _over_min_snap(cells, regressor, kind).to_json(),
                }
            )
    return rows


def best_pair(tuning: Sequence[Row], cells: Sequence[Cell]) -> Row | None:
    """Return the pair that the courses like the paper's select, measured on held-out courses.

    Selected is the least mean logarithm of the error.
    """
    ranked = _ranked([row for row in tuning if not row["anchor"]])
    return _best(ranked[0], cells) if ranked else None


def _ranked(rows: Sequence[Row]) -> list[tuple[str, str, str]]:
    """Return regressor, controller and trajectory of the rows, by the mean logarithm of their errors."""
    scores: dict[tuple[str, str, str], list[float]] = {}
    for row in rows:
        key = row["regressor"], row["controller"], row["trajectory"]
        scores.setdefault(key, []).append(float(np.log(error_m(row))))
    return sorted(scores, key=lambda key: float(np.mean(scores[key])))


def _best(key: tuple[str, str, str], cells: Sequence[Cell]) -> Row:
    """Return the held-out error ratio of a controller and trajectory over the baseline on min-snap."""
    regressor, name, trajectory = key
    found = over_courses(
        [c for c in cells if (c.flown.family, c.flown.regressor) == (_FAMILY[name], regressor)],
        lambda cell: [cell.errors_m[name, trajectory] / cell.baseline_m],
    )
    return {"regressor": regressor, "controller": name, "trajectory": trajectory, **found.to_json()}


def step_times(results: Sequence[Result]) -> list[Row]:
    """Return the processor time of a control step, ms, by controller and regressor: medians over flights."""
    by_key: dict[tuple[str, str], list[Row]] = {}
    for result in results:
        for row in result["rows"]:
            if "step_ms_p99" in row:
                by_key.setdefault((row["controller"], row["regressor"]), []).append(row)
    return [
        {
            "controller": controller,
            "regressor": regressor,
            "flights": len(rows),
            "p50_ms": float(np.median([row["step_ms_p50"] for row in rows])),
            "p99_ms": float(np.median([row["step_ms_p99"] for row in rows])),
        }
        for (controller, regressor), rows in sorted(by_key.items())
    ]


def closed_form_in_mpc(cells: Sequence[Cell]) -> Row:
    """Return the closed form over the learned network inside the MPC: flown error, and time of a step."""
    ours = [c for c in cells if (c.flown.family, c.flown.regressor) == ("mpc", "ours")]

    def times(cell: Cell) -> list[float]:
        pairs = [(("mpc-traced", t), ("mpc-neural", t)) for t in TRAJECTORIES]
        return [
            cell.steps_ms[a] / cell.steps_ms[b] for a, b in pairs if a in cell.steps_ms and b in cell.steps_ms
        ]

    return {
        "error": on_all(ours, "mpc-traced", "mpc-neural").to_json(),
        "step": over_courses(ours, times).to_json(),
    }


def full_rows(result: Result) -> list[Row]:
    """Return the error of each flight of a course like the paper's."""
    return [
        {
            "course": result["course"],
            "setting": result["setting"],
            "controller": row["controller"],
            "regressor": row["regressor"],
            "trajectory": row["trajectory"],
            "error_mean_m": row.get("error_mean_m"),
            "error_max_m": row.get("error_max_m"),
        }
        for row in result["rows"]
    ]


def needs_rows(results: Sequence[Result]) -> list[Row]:
    """Return the error ratio of min-residual over min-snap for each way to learn a network."""
    by_setting: dict[tuple[str, str, int], dict[tuple[int, int], Row]] = {}
    for result in results:
        for row in result["rows"]:
            key = row["frame"], result["excitation"], row["flights"]
            by_setting.setdefault(key, {})[result["world"], row["course"]] = row
    rows = []
    for key, flown in sorted(by_setting.items()):
        found = effect(
            {
                place: [FAILED_M if row["failed"] is not None else row["min_residual_m"] / row["min_snap_m"]]
                for place, row in flown.items()
            }
        )
        rows.append(
            {
                "frame": key[0],
                "excitation": key[1],
                "training_flights": key[2],
                "failed": sum(row["failed"] is not None for row in flown.values()),
                "within_region": sum(row["within_region"] for row in flown.values()),
                **found.to_json(),
                "reached": found.median is not None and found.median <= TARGET,
            }
        )
    return rows


def front_rows(results: Sequence[Result]) -> list[Row]:
    """Return flown error over min-snap and jerk, by kind of plan and factor on the weights."""
    by_point: dict[tuple[str, float | None], list[tuple[tuple[int, int], Row, Row]]] = {}
    for result in results:
        for row in result["rows"]:
            snap = next(
                other
                for other in result["rows"]
                if (other["course"], other["plan"]) == (row["course"], MIN_SNAP)
            )
            place = result["world"], row["course"]
            by_point.setdefault((row["plan"], row["factor"]), []).append((place, row, snap))
    rows = []
    for (kind, factor), points in by_point.items():
        jerks = [row["jerk_rms_m_s3"] for _, row, _ in points if "jerk_rms_m_s3" in row]
        over = effect({place: [error_m(row) / error_m(snap)] for place, row, snap in points})
        rows.append(
            {
                "plan": kind,
                "factor": factor,
                "error_mean_m": float(np.median([error_m(row) for _, row, _ in points])),
                "jerk_rms_m_s3": float(np.median(jerks)) if jerks else None,
                "over_min_snap": over.to_json(),
                "failed": sum(row["failed"] is not None for _, row, _ in points),
            }
        )
    return rows


def failures(results: Mapping[str, Result]) -> list[Row]:
    """Return what was not planned, not flown to its end, or not learned: piece, what, why."""
    names = ("controller", "regressor", "trajectory", "speed", "plan", "factor", "frame", "flights", "course")
    return [
        {
            "piece": piece,
            "what": ", ".join(str(row[name]) for name in names if row.get(name) is not None),
            "why": row["failed"],
        }
        for piece, result in results.items()
        for row in result["rows"]
        if row["failed"] is not None
    ]
