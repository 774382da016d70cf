"""Tables of the study, as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from trimtab.host.apps.paper.controllers.claims import WORDS
from trimtab.host.apps.paper.controllers.table import BASELINE, CONTROLLERS, FAMILIES, SETS, TRAJECTORIES

Cells = dict[str, str]
_BY_NAME = {each.name: each for each in CONTROLLERS}


def tables(figures: Mapping[str, Any]) -> dict[str, list[Cells]]:
    """Return the tables by title. Those without a row are left out."""
    made = {
        "The paper's claims; effects are ratios of errors": _claims(figures["claims"]),
        "Selected on tuning courses, over the baseline on Min-Snap on held-out courses": _chosen(figures),
        "The baseline on all held-out courses": _baseline(figures["baseline"]),
    }
    for flown in SETS:
        title = f"{flown.title}: median error, mm"
        rows = [row for row in figures["rows"] if row["regressor"] == flown.regressor]
        made[title] = _errors(rows, [each.name for each in flown.controllers])
    courses = dict.fromkeys((row["setting"], row["course"]) for row in figures["full"])
    for setting, course in courses:
        rows = [row for row in figures["full"] if (row["setting"], row["course"]) == (setting, course)]
        made[f"Course {course} like the paper's, {setting}: mean error, mm"] = _full(rows)
    made |= {
        "Processor time of a control step, ms": _steps(figures["steps"]),
        "Closed form over network inside the MPC": _closed_form(figures["closed_form_in_mpc"]),
        "What a network needs: error of Min-Residual over Min-Snap": _needs(figures["needs"]),
        "Weights of thrusts and their rates: flown error and jerk": _front(figures["front"]),
        "Failed plans and flights": [
            {"piece": row["piece"], "what": row["what"], "why": row["why"]} for row in figures["failed"]
        ]
        or [{"piece": "none", "what": "", "why": ""}],
    }
    return {title: rows for title, rows in made.items() if rows}


def _claims(claims: Sequence[Mapping[str, Any]]) -> list[Cells]:
    return [
        {
            "claim": WORDS[row["claim"]],
            "controllers": FAMILIES[row["family"]],
            "regressor": row["regressor"],
            "effect": interval(row["effect"], row["ci95"]),
            "p, Holm": number(row["p_holm"], ".3g"),
            "courses": str(row["courses"]),
            "": _verdict(row),
        }
        for row in claims
    ]


def _verdict(row: Mapping[str, Any]) -> str:
    if row["ci95"] is None:
        return "too few courses"
    return "confirmed" if row["confirmed"] else "not confirmed"


def _chosen(figures: Mapping[str, Any]) -> list[Cells]:
    rows = []
    for what, key in (("baseline on a residual trajectory", "error_ratio_baseline"), ("best", "best")):
        found = figures[key]
        if found is not None:
            controller = _BY_NAME[found.get("controller", BASELINE.name)]
            rows.append(
                {
                    "": what,
                    "controller": controller.title,
                    "family": FAMILIES[controller.family],
                    "trajectory": found["trajectory"],
                    "regressor": found["regressor"],
                    "error ratio": interval(found["median"], found["ci95"]),
                    "courses": str(found["courses"]),
                }
            )
    return rows


def _baseline(rows: Sequence[Mapping[str, Any]]) -> list[Cells]:
    return [
        {
            "regressor": row["regressor"],
            "trajectory": row["trajectory"],
            "median error, mm": number(1e3 * row["error_mean_m"], ".0f"),
            "over min-snap": interval(row["over_min_snap"]["median"], row["over_min_snap"]["ci95"]),
            "courses": str(row["over_min_snap"]["courses"]),
            "jerk, RMS, m/s^3": number(row["jerk_rms_m_s3"], ".1f"),
        }
        for row in rows
        if row["error_mean_m"] is not None
    ]


def _errors(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> list[Cells]:
    made = []
    for name in names:
        chosen = {row["trajectory"]: row for row in rows if row["controller"] == name}
        if all(row["cells"] for row in chosen.values()):
            made.append(
                {
                    "controller": _BY_NAME[name].title,
                    **{kind: _millimetres(chosen[kind]) for kind in TRAJECTORIES},
                    "cells": str(chosen[TRAJECTORIES[0]]["cells"]),
                }
            )
    return made


def _millimetres(row: Mapping[str, Any]) -> str:
    """Return the median error with its interval, and how many flights failed, as text."""
    ci = "" if row["ci95_m"] is None else f" ({1e3 * row['ci95_m'][0]:.0f}-{1e3 * row['ci95_m'][1]:.0f})"
    lost = f", {row['failed']} failed" if row["failed"] else ""
    return f"{1e3 * row['error_mean_m']:.0f}{ci}{lost}"


def _full(rows: Sequence[Mapping[str, Any]]) -> list[Cells]:
    made = []
    for flown in SETS:
        for controller in flown.controllers:
            errors = {
                row["trajectory"]: row["error_mean_m"]
                for row in rows
                if (row["controller"], row["regressor"]) == (controller.name, flown.regressor)
            }
            made.append(
                {
                    "family": FAMILIES[flown.family],
                    "regressor": flown.regressor,
                    "controller": controller.title,
                    **{
                        kind: "failed" if errors[kind] is None else f"{1e3 * errors[kind]:.1f}"
                        for kind in TRAJECTORIES
                    },
                }
            )
    return made


def _steps(steps: Sequence[Mapping[str, Any]]) -> list[Cells]:
    return [
        {
            "MPC": _BY_NAME[row["controller"]].title,
            "regressor": row["regressor"],
            "flights": str(row["flights"]),
            "median": number(row["p50_ms"], ".2f"),
            "99th percentile": number(row["p99_ms"], ".2f"),
        }
        for row in steps
    ]


def _closed_form(found: Mapping[str, Mapping[str, Any]]) -> list[Cells]:
    return [
        {"": what, "ratio": interval(found[key]["median"], found[key]["ci95"])}
        for what, key in (("mean error", "error"), ("time of a step", "step"))
        if found[key]["courses"]
    ]


def _needs(rows: Sequence[Mapping[str, Any]]) -> list[Cells]:
    return [
        {
            "frame": row["frame"],
            "excitation": row["excitation"],
            "training flights": str(row["training_flights"]),
            "ratio": interval(row["median"], row["ci95"]),
            "courses": str(row["courses"]),
            "plans within the region": str(row["within_region"]),
            "failed": str(row["failed"]),
            "0.7 reached": "yes" if row["reached"] else "no",
        }
        for row in rows
    ]


def _front(rows: Sequence[Mapping[str, Any]]) -> list[Cells]:
    return [
        {
            "plan": row["plan"] if row["factor"] is None else f"{row['plan']} x {row['factor']:g}",
            "mean error, mm": number(1e3 * row["error_mean_m"], ".1f"),
            "over min-snap": interval(row["over_min_snap"]["median"], row["over_min_snap"]["ci95"]),
            "jerk, RMS, m/s^3": number(row["jerk_rms_m_s3"], ".1f"),
            "failed": str(row["failed"]),
        }
        for row in rows
    ]


def number(value: float | None, form: str) -> str:
    """Return a number as text, empty for None."""
    return "" if value is None else format(value, form)


def interval(value: float | None, ci95: Sequence[float] | None) -> str:
    """Return a median and its interval as text, each if there is one."""
    return number(value, ".2f") + ("" if ci95 is None else f" ({ci95[0]:.2f}-{ci95[1]:.2f})")
