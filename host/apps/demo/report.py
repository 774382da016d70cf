"""Sections of the report that only the demo has: the flown comparison, and deteriorations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from trimtab.host.apps.demo.compare import AXES, Comparison, Tracked, what_got_worse
from trimtab.host.apps.demo.files import TRUTH_PAGE
from trimtab.host.show.content import Content
from trimtab.host.trace.result import Trace
from trimtab.host.vehicle import Vehicle

Section = dict[str, Any]


def sections(
    comparison: Comparison, result: Trace, vehicle: Vehicle, names: Mapping[str, str]
) -> dict[str, Any]:
    """Return what `trimtab.host.report.trace.page` takes as `extra`. names: of held-out flights, by id."""
    return {
        "sections": [_flown(comparison, vehicle), _worse(comparison, result, names)],
        "beside": [(TRUTH_PAGE, "What the simulated world held, beside this verdict")],
        "data": comparison.to_json(),
    }


def _flown(comparison: Comparison, vehicle: Vehicle) -> Section:
    flown = comparison.flown
    head = [f"route {flown[0].planned.route.name}", *(flight.label for flight in flown)]
    return {
        "title": "Flown before and after",
        "text": _text(comparison),
        "table": [head, *_rows(flown, vehicle, comparison.latency_s)],
        "figures": [],
    }


def _text(comparison: Comparison) -> list[str]:
    count = len(comparison.first)
    how = (
        f"The fastest of the first routes, flown {count} times with the nominal plan; these flights differ "
        f"by {1e3 * comparison.spread_m:.1f} mm RMSE, so a smaller difference is not significant. "
    )
    if comparison.new_plan is not None:
        again = (
            "Then the same control law with the same gains flew a new plan for the same waypoints, headings, "
            "total time, limits and headroom. The first plan minimises effort alone. The new plan minimises "
            "the residual that the traced model predicts, plus some effort. Of several weights of effort, it "
            "is the plan with the smallest predicted tracking error. "
        )
    else:
        again = f"No new plan was flown: {_sentence(comparison.no_new_plan)} "
    if comparison.applied is not None:
        applied = (
            f"The last flight ({comparison.applied.label}) compensates the traced effects on board as far "
            "as possible."
        )
    else:
        applied = f"No flight with the effects compensated on board: {_sentence(comparison.no_applied)}"
    lines = [how + again + applied]
    if comparison.latency_s:
        lines.append(
            f"Poses are {1e3 * comparison.latency_s:.1f} ms older than their stamps. All flights are "
            "measured with this correction, except in the last row of the table."
        )
    return lines


def _sentence(reason: str | None) -> str:
    """Return a reason with a full stop."""
    return f"{(reason or '').rstrip('.')}."


def _rows(flown: tuple[Tracked, ...], vehicle: Vehicle, latency_s: float) -> list[list[str]]:
    plans = [flight.planned.plan for flight in flown]
    limits = vehicle.limits
    speeds = [limits.speed_max_m_s - plan.margins["speed_m_s"] for plan in plans]
    tilts = [limits.tilt_max_deg - plan.margins["tilt_deg"] for plan in plans]
    tops = [limits.thrust_headroom[1] - plan.margins["thrust_high"] for plan in plans]
    rows = [
        ["tracking error RMSE, mm", *(_mm(f.rmse_m) for f in flown)],
        ["predicted before the flight, mm", *(_mm(f.predicted_rmse_m) for f in flown)],
        *([f"{axis}, mm", *(_mm(f.axes_m[i]) for f in flown)] for i, axis in enumerate(AXES)),
        ["greatest, mm", *(_mm(f.max_m) for f in flown)],
        ["time at the motors' limits, %", *(f"{100 * f.clipped_share:.2f}" for f in flown)],
        ["battery at start of tracking, V", *(_volts(f.battery_v) for f in flown)],
        ["planned path, m", *(f"{plan.path_length_m:.2f}" for plan in plans)],
        ["planned time, s", *(f"{plan.duration_s:.2f}" for plan in plans)],
        ["planned mean speed, m/s", *(f"{plan.mean_speed_m_s:.2f}" for plan in plans)],
        ["planned top speed, m/s", *(f"{speed:.2f}" for speed in speeds)],
        ["planned greatest tilt, °", *(f"{tilt:.1f}" for tilt in tilts)],
        ["planned greatest rotor thrust, % of maximum", *(f"{100 * top:.0f}" for top in tops)],
    ]
    if latency_s:
        rows.append(["error RMSE with poses as stamped, mm", *(_mm(f.stamped_rmse_m) for f in flown)])
    return rows


def compared(shown: Content, comparison: Comparison) -> Content:
    """Return the flights with those of the comparison first, under their labels.

    The first of the first flights and the later ones are shown.
    """
    labels = {flight.log: flight.label for flight in comparison.flown}
    repeats = {flight.log for flight in comparison.first[1:]}
    route = comparison.first[0].planned.route.name
    first, others = [], []
    for row, track in zip(shown.flights, shown.tracks, strict=True):
        log = Path(row["log"]).name
        if log in labels:
            name = f"{labels[log]} ({track.name})"
            named = replace(track, name=name, group=f"route {route}", shown=log not in repeats)
            first.append((row, named))
        else:
            others.append((row, replace(track, shown=False)))
    rows, tracks = zip(*first, *others, strict=True)
    return replace(shown, flights=list(rows), tracks=list(tracks))


def _worse(comparison: Comparison, result: Trace, names: Mapping[str, str]) -> Section:
    found = what_got_worse(comparison, result, names)
    none = "No measured error got worse, on any axis, flown or predicted."
    return {"title": "Deteriorations", "text": found or [none], "table": None, "figures": []}


def _mm(value_m: float | None) -> str:
    return "" if value_m is None else f"{1e3 * value_m:.1f}"


def _volts(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.2f}"


def summary(answer: Mapping[str, Any]) -> list[str]:
    """Return the flown comparison as lines of text, from the demo's JSON."""
    first, comparison = answer["tracking_rmse_first_m"], answer["comparison"]
    lines = [f"tracking error on route {comparison['route']}: {1e3 * first:.1f} mm with the first plan"]
    again, applied = answer["tracking_rmse_new_plan_m"], answer["tracking_rmse_applied_m"]
    if again is None:
        lines.append(f"  no new plan: {comparison['no_new_plan']}")
    else:
        lines.append(f"  new plan, same law: {1e3 * again:.1f} mm ({again / first:.2f} of it)")
    if applied is None:
        lines.append(f"  effects not applied: {comparison['no_applied']}")
    else:
        what = comparison["flights"][-1]["what"]
        lines.append(f"  {what}: {1e3 * applied:.1f} mm ({applied / first:.2f} of it)")
    return lines
