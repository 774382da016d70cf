"""Summary of the tuning: the settings kept, and every point tried."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from trimtab.host.apps.paper.text import text
from trimtab.host.apps.paper.tuning.points import log_error
from trimtab.host.apps.paper.tuning.table import COURSES, PACES, WORLD, WORLD_SEEDS, Parameter, Search
from trimtab.host.vehicle import Vehicle

Row = dict[str, str]


def summary(
    answer: Mapping[str, Any],
    searches: Sequence[Search],
    tuned: Mapping[str, Mapping[str, Any]],
    found: Mapping[str, Mapping[str, Any]],
    vehicle: Vehicle,
) -> dict[str, Any]:
    """Return the study's outcome: `answer`, `tables` by title, and `lines` of text."""
    points = [_point(piece["result"]) for piece in found.values()]
    figures = {
        "vehicle": vehicle.name,
        "world": WORLD,
        "world_seeds": list(WORLD_SEEDS),
        "courses": list(COURSES),
        "paces": list(PACES),
        "searches": {search.name: _searched(search, tuned[search.name]) for search in searches},
        "points": points,
    }
    tables = {
        "Settings": [row for each in figures["searches"].values() for row in _settings_rows(each)],
        "Points": [_point_row(point) for point in points],
    }
    return {
        "answer": {**answer, **figures},
        "tables": tables,
        "lines": [line for title, rows in tables.items() for line in ("", title, *text(rows))][1:],
    }


def markdown(tables: Mapping[str, Sequence[Row]]) -> str:
    """Return tables as Markdown."""
    lines = []
    for title, rows in tables.items():
        heads = list(rows[0])
        lines += [f"## {title}", "", _line(heads), _line(["---"] * len(heads))]
        lines += [*(_line(row.values()) for row in rows), ""]
    return "\n".join(lines)


def _line(cells: Any) -> str:
    return "| " + " | ".join(cells) + " |"


def _point(result: Mapping[str, Any]) -> dict[str, Any]:
    """Return a point with its geometric mean error, m; None if a flight failed."""
    score = log_error(result["errors_m"])
    return {**result, "error_m": None if score is None else math.exp(score)}


def _searched(search: Search, tuned: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "spread": tuned["spread"],
        "parameters": {
            each.name: {**tuned["parameters"][each.name], **_place(each, tuned["parameters"])}
            for each in search.parameters
        },
    }


def _place(parameter: Parameter, tuned: Mapping[str, Any]) -> dict[str, Any]:
    """Return where a parameter stands in which files, and its value."""
    key = f"{parameter.table}.{parameter.key}" if parameter.table else parameter.key
    value = parameter.value(tuned[parameter.name]["factor"])
    return {"files": list(parameter.files), "key": key, "value": list(value)}


def _settings_rows(searched: Mapping[str, Any]) -> list[Row]:
    return [
        {
            "files": ", ".join(row["files"]),
            "key": row["key"],
            "value": ", ".join(f"{value:g}" for value in row["value"]),
            "factor": f"{row['factor']:g}",
            "best factor": f"{row['best']:g}",
            "its gain, %": f"{100.0 * row['gain']:.1f}",
            "spread of flights, %": f"{100.0 * searched['spread']:.1f}",
        }
        for row in searched["parameters"].values()
    ]


def _point_row(point: Mapping[str, Any]) -> Row:
    error_m = point["error_m"]
    return {
        "controller": point["controller"],
        "factors": ", ".join(f"{name} {factor:g}" for name, factor in point["factors"].items()),
        "repetition": str(point["repetition"]),
        "mean error, mm": "failed" if error_m is None else f"{1e3 * error_m:.2f}",
        "by flight, mm": ", ".join("-" if e is None else f"{1e3 * e:.1f}" for e in point["errors_m"]),
    }
