"""Reports of a plan, from its finished reference, and of a comparison of plans."""

from __future__ import annotations

import json
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trimtab.host.plan.box import GATES, KEEP_OUT, YAW_RATE
from trimtab.host.plan.judge import Passing, inside_gates, passings
from trimtab.host.plan.pareto import Point, tabulate
from trimtab.host.plan.profile import Profile, profile, with_nodes
from trimtab.host.plan.residual import ResidualModel
from trimtab.host.plan.result import Plan
from trimtab.host.plan.sensitivity import Sensitivity, sensitivity
from trimtab.host.plan.table import from_reference
from trimtab.host.report import plan_figures, trade_figures
from trimtab.host.report.html import render, script_data
from trimtab.host.report.show import component
from trimtab.host.route import Route
from trimtab.host.shooting.problem import SolveStatus
from trimtab.host.show.content import content_of_plan
from trimtab.host.vehicle import Limits, Vehicle

_LIMITS = {
    "geofence_m": ("geofence", "m"),
    "floor_m": ("floor", "m"),
    "speed_m_s": ("speed", "m/s"),
    "tilt_deg": ("tilt", "deg"),
    "body_rate_rad_s": ("body rate", "rad/s"),
    "jerk_m_s3": ("jerk", "m/s^3"),
    "thrust_low": ("least rotor thrust", "of maximum"),
    "thrust_high": ("greatest rotor thrust", "of maximum"),
    KEEP_OUT: ("keep-out shapes", "m"),
    GATES: ("edges of gates", "m"),
    YAW_RATE: ("yaw rate of a free heading", "rad/s"),
}
"""Displayed name and unit, by the margin's name."""


def page(
    plan: Plan, route: Route, vehicle: Vehicle, model: ResidualModel, provenance: Mapping[str, object]
) -> str:
    """Return the HTML of a plan's report, one file. `model` predicts the residual that is shown."""
    table, yaws = from_reference(plan.reference), plan.reference.yaw_nodes()
    along = profile(vehicle, model, table, yaws, with_nodes(table))
    off = sensitivity(vehicle, model, table, yaws)
    gates = passings(route, plan.waypoint_times_s)
    inside = inside_gates(table, gates)
    return render(
        "plan.html.j2",
        title=f"{route.name}: {plan.label}",
        sentence=_sentence(plan),
        show=component(
            content_of_plan(plan.reference, (route, plan.waypoint_times_s), vehicle, model), folded=True
        ),
        figures=[plan_figures.per_node(plan, route, along, off, inside)],
        parts=[
            {"title": "The plan", "head": (), "numbers": (), "rows": _facts(plan, off)},
            {
                "title": "Distance to the limits",
                "head": ("limit", "bound", "least distance", "unit", "node", "at, s"),
                "numbers": ("least distance", "node", "at, s"),
                "rows": _margins(plan, route, along, gates, inside),
            },
        ],
        provenance=json.dumps(dict(provenance), indent=1, default=str),
        data=script_data({"id": plan.reference.id, **_timeless(plan)}),
    )


def _timeless(plan: Plan) -> dict[str, Any]:
    """Return the plan's figures without processor time, so that the same plan gives the same page."""
    return {name: value for name, value in plan.figures().items() if name != "solve_s"}


def _sentence(plan: Plan) -> str:
    text = (
        f"{plan.path_length_m:.1f} m in {plan.duration_s:.2f} s, {plan.mean_speed_m_s:.2f} m/s mean speed, "
        "within every limit."
    )
    if plan.residual_rms_m_s2 is not None:
        text += f" The model predicts a residual of {plan.residual_rms_m_s2:.2f} m/s^2 RMS along it."
    return text


def _facts(plan: Plan, off: Sensitivity | None) -> list[tuple[str, str]]:
    """Return names and values of the properties of the whole plan."""
    dynamics = "with the model in the dynamics" if plan.augmented else "with nominal dynamics"
    rows = [("kind", f"{plan.label}, {dynamics}"), ("status", status_words(plan))]
    time_s = f"{plan.duration_s:.3f} s"
    if plan.stretch > 1.0:
        time_s += f", {plan.stretch:.3f} times the route's"
    rows += [
        ("time", time_s),
        ("length", f"{plan.path_length_m:.2f} m"),
        ("mean speed", f"{plan.mean_speed_m_s:.2f} m/s"),
        ("predicted residual", _or_dash(plan.residual_rms_m_s2, "{:.3f} m/s^2 RMS", "none, without a model")),
        *_off_reference(off),
        (
            "outside the model's trained region",
            _or_dash(
                None if plan.outside_region is None else 100.0 * plan.outside_region,
                "{:.1f} % of the time",
                "not known",
            ),
        ),
        ("nodes", str(len(plan.reference.nodes))),
    ]
    if plan.deviation_m is not None:
        rows.append(("greatest distance from the solver's path", f"{1e3 * plan.deviation_m:.2f} mm"))
    return rows


