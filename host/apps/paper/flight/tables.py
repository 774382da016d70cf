"""Tables of the study of section VI, ours beside the paper's, as text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trimtab.host.apps.paper.flight import published
from trimtab.host.apps.paper.flight.controllers import (
    BASELINE,
    MPC,
    MPC_L1,
    MPC_NEURAL,
    NEURAL,
    NEURAL_OBSERVER,
    OBSERVER,
)
from trimtab.host.apps.paper.flight.models import AHEAD, AHEAD_SAME_TORQUE, FLIGHTS, OURS, PAPER, SEGMENTS
from trimtab.host.apps.paper.flight.pretzel import KINDS, MIN_RESIDUAL, MIN_SNAP
from trimtab.host.learn.ahead import AHEAD_S

Cells = dict[str, str]

SETS = {"train": "training", "test": "test", "ood": "out of distribution"}
METHODS = {PAPER: "paper's settings", OURS: "ours"}
CONTROLLERS = {
    BASELINE: "baseline",
    OBSERVER: "DO",
    NEURAL: "feed-forward",
    NEURAL_OBSERVER: "Neural DO",
    MPC: "MPC",
    MPC_L1: "L1-MPC",
    MPC_NEURAL: "neural MPC",
}
TRANSFER = {
    FLIGHTS: "whole flight, from its reference",
    AHEAD: f"{AHEAD_S:g} s ahead, from its motor commands",
    AHEAD_SAME_TORQUE: f"{AHEAD_S:g} s ahead, with the same torque in all models",
}
"""Horizons of remark 1."""
QUANTITIES = {"position_rmse_m": "position, m", "velocity_rmse_m_s": "velocity, m/s"}
_STATISTICS = {
    "speed_m_s": "speed, m/s",
    "acceleration_m_s2": "acceleration, m/s^2",
    "jerk_m_s3": "jerk, m/s^3",
}
PLANS = {
    "acceleration_max_m_s2": "greatest acceleration, m/s^2",
    "jerk_max_m_s3": "greatest jerk, m/s^3",
    "acceleration_mean_m_s2": "mean acceleration, m/s^2",
    "jerk_mean_m_s3": "mean jerk, m/s^3",
}


def tables(figures: Mapping[str, Any]) -> dict[str, list[Cells]]:
    """Return the tables by title. The first lists every figure that is worse than the paper's."""
    return {
        "Worse than in the paper": _worse(figures),
        "Table I: statistics of the references": _statistics(figures["statistics"]),
        "Table II: prediction error of whole flights, mean over worlds": _prediction(
            figures["prediction"], FLIGHTS
        ),
        "Table II: prediction error of segments of 25 nodes, mean over worlds": _prediction(
            figures["prediction"], SEGMENTS
        ),
        "Table III: the pretzel": _pretzel(figures["pretzel"]),
        "The pretzel: path lengths, and errors without their constant part": _parts(figures["pretzel"]),
        "Remark 1: learned under the baseline, predicting flights of other controllers": _controllers(
            figures["controllers"]
        ),
        "Flights": _flights(figures),
    }


def _worse(figures: Mapping[str, Any]) -> list[Cells]:
    rows = [
        {"figure": row["what"], "paper": _number(row["paper"]), "ours": _number(row["ours"])}
        for row in figures["worse"]
    ]
    return rows or [{"figure": "none", "paper": "", "ours": ""}]


def _statistics(statistics: Mapping[str, Mapping[str, float]]) -> list[Cells]:
    rows = []
    for which, label in (("known", "training and test"), ("ood", "out of distribution")):
        count = str(published.NUMBERS[which])
        rows.append({"set": label, "mean / sd": "trajectories", "paper": count, "ours": count})
        for quantity, name in _STATISTICS.items():
            mean, sd = published.STATISTICS[which][quantity]
            ours = statistics[which]
            rows.append(
                {
                    "set": label,
                    "mean / sd": name,
                    "paper": f"{mean:.3f} / {sd:.3f}",
                    "ours": f"{ours[f'{quantity}_mean']:.3f} / {ours[f'{quantity}_sd']:.3f}",
                }
            )
    return rows


def _prediction(prediction: Mapping[str, Any], horizon: str) -> list[Cells]:
    rows = []
    for name, label in SETS.items():
        found = prediction[name][horizon]
        for quantity, unit in QUANTITIES.items():
            nominal, hybrid = published.ERRORS[name][quantity]
            row = {
                "set": label,
                "RMSE": unit,
                "paper, nominal": _number(nominal),
                "paper, hybrid": _number(hybrid),
                "paper, ratio": f"{hybrid / nominal:.2f}",
                "nominal": _spread(found["errors"]["nominal"][quantity], "mean", ".3f"),
            }
            for method, title in METHODS.items():
                row[title] = _spread(found["errors"][method][quantity], "mean", ".3f")
                row[f"{title}, ratio"] = _spread(found["ratios"][method][quantity], "median", ".2f")
            rows.append(row)
    return rows


