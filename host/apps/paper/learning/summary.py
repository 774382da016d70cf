"""Summary of the pieces of the study: medians, tables, lines of text."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from trimtab.host.apps.paper.learning import curves, noise
from trimtab.host.apps.paper.text import text

Row = dict[str, Any]

FLOWN_PAPER = {
    "train": {"position_rmse_m": (0.101, 0.064), "velocity_rmse_m_s": (0.225, 0.137)},
    "test": {"position_rmse_m": (0.097, 0.067), "velocity_rmse_m_s": (0.192, 0.129)},
    "ood": {"position_rmse_m": (0.114, 0.093), "velocity_rmse_m_s": (0.244, 0.199)},
}
"""Nominal and hybrid of the paper's table of section VI-C."""

STATISTICS_PAPER = {
    "known": {
        "speed_m_s": (1.595, 0.854),
        "acceleration_m_s2": (2.478, 1.971),
        "jerk_m_s3": (4.726, 5.3),
    },
    "ood": {"speed_m_s": (2.721, 1.35), "acceleration_m_s2": (4.403, 2.437), "jerk_m_s3": (8.845, 5.732)},
}
"""Mean and standard deviation of the paper's table of section VI-B."""

METHODS = {
    "nominal": "nominal model",
    "paper": "MLP 3 x 32, Adam, our settings",
    "hybrid": "effects + MLP (default)",
    "body": "effects + MLP on body velocity",
}
_SETS = {"train": "train", "test": "test", "ood": "out of distribution"}


def summary(answer: Mapping[str, Any], pieces: Mapping[str, Any]) -> dict[str, Any]:
    """Return `answer` with the figures, `tables` by title, `lines`, and `curves` and `noise` for pictures."""
    by_kind: dict[str, list[Any]] = {}
    for name, piece in pieces.items():
        by_kind.setdefault(name.split("-")[0], []).append(piece["result"])
    (nominal,), (moved,) = by_kind["nominal"], by_kind["transfer"]
    learned = _curves(nominal, by_kind["curve"])
    regressors = _regressors(by_kind["regressor"])
    noisy = _noise([row for rows in by_kind["noise"] for row in rows])
    flown = _flown(by_kind["world"])
    figures = {
        "acceleration": {"nominal": nominal, "curves": learned},
        "regressors": regressors,
        "noise": noisy,
        "transfer": moved,
        "flown": flown,
    }
    tables = {
        "Section V-A: acceleration RMSE, m/s^2": _curve_table(nominal, learned),
        "Regressors on exact data, condensed loss with L-BFGS": _regressor_table(regressors),
        "Noise: trajectory loss against supervised labels": _noise_table(noisy),
        "Learned at 20 ms, rolled out at other steps": _step_table(moved["steps"]),
        "Learned under one law, predicting under others": _law_table(moved["laws"]),
        "Section VI-B: statistics of the references": _statistics_table(flown),
        "Section VI-C: prediction error of whole flights, median over worlds": _flown_table(flown),
    }
    return {
        "answer": {**answer, **figures},
        "tables": tables,
        "lines": [line for title, rows in tables.items() for line in ("", title, *text(rows))][1:],
        "curves": by_kind["curve"],
        "noise": noisy,
        "flown": flown,
    }


def _curves(nominal: Mapping[str, Any], trials: Sequence[Mapping[str, Any]]) -> list[Row]:
    """Per setting of the loss: medians over trials."""
    rows = []
    for (weight, held), chosen in _grouped(trials, "weight", "held"):
        rows.append(
            {
                "weight": weight,
                "held": held,
                "trials": len(chosen),
                "seconds": _median([t["seconds"] for t in chosen]),
                "errors": {
                    name: {key: _median([t["errors"][name][key] for t in chosen]) for key in nominal[name]}
                    for name in curves.SETS
                },
            }
        )
    return rows


