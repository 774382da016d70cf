"""Figures of the study of section VI: means over worlds with their spread, and comparisons with the paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trimtab.host.apps.paper.chance import SAMPLES
from trimtab.host.apps.paper.flight import published, tables
from trimtab.host.apps.paper.flight.controllers import TABLE_III
from trimtab.host.apps.paper.flight.models import FLIGHTS, OURS, PAPER, SEGMENTS
from trimtab.host.apps.paper.flight.pretzel import KINDS, MIN_RESIDUAL, MIN_SNAP
from trimtab.host.apps.paper.flight.world import NOMINAL, SETS
from trimtab.host.apps.paper.text import text

Row = dict[str, Any]
World = Mapping[str, Any]


def summary(answer: Mapping[str, Any], pieces: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return the study's outcome: `answer`, with `tables` by title, `lines`, and what the pictures show."""
    worlds = [piece["result"] for piece in pieces.values()]
    figures: Row = {
        "statistics": _statistics(worlds),
        "prediction": {
            name: {
                horizon: _prediction([w["errors"][name] for w in worlds], horizon)
                for horizon in (FLIGHTS, SEGMENTS)
            }
            for name in SETS
        },
        "controllers": {
            law: _transfer([w["controllers"][law] for w in worlds if law in w["controllers"]])
            for law in dict.fromkeys(law for w in worlds for law in w["controllers"])
        },
        "pretzel": _pretzel([w["pretzel"] for w in worlds]),
        "selected": [w["selected"] for w in worlds],
        "networks_flown": sum(w["network"] for w in worlds),
        "flights": {name: sum(w["flights"][name] for w in worlds) for name in SETS},
        "failed": failures(worlds),
    }
    figures["worse"] = worse_than_paper(figures)
    made = tables.tables(figures)
    ratio = {name: figures["prediction"][name]["flights"]["ratios"][OURS] for name in SETS}
    return {
        "answer": {
            **answer,
            **figures,
            "prediction_ratio": {name: each["position_rmse_m"]["median"] for name, each in ratio.items()},
            "tables": made,
        },
        "tables": made,
        "lines": [line for title, rows in made.items() for line in ("", title, *text(rows))][1:],
        "worlds": worlds,
    }


def cluster_interval(groups: Sequence[Sequence[float]]) -> list[float] | None:
    """Return 95 % of bootstraps of the mean of group means: groups are drawn, then values in each group.

    None without values. A group is a world, its values are flights.
    """
    filled = [np.asarray(group, dtype=float) for group in groups if len(group)]
    if not filled:
        return None
    rng = np.random.default_rng(0)
    means = np.stack([g[rng.integers(len(g), size=(SAMPLES, len(g)))].mean(axis=1) for g in filled], axis=1)
    drawn = rng.integers(len(filled), size=(SAMPLES, len(filled)))
    low, high = np.percentile(np.take_along_axis(means, drawn, axis=1).mean(axis=1), [2.5, 97.5])
    return [float(low), float(high)]


def failures(worlds: Sequence[World]) -> list[Row]:
    """Return what was not planned, or not flown to its end: world, what, why."""
    rows = []
    for w in worlds:
        rows += [{"world": w["world"], "what": each["flight"], "why": each["why"]} for each in w["failed"]]
        if w["pretzel"]["failed"] is not None:
            rows.append({"world": w["world"], "what": "plan of the pretzel", "why": w["pretzel"]["failed"]})
        rows += [
            {"world": w["world"], "what": f"pretzel, {f['kind']}, {f['controller']}", "why": f["failed"]}
            for f in w["pretzel"]["flights"]
            if "failed" in f
        ]
    return rows


def worse_than_paper(figures: Mapping[str, Any]) -> list[Row]:
    """Return every figure of tables II and III that is larger than the paper's: what, paper, ours.

    Compared are errors, accelerations, jerks, and their ratios: of a model to the nominal one, of minimum
    residual to minimum snap.
    """
    pairs = [*_prediction_pairs(figures["prediction"]), *_pretzel_pairs(figures["pretzel"])]
    return [
        {"what": what, "paper": paper, "ours": ours}
        for what, paper, ours in pairs
        if ours is None or ours > paper
    ]


def _prediction_pairs(prediction: Mapping[str, Any]) -> list[tuple[str, float, float | None]]:
    pairs: list[tuple[str, float, float | None]] = []
    for name, label in tables.SETS.items():
        found = prediction[name]["flights"]
        for quantity, unit in tables.QUANTITIES.items():
            nominal, hybrid = published.ERRORS[name][quantity]
            what = f"prediction, {label}, {unit}"
            pairs.append((f"{what}, nominal", nominal, found["errors"][NOMINAL][quantity]["mean"]))
            for method, title in tables.METHODS.items():
                pairs.append((f"{what}, {title}", hybrid, found["errors"][method][quantity]["mean"]))
                ratio = found["ratios"][method][quantity]["median"]
                pairs.append((f"{what}, {title} over nominal", hybrid / nominal, ratio))
    return pairs