def _off_reference(off: Sensitivity | None) -> list[tuple[str, str]]:
    """Return the greatest sensitivities of the predicted residual to deviations from the reference."""
    peaks = None if off is None else off.peaks()
    if peaks is None:
        return []
    return [
        (
            f"its greatest sensitivity to {to}",
            f"{peak.value:.3g} {unit}, node {peak.node} at {peak.t_s:.2f} s",
        )
        for to, unit, peak in zip(
            ("velocity", "attitude"), ("m/s^2 per m/s", "m/s^2 per rad"), peaks, strict=True
        )
    ]


def status_words(plan: Plan) -> str:
    """Return a description of how the plan was found."""
    if not plan.iterations:
        suffix = "" if plan.stretch <= 1.0 else " after stretching"
        return f"minimum-snap spline; it keeps every limit{suffix}"
    words = SolveStatus[plan.status.upper()].value
    rounds = "1 round" if plan.rounds == 1 else f"{plan.rounds} rounds"
    return f"{words}: {plan.iterations} iterations in {rounds} on {plan.intervals} intervals"


def _margins(
    plan: Plan, route: Route, along: Profile, gates: Sequence[Passing], inside: ArrayLike
) -> list[tuple[str, str, str, str, str, str]]:
    """Return rows of limit, bound, least distance, unit, node and time."""
    distances = along.margins(plan.limits, route.keep_out)
    nodes_us = [node.t_us for node in plan.reference.nodes]
    rows = []
    for name, value in plan.margins.items():
        title, unit = _LIMITS.get(name, (name, ""))
        at = ("", "")
        if name in distances:
            k = int(distances[name].argmin())
            at = (str(along.node[k]), f"{along.t_s[k]:.2f}")
        elif name == GATES:  # gates count only where they are passed, which is at nodes
            t_us = gates[int(np.argmin(inside))].t_us
            at = (str(bisect_right(nodes_us, t_us) - 1), f"{t_us * 1e-6:.2f}")
        rows.append((title, _bound(name, plan.limits, route), f"{value:.3g}", unit, *at))
    return rows


def _bound(name: str, limits: Limits, route: Route) -> str:
    low, high = limits.thrust_headroom
    text_by_name = {
        "geofence_m": " x ".join(f"[{a:g}, {b:g}]" for a, b in limits.geofence_m),
        "floor_m": "0",
        "speed_m_s": f"{limits.speed_max_m_s:g}",
        "tilt_deg": f"{limits.tilt_max_deg:g}",
        "body_rate_rad_s": ", ".join(f"{bound:g}" for bound in limits.body_rate_max_rad_s),
        "jerk_m_s3": f"{limits.jerk_max_m_s3:g}",
        "thrust_low": f"{low:.3g}",
        "thrust_high": f"{high:.3g}",
        YAW_RATE: "" if route.yaw.rate_max_rad_s is None else f"{route.yaw.rate_max_rad_s:g}",
    }
    return text_by_name.get(name, "")


def _or_dash(value: float | None, form: str, otherwise: str) -> str:
    return otherwise if value is None else form.format(value)


def trade_page(points: Sequence[Point], route: Route, provenance: Mapping[str, object]) -> str:
    """Return the HTML of a comparison of residual and jerk between plans, one file that opens offline."""
    flown = any(point.flown is not None for point in points)
    units, cells = tabulate(points)
    head = ("plan", *(f"{name}, {unit}" for name, unit in units.items()), "status")
    rows = [(point.label, *row, point.status) for point, row in zip(points, cells, strict=True)]
    missing: Any = [(point.label, point.why_not) for point in points if point.why_not is not None]
    parts = [{"title": "The plans", "head": head, "numbers": head[1:-1], "rows": rows}]
    if missing:
        parts.append(
            {"title": "Missing plans and flights", "head": ("plan", "reason"), "numbers": (), "rows": missing}
        )
    return render(
        "plan.html.j2",
        title=f"{route.name}: residual against jerk",
        sentence="The same route and time, planned with different weights and kinds"
        + (", each flown once in the same simulated world." if flown else "."),
        show=None,
        figures=[trade_figures.trade(points)],
        parts=parts,
        provenance=json.dumps(dict(provenance), indent=1, default=str),
        data=script_data({"points": [point.to_json() for point in points]}),
    )