def _regressors(found: Sequence[Mapping[str, Any]]) -> list[Row]:
    """Per regressor and number of iterations: medians over seeds."""
    rows = []
    for (regressor, iterations), chosen in _grouped(found, "regressor", "iterations"):
        rows.append(
            {
                "regressor": regressor,
                "iterations": iterations,
                "seeds": len(chosen),
                "seconds": _median([e["seconds"] for e in chosen]),
                **{n: _median([e["errors"][n]["pointwise_norm"] for e in chosen]) for n in curves.SETS},
            }
        )
    return rows


def _noise(found: Sequence[Mapping[str, Any]]) -> list[Row]:
    """Per regressor, scale and method: medians over seeds."""
    rows = []
    for (regressor, scale, method), chosen in _grouped(found, "regressor", "scale", "method"):
        row = {"regressor": regressor, "scale": scale, "method": method, "seeds": len(chosen)}
        rows.append({**row, **{name: _median([e[name] for e in chosen]) for name in ("test", "ood")}})
    return rows


def _flown(worlds: Sequence[Mapping[str, Any]]) -> Row:
    """Return ratios and errors over worlds."""
    errors = {
        name: {
            method: {
                key: _median([w["errors"][name][method][key] for w in worlds])
                for key in ("position_rmse_m", "velocity_rmse_m_s")
            }
            for method in METHODS
        }
        for name in _SETS
    }
    ratios = {
        name: {
            method: [_ratio(w["errors"][name], method) for w in worlds]
            for method in METHODS
            if method != "nominal"
        }
        for name in _SETS
    }
    return {
        "worlds": len(worlds),
        "flights": {name: sum(w["flights"][name] for w in worlds) for name in _SETS},
        "failed": [flight for w in worlds for flight in w["failed"]],
        "errors": errors,
        "kept": {method: [w["kept"][method] for w in worlds] for method in METHODS if method != "nominal"},
        "ratios": ratios,
        "ratio_median": {
            name: {method: _median(values) for method, values in each.items()}
            for name, each in ratios.items()
        },
        "statistics": {
            which: {key: _median([w["statistics"][which][key] for w in worlds]) for key in rows}
            for which, rows in worlds[0]["statistics"].items()
        },
    }


def _ratio(errors: Mapping[str, Mapping[str, float | None]], method: str) -> float | None:
    learned, nominal = errors[method]["position_rmse_m"], errors["nominal"]["position_rmse_m"]
    return None if learned is None or nominal is None else learned / nominal


def _curve_table(nominal: Mapping[str, Any], learned: Sequence[Row]) -> list[Row]:
    paper = {name: f"{n:.3f} / {h:.3f}" for name, (n, h) in curves.PAPER_RMSE.items()}
    rows = [{"": "paper, nominal / hybrid", "train": paper["train"], "test": paper["test"], "ood": "-"}]
    for which in ("pointwise_norm", "pointwise_component", "rolled_norm", "rolled_component"):
        rows.append({"": f"nominal, {_WHICH[which]}", **{n: _number(nominal[n][which]) for n in curves.SETS}})
    for row in learned:
        what = f"Adam, L {row['weight']}" + (", reference held in a step" if row["held"] else "")
        for which in ("pointwise_norm", "pointwise_component", "rolled_norm", "rolled_component"):
            cells = {n: _number(row["errors"][n][which]) for n in curves.SETS}
            rows.append({"": f"{what}, {_WHICH[which]}", **cells})
    return rows


_WHICH = {
    "pointwise_norm": "norm, pointwise",
    "pointwise_component": "component, pointwise",
    "rolled_norm": "norm, along roll-outs",
    "rolled_component": "component, along roll-outs",
}


def _regressor_table(rows: Sequence[Row]) -> list[Row]:
    return [
        {
            "regressor": row["regressor"],
            "iterations": str(row["iterations"]),
            "seconds": f"{row['seconds']:.1f}",
            **{name: _number(row[name]) for name in curves.SETS},
        }
        for row in rows
    ]