def _pretzel_pairs(pretzel: Mapping[str, Any]) -> list[tuple[str, float, float | None]]:
    pairs: list[tuple[str, float, float | None]] = []
    over = f"{MIN_RESIDUAL} over {MIN_SNAP}"
    for key, title in tables.PLANS.items():
        values, what = published.PLANS[key], f"pretzel, {title}"
        ours = {kind: pretzel["plans"][kind][key] for kind in KINDS}
        pairs += [(f"{what}, {kind}", values[kind], ours[kind]) for kind in KINDS]
        ratio = values[MIN_RESIDUAL] / values[MIN_SNAP]
        pairs.append((f"{what}, {over}", ratio, _over(ours[MIN_RESIDUAL], ours[MIN_SNAP])))
    for law, errors in published.TRACKING_M.items():
        found, what = (
            pretzel["controllers"][law],
            f"pretzel, mean position error, m, {tables.CONTROLLERS[law]}",
        )
        pairs += [(f"{what}, {kind}", errors[kind], found[kind]["error_mean_m"]) for kind in KINDS]
        pairs.append((f"{what}, {over}", errors[MIN_RESIDUAL] / errors[MIN_SNAP], found["ratio"]["mean"]))
    return pairs


def _statistics(worlds: Sequence[World]) -> Row:
    """Return the mean over worlds of each statistic of the references."""
    return {
        which: {key: _mean([w["statistics"][which][key] for w in worlds]) for key in rows}
        for which, rows in worlds[0]["statistics"].items()
    }


def _transfer(errors: Sequence[Mapping[str, Any]]) -> Row:
    """Return errors and ratios on flights of one controller over worlds, by horizon."""
    return {horizon: _prediction(errors, horizon) for horizon in errors[0][NOMINAL]}


def _prediction(errors: Sequence[Mapping[str, Any]], horizon: str) -> Row:
    """Return errors and ratios to the nominal model over worlds, by model and quantity."""
    of = {
        method: {quantity: [e[method][horizon][quantity] for e in errors] for quantity in tables.QUANTITIES}
        for method in (NOMINAL, PAPER, OURS)
    }
    return {
        "errors": {
            method: {quantity: _spread(values) for quantity, values in each.items()}
            for method, each in of.items()
        },
        "ratios": {
            method: {
                quantity: _spread([_over(a, b) for a, b in zip(values, of[NOMINAL][quantity], strict=True)])
                for quantity, values in of[method].items()
            }
            for method in (PAPER, OURS)
        },
    }


def _spread(values: Sequence[float | None]) -> Row:
    """Return mean, median, least and greatest, and all values; None if a roll-out diverged."""
    known = [value for value in values if value is not None]
    whole = len(known) == len(values) and bool(known)
    return {
        "mean": float(np.mean(known)) if whole else None,
        "median": float(np.median(known)) if whole else None,
        "least": min(known, default=None),
        "greatest": max(known, default=None),
        "values": list(values),
    }


def _pretzel(pretzels: Sequence[Mapping[str, Any]]) -> Row:
    """Return figures of the plans, means over worlds, and of the flights by controller and kind."""
    keys = (*published.PLANS, "residual_rms_m_s2", "path_length_m", "legs_length_m")
    return {
        "plans": {
            kind: {
                key: _mean([p["plans"][kind][key] for p in pretzels if kind in p["plans"]]) for key in keys
            }
            for kind in KINDS
        },
        "controllers": {law: _tracking(pretzels, law) for law in TABLE_III},
    }


def _tracking(pretzels: Sequence[Mapping[str, Any]], law: str) -> Row:
    """Return a controller's position errors on each kind, and the ratio of the kinds, flight by flight."""
    by_world = [
        {
            kind: {f["flight"]: f for f in p["flights"] if (f["kind"], f["controller"]) == (kind, law)}
            for kind in KINDS
        }
        for p in pretzels
    ]
    return {
        **{kind: _errors([list(w[kind].values()) for w in by_world]) for kind in KINDS},
        "ratio": _ratio(by_world, "error_mean_m"),
        "varying_ratio": _ratio(by_world, "varying_mean_m"),
    }


def _ratio(by_world: Sequence[Mapping[str, Mapping[int, Any]]], key: str) -> Row:
    """Return the ratio of the kinds of an error, flight by flight; failed flights are left out."""
    ratios = [
        [
            f[key] / w[MIN_SNAP][index][key]
            for index, f in w[MIN_RESIDUAL].items()
            if "failed" not in f and "failed" not in w[MIN_SNAP][index]
        ]
        for w in by_world
    ]
    return {"mean": _group_mean(ratios), "ci95": cluster_interval(ratios)}


def _errors(worlds: Sequence[Sequence[Mapping[str, Any]]]) -> Row:
    """Return the errors of flights in worlds; failed flights are left out."""
    flown = [[f for f in flights if "failed" not in f] for flights in worlds]
    means = [[f["error_mean_m"] for f in flights] for flights in flown]
    varying = [[f["varying_mean_m"] for f in flights] for flights in flown]
    constant = [[float(np.linalg.norm(f["constant_ned_m"])) for f in flights] for flights in flown]
    return {
        "error_mean_m": _group_mean(means),
        "ci95_m": cluster_interval(means),
        "constant_m": _group_mean(constant),
        "varying_mean_m": _group_mean(varying),
        "varying_ci95_m": cluster_interval(varying),
        "error_max_m": max((f["error_max_m"] for flights in flown for f in flights), default=None),
        "flights": sum(map(len, flown)),
    }


def _group_mean(groups: Sequence[Sequence[float]]) -> float | None:
    return _mean([float(np.mean(group)) for group in groups if len(group)])


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _over(value: float | None, base: float | None) -> float | None:
    return None if value is None or not base else value / base
