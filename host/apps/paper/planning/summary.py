"""Summary of the pieces of the study: figures, tables and lines of text."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from trimtab.host.apps.paper.chance import median_interval
from trimtab.host.apps.paper.planning.compare import CLOSED_FORM, KINDS, NETWORKS, RESIDUAL_KINDS
from trimtab.host.apps.paper.text import text

Row = dict[str, Any]

PAPER_DRAG_N = {"min-snap": 1.845, "min-control-r": 1.483, "min-residual*": 0.817}
"""Mean drag along the plans of the paper's figure 3."""
BASES = ("min-snap", "min-control")
_MEASURES = {
    "residual": "residual_mean_m_s2",
    "error": "error_mean_m",
    "error_max": "error_max_m",
    "jerk_max": "jerk_max_m_s3",
    "length": "path_length_m",
}


def summary(answer: Mapping[str, Any], found: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return the study's outcome: `answer`, `tables` by title, `lines`, and what the pictures show."""
    results = [piece["result"] for piece in found.values()]
    planned = [r for r in results if "kinds" in r]
    courses = [course for r in results if "courses" in r for course in r["courses"]]
    ratios = {
        base: {
            kind: {name: ratio(courses, kind, base, key) for name, key in _MEASURES.items()}
            for kind in KINDS
            if kind != base
        }
        for base in BASES
    }
    figures = {
        "planned": {kind: _planned(planned, kind) for kind in KINDS},
        "flown": {kind: medians(courses, kind) for kind in KINDS},
        "ratios": ratios,
        "closed_form": {kind: _side_by_side(courses, kind) for kind in RESIDUAL_KINDS},
        "failed": failures([*planned, *courses]),
    }
    tables = {
        "Planned under the known drag, N = 400, the paper's weight of control effort": _planned_table(
            figures["planned"]
        ),
        "Flown by the DFBC without feed-forward, held-out courses": _flown_table(figures["flown"]),
        "Flown over min-snap and min-control: medians of ratios, 95 % of bootstraps": _ratio_table(ratios),
        "Closed form in place of the network, the same held-out courses": _residual_table(
            figures["closed_form"]
        ),
        "The paper's claims": _claims(figures),
    }
    return {
        "answer": {**answer, **figures},
        "tables": tables,
        "lines": [line for title, rows in tables.items() for line in ("", title, *text(rows))][1:],
        "courses": courses,
    }


def failures(courses: Sequence[Mapping[str, Any]]) -> list[Row]:
    """Return failed plans and flights: course, kind, reason."""
    return [
        {"course": course["course"], "kind": kind, "why": row.get("failed") or row["flight_failed"]}
        for course in courses
        for kind, row in _all_rows(course)
        if "failed" in row or "flight_failed" in row
    ]


def _all_rows(course: Mapping[str, Any]) -> list[tuple[str, Row]]:
    """Return name and figures of every plan on a course."""
    rows = list(course["kinds"].items())
    for what, kinds in course.get("residuals", {}).items():
        rows += [(f"{kind}, {what}", row) for kind, row in kinds.items()]
    return rows


def _side_by_side(courses: Sequence[Mapping[str, Any]], kind: str) -> Row:
    """Return medians of each residual model on the same courses, and of the closed form over each network."""
    pairs = [{"kinds": {what: kinds[kind] for what, kinds in c["residuals"].items()}} for c in courses]
    return {
        "flown": {what: medians(pairs, what) for what in (CLOSED_FORM, *NETWORKS)},
        "ratios": {
            what: {
                name: ratio(pairs, CLOSED_FORM, what, key)
                for name, key in (("solve", "first_solve_s"), ("plan", "solve_s"), ("error", "error_mean_m"))
            }
            for what in NETWORKS
        },
    }


def _rows(courses: Sequence[Mapping[str, Any]], kind: str, key: str) -> list[float]:
    return [c["kinds"][kind][key] for c in courses if c["kinds"][kind].get(key) is not None]


def _middle(values: Sequence[float], of: Callable[[Any], Any] = np.median) -> float | None:
    return float(of(values)) if len(values) else None


def _planned(courses: Sequence[Mapping[str, Any]], kind: str) -> Row:
    """Return the mean drag and the medians of solve time and iterations over the planned courses."""
    return {
        "courses": len(_rows(courses, kind, "drag_mean_n")),
        "drag_mean_n": _middle(_rows(courses, kind, "drag_mean_n"), np.mean),
        "solve_s": _middle(_rows(courses, kind, "solve_s")),
        "iterations": _middle(_rows(courses, kind, "iterations")),
        "jerk_max_m_s3": _middle(_rows(courses, kind, "jerk_max_m_s3")),
    }


def medians(courses: Sequence[Mapping[str, Any]], kind: str) -> Row:
    """Return medians over the flown courses."""
    keys = ("residual_mean_m_s2", "error_mean_m", "error_max_m", "clipped_share", "path_length_m")
    keys += ("mean_speed_m_s", "jerk_max_m_s3", "first_solve_s", "solve_s", "outside_region")
    found: Row = {key: _middle(_rows(courses, kind, key)) for key in keys}
    return {"flights": len(_rows(courses, kind, "error_mean_m")), **found}


def ratio(courses: Sequence[Mapping[str, Any]], kind: str, base: str, key: str) -> Row:
    """Return the median over courses of the ratio of a kind to a base, with a 95 % bootstrap interval."""
    pairs = [(c["kinds"][kind].get(key), c["kinds"][base].get(key)) for c in courses]
    ratios = np.array([a / b for a, b in pairs if a is not None and b])
    if not len(ratios):
        return {"median": None, "ci95": None, "courses": 0, "better": 0}
    return {
        "median": float(np.median(ratios)),
        "ci95": list(median_interval(ratios.tolist())),
        "courses": len(ratios),
        "better": int((ratios < 1.0).sum()),
    }


def _number(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


def _planned_table(planned: Mapping[str, Row]) -> list[Row]:
    return [
        {
            "kind": kind,
            "courses": str(row["courses"]),
            "mean drag, N": _number(row["drag_mean_n"], ".3f"),
            "paper, N": _number(PAPER_DRAG_N.get(kind), ".3f"),
            "whole plan, s": _number(row["solve_s"], ".2f"),
            "iterations": _number(row["iterations"], ".0f"),
            "greatest jerk, m/s^3": _number(row["jerk_max_m_s3"], ".1f"),
        }
        for kind, row in planned.items()
    ]


def _flown_table(flown: Mapping[str, Row]) -> list[Row]:
    return [
        {
            "kind": kind,
            "flights": str(row["flights"]),
            "planned residual, m/s^2": _number(row["residual_mean_m_s2"], ".3f"),
            "mean error, mm": _number(_thousand(row["error_mean_m"]), ".1f"),
            "greatest error, mm": _number(_thousand(row["error_max_m"]), ".1f"),
            "clipped, %": _number(_hundred(row["clipped_share"]), ".2f"),
            "length, m": _number(row["path_length_m"], ".1f"),
            "speed, m/s": _number(row["mean_speed_m_s"], ".2f"),
            "greatest jerk, m/s^3": _number(row["jerk_max_m_s3"], ".1f"),
            "plan, s": _number(row["solve_s"], ".2f"),
        }
        for kind, row in flown.items()
    ]


def _residual_table(kinds: Mapping[str, Row]) -> list[Row]:
    rows = []
    for kind, found in kinds.items():
        rows += [
            {
                "kind": kind,
                "residual": what,
                "flights": str(row["flights"]),
                "solve, s": _number(row["first_solve_s"], ".3f"),
                "plan, s": _number(row["solve_s"], ".2f"),
                "mean error, mm": _number(_thousand(row["error_mean_m"]), ".1f"),
                "clipped, %": _number(_hundred(row["clipped_share"]), ".2f"),
            }
            for what, row in found["flown"].items()
        ]
        rows += [
            {
                "kind": kind,
                "residual": f"{CLOSED_FORM} over {what}",
                "flights": str(ratios["error"]["courses"]),
                "solve, s": _interval(ratios["solve"]),
                "plan, s": _interval(ratios["plan"]),
                "mean error, mm": _interval(ratios["error"]),
                "clipped, %": "",
            }
            for what, ratios in found["ratios"].items()
        ]
    return rows


def _interval(ratio: Row) -> str:
    """Return the median and its 95 % bootstrap interval as text."""
    ci = ratio["ci95"]
    return "" if ci is None else f"{ratio['median']:.2f} ({ci[0]:.2f}-{ci[1]:.2f})"


def _thousand(value: float | None) -> float | None:
    return None if value is None else 1e3 * value


def _hundred(value: float | None) -> float | None:
    return None if value is None else 1e2 * value


def _ratio_table(ratios: Mapping[str, Mapping[str, Mapping[str, Row]]]) -> list[Row]:
    rows = []
    for base, kinds in ratios.items():
        for kind, measures in kinds.items():
            row = {"over": base, "kind": kind}
            for name, found in measures.items():
                row[name.replace("_", ", ")] = _interval(found)
            rows.append(row)
    return rows


def _claims(figures: Mapping[str, Any]) -> list[Row]:
    """Return the claims of section V-B and the flights of VI-D, confirmed or not."""
    drag = {kind: row["drag_mean_n"] for kind, row in figures["planned"].items()}
    error = figures["ratios"]["min-snap"]
    star, plain = error["min-residual*"]["error"]["median"], error["min-residual"]["error"]["median"]
    jerk = error["min-residual"]["jerk_max"]["median"]
    return [
        _claim(
            "drag of min-residual* over min-snap, planned: 0.44",
            _over(drag["min-residual*"], drag["min-snap"]),
            lambda x: x <= 0.44,
        ),
        _claim(
            "drag of min-control-r over min-snap, planned: 0.80",
            _over(drag["min-control-r"], drag["min-snap"]),
            lambda x: x <= 0.80,
        ),
        _claim("min-residual is tracked better than min-snap: 0.87 in flight", plain, lambda x: x < 1.0),
        _claim("min-residual* is tracked better than min-residual", _over(star, plain), lambda x: x < 1.0),
        _claim("the greatest jerk of min-residual is larger: 2.06", jerk, lambda x: x > 1.0),
    ]


def _over(a: float | None, b: float | None) -> float | None:
    return None if a is None or not b else a / b


def _claim(what: str, ratio: float | None, holds: Callable[[float], bool]) -> Row:
    said = "not measured" if ratio is None else "confirmed" if holds(ratio) else "not confirmed"
    return {"claim (the paper's ratio)": what, "ours": _number(ratio, ".2f"), "": said}