def _noise_table(rows: Sequence[Row]) -> list[Row]:
    table = []
    for (regressor, scale), own in _grouped(rows, "regressor", "scale"):
        chosen = {row["method"]: row for row in own}
        cells = {
            method: f"{_number(chosen[method]['test'])} / {_number(chosen[method]['ood'])}"
            for method in (noise.TRAJECTORY, noise.SUPERVISED, noise.TRAJECTORY_RAW, noise.SUPERVISED_RAW)
        }
        better = chosen[noise.SUPERVISED]["test"] / chosen[noise.TRAJECTORY]["test"]
        table.append(
            {"regressor, test / ood": regressor, "noise": f"{scale:g}x", **cells, "gain": f"{better:.2f}"}
        )
    return table


def _step_table(rows: Sequence[Row]) -> list[Row]:
    (base,) = (row["position_rmse_m"] for row in rows if row["step_s"] == 0.02)
    return [
        {
            "step": f"{1e3 * row['step_s']:g} ms",
            "position error": f"{1e3 * row['position_rmse_m']:.4f} mm",
            "change": f"{100.0 * (row['position_rmse_m'] / base - 1.0):+.2f} %",
        }
        for row in rows
    ]


def _law_table(rows: Sequence[Row]) -> list[Row]:
    table = []
    for row in rows:
        cells = {}
        for name in ("test", "ood"):
            found = row[name]
            before, after = found["nominal_position_rmse_m"], found["position_rmse_m"]
            cells[f"{name}, mm"] = f"{_number(before, 1e3)} -> {_number(after, 1e3)}"
            cells[f"{name}, m/s^2"] = _number(found["acceleration_rmse"])
        table.append({"law": row["law"], "network": row["network"], **cells})
    return table


def _statistics_table(flown: Row) -> list[Row]:
    rows = []
    for which, quantities in STATISTICS_PAPER.items():
        for quantity, (mean, sd) in quantities.items():
            own = flown["statistics"][which]
            ours = f"{own[f'{quantity}_mean']:.2f} / {own[f'{quantity}_sd']:.2f}"
            rows.append(
                {
                    "": "training and test" if which == "known" else "out of distribution",
                    "quantity": quantity,
                    "paper, mean / sd": f"{mean:.2f} / {sd:.2f}",
                    "ours, mean / sd": ours,
                }
            )
    return rows


def _flown_table(flown: Row) -> list[Row]:
    rows = []
    for name, label in _SETS.items():
        for method, told in METHODS.items():
            cells = flown["errors"][name][method]
            paper = {"nominal": 0, "paper": 1}.get(method)
            ratios = [r for r in flown["ratios"][name].get(method, []) if r is not None]
            nominal, hybrid = FLOWN_PAPER[name]["position_rmse_m"]
            rows.append(
                {
                    "set": label,
                    "model": told,
                    "position, mm": _number(cells["position_rmse_m"], 1e3, 1),
                    "velocity, mm/s": _number(cells["velocity_rmse_m_s"], 1e3, 1),
                    "over nominal": f"{np.median(ratios):.2f} ({min(ratios):.2f}-{max(ratios):.2f})"
                    if ratios
                    else "-",
                    "paper, mm": "-"
                    if paper is None
                    else f"{1e3 * FLOWN_PAPER[name]['position_rmse_m'][paper]:.0f}",
                    "paper, over nominal": f"{hybrid / nominal:.2f}" if paper == 1 else "-",
                }
            )
    return rows


def _grouped(
    rows: Sequence[Mapping[str, Any]], *keys: str
) -> Iterable[tuple[tuple[Any, ...], list[Mapping[str, Any]]]]:
    """Return the rows grouped by their values under these keys, in order of first appearance."""
    groups: dict[tuple[Any, ...], list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    return groups.items()


def _median(values: Sequence[float | None]) -> float | None:
    """Return the median, or None if a value is None because a roll-out diverged."""
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known and len(known) == len(values) else None


def _number(value: float | None, scale: float = 1.0, digits: int = 4) -> str:
    return "diverged" if value is None else f"{scale * value:.{digits}f}"
