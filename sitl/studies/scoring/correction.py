"""Scores of the study of corrections: flown error with a correction over the one without."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.firmware_model.law.ops import FLOAT
from trimtab.host.effects import load_effects
from trimtab.host.log import read_flight
from trimtab.host.log.tracking import tracking_error

MODELS = ("traced", "learned")
DRAWS = 1000
"""Number of bootstrap draws over worlds for the interval of the median."""

_TARGET = "median <= 0.4, none above 1"
_LABELS = {"traced": "model of trace", "learned": "model of learn"}


def pose_age_s(truth: Mapping[str, Any]) -> float:
    """Return by how much the poses of a world's logs are older than their stamps."""
    drawn, deviations = truth["effects"], truth["deviations"]
    age_s = 0.0
    for name, effect in load_effects().items():
        if effect.mocap_latency_s is not None:
            values = drawn.get(name) or {
                key: neutral + deviations.get(f"{name}.{key}", 0.0)
                for key, neutral in zip(effect.keys, effect.neutral, strict=True)
            }
            age_s += float(effect.mocap_latency_s(FLOAT, [values[key] for key in effect.keys]))
    return age_s


def flown(log: Path, answer: Mapping[str, Any], age_s: float) -> dict[str, Any]:
    """Return the figures of a flight from its log and the answer of `trimtab fly`.

    `rmse_m` counts each pose at the time at which it was true, `stamped_rmse_m` at its stamp. A latency that
    the vehicle corrects shifts only the latter.
    """
    error = tracking_error(read_flight(log), pose_age_s=age_s)
    return {
        "whole": answer["whole"],
        "failsafe": answer["failsafe"],
        "rmse_m": None if error is None else error.rmse_m,
        "stamped_rmse_m": answer["tracking_rmse_m"],
        "faded_s": answer["feedforward_faded_s"],
    }


def ratio(flight: Mapping[str, Any], model: str, error: str = "rmse_m") -> float | None:
    """Return the flown error with the model's correction over the one without, for a pair of flights.

    It is 1 if the model has nothing to correct, because nothing is then sent to the vehicle. It is None if
    the flight without was not whole, and infinite if only the flight with the correction was not.
    """
    without, corrected = flight["uncorrected"], flight.get(model)
    if not without["whole"]:
        return None
    if corrected is None:
        return 1.0
    if not corrected["whole"]:
        return float("inf")
    return corrected[error] / without[error]


def summary(scores: Mapping[str, Mapping[str, Any]], seed: int) -> dict[str, Any]:
    """Return the figures by model.

    The interval is from a bootstrap over worlds; the flights of a world stay together.
    """
    return {model: _figures(scores, model, seed) for model in MODELS}


def _figures(scores: Mapping[str, Mapping[str, Any]], model: str, seed: int) -> dict[str, Any]:
    by_world = {
        name: [r for flight in score["flights"] if (r := ratio(flight, model)) is not None]
        for name, score in scores.items()
    }
    ratios = [r for world in by_world.values() for r in world]
    stamped = [
        r
        for score in scores.values()
        for flight in score["flights"]
        if (r := ratio(flight, model, "stamped_rmse_m")) is not None
    ]
    made = [score["models"][model] for score in scores.values()]
    faded = [
        flight[model]["faded_s"]
        for score in scores.values()
        for flight in score["flights"]
        if model in flight
    ]
    return {
        "flights": len(ratios),
        "ratio_median": _finite(np.median(ratios)) if ratios else None,
        "ratio_interval": _interval([world for world in by_world.values() if world], seed),
        "ratio_worst": _finite(max(ratios)) if ratios else None,
        "stamped_ratio_median": _finite(np.median(stamped)) if stamped else None,
        "stamped_worse": sum(r > 1.0 for r in stamped),
        "worse": sum(r > 1.0 for r in ratios),
        "failed": sum(r == float("inf") for r in ratios),
        "ratio_by_world": {name: _finite(np.median(world)) for name, world in by_world.items() if world},
        "faded": sum(bool(s) for s in faded),
        "uncorrected_worlds": sum("id" not in m for m in made),
        "undecided_worlds": sum(m["verdict"] == "undecided" for m in made),
    }


def _interval(worlds: Sequence[Sequence[float]], seed: int) -> list[float | None] | None:
    """Return the 95 % bootstrap interval of the median; None with fewer than two worlds."""
    if len(worlds) < 2:
        return None
    rng = np.random.default_rng(seed)
    draws = rng.integers(len(worlds), size=(DRAWS, len(worlds)))
    medians = [np.median([r for i in draw for r in worlds[i]]) for draw in draws.tolist()]
    # Medians may be infinite, so the quantiles are order statistics.
    low, high = np.quantile(medians, [0.025, 0.975], method="nearest")
    return [_finite(low), _finite(high)]


def cells(figures: Mapping[str, Any]) -> list[dict[str, str]]:
    """Return the rows of the report's table of figures, the worst first."""
    rows = []
    for model in MODELS:
        found = figures[model]
        interval = found["ratio_interval"]
        rows.append({
            "feed-forward": _LABELS[model],
            "flights": str(found["flights"]),
            "worst": "failed" if found["failed"] else _text(found["ratio_worst"]),
            "above 1": str(found["worse"]),
            "median": _text(found["ratio_median"]),
            "95 % interval": "-" if interval is None else " to ".join(map(_text, interval)),
            "target": _TARGET if model == "traced" else "",
        })  # fmt: skip
    return rows


def world_cells(scores: Mapping[str, Mapping[str, Any]]) -> list[dict[str, str]]:
    """Return a row for each world: its effects, the verdict, and error without and with each correction."""
    rows = []
    for name, score in scores.items():
        flights, models = score["flights"], score["models"]
        row = {
            "world": name,
            "effects": ", ".join(sorted(score["effects"])) or "none",
            "verdict": str(models["traced"]["verdict"]),
            "not corrected": ", ".join(models["traced"].get("uncorrected", {})) or "-",
            "uncorrected, mm": _rmse_mm([flight["uncorrected"] for flight in flights]),
        }
        for model in MODELS:
            row[f"{model}, mm"] = _rmse_mm([flight[model] for flight in flights if model in flight])
            row[f"{model}, ratio"] = " ".join(_text(ratio(flight, model)) for flight in flights)
        rows.append(row)
    return rows


def lines(figures: Mapping[str, Any]) -> list[str]:
    """Return the lines of text for the terminal."""
    return [
        f"{row['feed-forward']}: flown error with over without, median {row['median']} "
        f"({row['95 % interval']}), worst {row['worst']}, {row['above 1']} of {row['flights']} above 1"
        for row in cells(figures)
    ]


def _rmse_mm(flights: Sequence[Mapping[str, Any]]) -> str:
    errors = [flight["rmse_m"] for flight in flights if flight["whole"]]
    return f"{1e3 * float(np.median(errors)):.1f}" if errors else "-"


def _finite(value: float | np.floating) -> float | None:
    """Return a number for JSON; None for an infinite one."""
    return float(value) if np.isfinite(value) else None


def _text(value: float | None) -> str:
    if value is None:
        return "-"
    return "failed" if value == float("inf") else f"{value:.2f}"