def _pretzel(pretzel: Mapping[str, Any]) -> list[Cells]:
    rows = []
    for key, title in PLANS.items():
        paper, ours = published.PLANS[key], {kind: pretzel["plans"][kind][key] for kind in KINDS}
        ratio = None if None in ours.values() else ours[MIN_RESIDUAL] / ours[MIN_SNAP]
        rows.append(
            {
                "figure": title,
                **{f"paper, {kind}": _number(paper[kind]) for kind in KINDS},
                "paper, ratio": f"{paper[MIN_RESIDUAL] / paper[MIN_SNAP]:.2f}",
                **{kind: _number(ours[kind]) for kind in KINDS},
                "ratio": "" if ratio is None else f"{ratio:.2f}",
                "flights": "",
            }
        )
    for law, errors in published.TRACKING_M.items():
        found = pretzel["controllers"][law]
        rows.append(
            {
                "figure": f"mean position error, {CONTROLLERS[law]}, m",
                **{f"paper, {kind}": _number(errors[kind]) for kind in KINDS},
                "paper, ratio": f"{errors[MIN_RESIDUAL] / errors[MIN_SNAP]:.2f}",
                **{
                    kind: _interval(found[kind]["error_mean_m"], found[kind]["ci95_m"], ".4f")
                    for kind in KINDS
                },
                "ratio": _interval(found["ratio"]["mean"], found["ratio"]["ci95"], ".2f"),
                "flights": " + ".join(str(found[kind]["flights"]) for kind in KINDS),
            }
        )
    return rows


def _parts(pretzel: Mapping[str, Any]) -> list[Cells]:
    """Return lengths of paths, and the constant and the varying part of the errors by controller."""
    plans = pretzel["plans"]
    lengths = {kind: plans[kind]["path_length_m"] for kind in KINDS}
    legs_m = {kind: plans[kind]["legs_length_m"] for kind in KINDS}
    rows = [
        _kinds("length of the path, m", lengths, lengths),
        _kinds(
            "straight lines between its waypoints, m", legs_m, {**lengths, MIN_RESIDUAL: legs_m[MIN_RESIDUAL]}
        ),
    ]
    for law in published.TRACKING_M:
        found, label = pretzel["controllers"][law], CONTROLLERS[law]
        constant = {kind: found[kind]["constant_m"] for kind in KINDS}
        rows.append(_kinds(f"constant part of the error, {label}, m", constant, constant))
        rows.append(
            {
                "figure": f"mean of the varying part, {label}, m",
                **{
                    kind: _interval(found[kind]["varying_mean_m"], found[kind]["varying_ci95_m"], ".4f")
                    for kind in KINDS
                },
                "ratio": _interval(found["varying_ratio"]["mean"], found["varying_ratio"]["ci95"], ".2f"),
            }
        )
    return rows


def _kinds(figure: str, values: Mapping[str, float | None], over: Mapping[str, float | None]) -> Cells:
    """Return a row of a value by kind, and the ratio of the kinds in `over`."""
    snap, residual = over[MIN_SNAP], over[MIN_RESIDUAL]
    ratio = "" if snap is None or residual is None else f"{residual / snap:.2f}"
    return {"figure": figure, **{kind: _number(values[kind]) for kind in KINDS}, "ratio": ratio}


def _controllers(controllers: Mapping[str, Any]) -> list[Cells]:
    """Return a row for each controller, of whole flights first; ratios compare within a horizon."""
    rows = []
    chosen = [
        (horizon, law, of[horizon])
        for horizon in TRANSFER
        for law, of in controllers.items()
        if horizon in of
    ]
    for horizon, law, found in chosen:
        row = {
            "flown by": CONTROLLERS[law],
            "predicted": TRANSFER[horizon],
            "nominal, m": _spread(found["errors"]["nominal"]["position_rmse_m"], "mean", ".3f"),
        }
        for method, title in METHODS.items():
            row[f"{title}, m"] = _spread(found["errors"][method]["position_rmse_m"], "mean", ".3f")
            row[f"{title}, ratio"] = _spread(found["ratios"][method]["position_rmse_m"], "median", ".2f")
        rows.append(row)
    return rows


def _flights(figures: Mapping[str, Any]) -> list[Cells]:
    """Return how many flights the figures rest on, what was learned, and what failed."""
    flights = ", ".join(f"{count} {SETS[name]}" for name, count in figures["flights"].items())
    rows = [
        {"": "worlds", "value": str(len(figures["selected"]))},
        {"": "flights of the references", "value": flights},
        {"": "learned part selected, by world", "value": "; ".join(figures["selected"])},
        {"": "worlds whose feed-forward has a network", "value": str(figures["networks_flown"])},
    ]
    failed = [
        {"": f"failed in world {row['world']}: {row['what']}", "value": row["why"]}
        for row in figures["failed"]
    ]
    return rows + (failed or [{"": "failed", "value": "none"}])


def _spread(spread: Mapping[str, Any], middle: str, form: str) -> str:
    """Return the middle and the range over worlds as text."""
    if spread[middle] is None:
        return "diverged"
    low, high = spread["least"], spread["greatest"]
    return format(spread[middle], form) + ("" if low == high else f" ({low:{form}}-{high:{form}})")


def _interval(value: float | None, interval: list[float] | None, form: str) -> str:
    """Return a value and its 95 % interval as text."""
    if value is None or interval is None:
        return "not flown"
    return f"{value:{form}} ({interval[0]:{form}}-{interval[1]:{form}})"


def _number(value: float | None) -> str:
    return "not measured" if value is None else f"{value:.3f}"
