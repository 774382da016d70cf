"""Figures of the study of labels from the results of its worlds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trimtab.host.apps.paper.controllers.statistics import FAILED_M, effect, error_m, holm, interval
from trimtab.host.apps.paper.controllers.table import REGRESSORS
from trimtab.host.apps.paper.controllers.tables import interval as interval_text
from trimtab.host.apps.paper.controllers.tables import number
from trimtab.host.apps.paper.text import text

NOMINAL, NEURAL, SMOOTHED, TRUTH = "mpc", "mpc-neural", "mpc-neural-c", "mpc-neural-c-truth"
TITLES = {
    NOMINAL: "Nomi",
    NEURAL: "Neural",
    SMOOTHED: "Neural-C, smoothed labels",
    TRUTH: "Neural-C, true labels",
}
RATIOS = {
    "truth/smoothed": (TRUTH, SMOOTHED),
    "truth/neural": (TRUTH, NEURAL),
    "smoothed/neural": (SMOOTHED, NEURAL),
}
"""Controllers whose flown errors are compared, by the name of the ratio."""

Row = dict[str, Any]
Cells = dict[str, str]
Result = Mapping[str, Any]


def summary(answer: Mapping[str, Any], results: Sequence[Result]) -> dict[str, Any]:
    """Return the study's outcome: `answer`, `tables` by title, and `lines`."""
    figures = {
        "flights": sum(row["failed"] is None for result in results for row in result["rows"]),
        "ratios": ratios(results),
        "rows": rows_of(results),
        "labels": [{"world": result["world"], **result["labels"]} for result in results],
        "selected": sorted({result["selected"] for result in results}),
        "failed_as_m": FAILED_M,
        "failed": failures(results),
    }
    made = tables(figures)
    return {
        "answer": {**answer, **figures},
        "tables": made,
        "lines": [line for title, cells in made.items() for line in ("", title, *text(cells))][1:],
    }


def ratios(results: Sequence[Result]) -> list[Row]:
    """Return the ratios of flown errors by regressor, over pairs of the same plan and flight index.

    The unit is the course; its value is the median over its trajectories. by_world: medians over the courses
    of each world.
    """
    rows = []
    for regressor in REGRESSORS:
        for name, (one, other) in RATIOS.items():
            by_course: dict[tuple[int, int], list[float]] = {}
            failed = 0
            for result in results:
                flown = {
                    (row["controller"], row["course"], row["trajectory"]): row
                    for row in result["rows"]
                    if row["regressor"] == regressor
                }
                for (controller, course, trajectory), row in flown.items():
                    if controller == one:
                        beside = flown[other, course, trajectory]
                        ratio = error_m(row) / error_m(beside)
                        by_course.setdefault((result["world"], course), []).append(ratio)
                        failed += row["failed"] is not None or beside["failed"] is not None
            rows.append(
                {
                    "regressor": regressor,
                    "ratio": name,
                    "pairs": sum(map(len, by_course.values())),
                    "failed": failed,
                    **effect(by_course).to_json(),
                    "by_world": [
                        effect({place: by_course[place] for place in by_course if place[0] == world}).median
                        for world in dict.fromkeys(world for world, _ in by_course)
                    ],
                }
            )
    corrected = holm([row["p"] for row in rows])
    return [row | {"p_holm": p} for row, p in zip(rows, corrected, strict=True)]


def rows_of(results: Sequence[Result]) -> list[Row]:
    """Return the median error by controller, regressor and trajectory."""
    flown = [row for result in results for row in result["rows"]]
    rows = []
    for regressor in REGRESSORS:
        for controller in TITLES:
            for trajectory in dict.fromkeys(row["trajectory"] for row in flown):
                key = controller, regressor, trajectory
                chosen = [r for r in flown if (r["controller"], r["regressor"], r["trajectory"]) == key]
                errors = [error_m(row) for row in chosen]
                ci = interval(errors)
                rows.append(
                    {
                        "controller": controller,
                        "regressor": regressor,
                        "trajectory": trajectory,
                        "courses": len(chosen),
                        "failed": sum(row["failed"] is not None for row in chosen),
                        "error_mean_m": float(np.median(errors)),
                        "ci95_m": None if ci is None else list(ci),
                    }
                )
    return rows


def failures(results: Sequence[Result]) -> list[Row]:
    """Return what was not planned, or not flown to its end: world, what, why."""
    names = ("controller", "regressor", "trajectory", "course")
    return [
        {"world": result["world"], "what": ", ".join(str(row[name]) for name in names), "why": row["failed"]}
        for result in results
        for row in result["rows"]
        if row["failed"] is not None
    ]


def tables(figures: Mapping[str, Any]) -> dict[str, list[Cells]]:
    """Return the tables by title."""
    return {
        "Ratios of flown errors on the same plans": [
            {
                "regressor": row["regressor"],
                "ratio": _ratio_title(row["ratio"]),
                "median": interval_text(row["median"], row["ci95"]),
                "p, Holm": number(row["p_holm"], ".3g"),
                "pairs": str(row["pairs"]),
                "courses": str(row["courses"]),
                "courses below 1": str(row["better"]),
                "worlds": " ".join(f"{value:.2f}" for value in row["by_world"]),
                "failed": str(row["failed"]),
            }
            for row in figures["ratios"]
        ],
        "Median error, mm": [
            {
                "regressor": row["regressor"],
                "controller": TITLES[row["controller"]],
                "trajectory": row["trajectory"],
                "error": _millimetres(row),
                "courses": str(row["courses"]),
                "failed": str(row["failed"]),
            }
            for row in figures["rows"]
        ],
        "Labels of the training flights, RMS of a component, m/s^2": [
            {
                "world": str(row["world"]),
                "samples": str(row["samples"]),
                "smoothed less true": f"{row['label_rms_m_s2']:.3f}",
                "true residual": f"{row['residual_rms_m_s2']:.3f}",
                **{
                    f"between networks, {regressor}": f"{row['networks_rms_m_s2'][regressor]:.3f}"
                    for regressor in REGRESSORS
                },
            }
            for row in figures["labels"]
        ],
        "Failed plans and flights": [{**row, "world": str(row["world"])} for row in figures["failed"]]
        or [{"world": "none", "what": "", "why": ""}],
    }


def _ratio_title(name: str) -> str:
    return " over ".join(TITLES[controller] for controller in RATIOS[name])


def _millimetres(row: Mapping[str, Any]) -> str:
    """Return the median error with its interval, as text."""
    ci = "" if row["ci95_m"] is None else f" ({1e3 * row['ci95_m'][0]:.1f}-{1e3 * row['ci95_m'][1]:.1f})"
    return f"{1e3 * row['error_mean_m']:.1f}{ci}"
