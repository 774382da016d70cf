"""Compute the figures of a blind study from the scores of its worlds, each with count and exact interval."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trimtab.sitl.studies.scoring.counts import interval, mean, quantile, share
from trimtab.sitl.studies.scoring.detection import by_kind, by_outside_kind, detection_curves
from trimtab.sitl.studies.scoring.probabilities import calibration
from trimtab.sitl.studies.worlds import THIN

SURE_SIGMA = 15.0
"""A parameter's error counts if its truth is at least typical and this many sigma of the bound."""

REFUSED = 2
"""Exit code for logs that contain too little or do not belong together."""

OUTCOMES = ("right", "undecided", "nothing-missing", "refused", "outside-library", "wrong", "failed")
"""Outcomes of thin data. right: traced with true names only. wrong: traced with a false name."""

THIN_GOOD = OUTCOMES[:4]
"""Outcomes that claim nothing false."""

TRACING = "trimtab trace"
FAMILIES = ("force", "torque", "timing", "aerodynamic")
CLASSES = ("single", "pair", "triple", "none", "outside", "thin")
EFFECTS = CLASSES[:3]
"""Classes of worlds that hold effects of the library, with complete data."""

TRUTHS = ("true", "drawn")
"""Truths of a parameter: its effective value, and the one that the plant was drawn with."""

_SUFFIX = {"true": "", "drawn": "_drawn"}
Scores = Sequence[Mapping[str, Any]]


def summary(scores: Scores) -> dict[str, Any]:
    """Return the figures of a study as plain data, by JSON key; None if nothing was counted.

    `n` and `interval` have the keys of the figures. `by_family` repeats coverage and width by family. `thin`
    counts outcomes by case. `probabilities` is the calibration by kind of data; `detection`, `by_kind` and
    `by_outside_kind` are of the module `detection`. Keys with `_drawn` compare with drawn values.
    """
    by_class = {c: [s for s in scores if s["class"] == c] for c in CLASSES}
    inside, thin = [s for c in EFFECTS for s in by_class[c]], by_class["thin"]
    hits = _hits(by_class)
    rows = [row for s in inside for row in s["parameters"]]
    covered, covered_drawn = ([_covers(row, truth) for row in rows] for truth in TRUTHS)
    errors = {truth: relative_errors(inside, truth) for truth in TRUTHS}
    widths = [row["sd"] / row["bound_sd"] for row in rows if row["sd"]]
    judged = [s for s in inside if s["after_m"] is not None and s["floor_m"]]
    over = [s["after_m"] / s["floor_m"] for s in judged]
    sizes = [size for s in inside for size in s["alias_sizes"]]
    answers = [s["answer_size"] for s in inside]
    times = [s["trace_s"] for s in scores if s["class"] != "thin" and s["trace_s"] is not None]
    steady, turning = (
        {
            truth: [e["error"] for e in errors[truth] if (e["family"] == "torque") == torque]
            for truth in TRUTHS
        }
        for torque in (False, True)
    )
    thin_cases = {case: [s for s in thin if s["case"] == case] for case in THIN}
    return {
        **{name: share(flags) for name, flags in hits.items()},
        "alias_size_mean": mean(sizes),
        "alias_size_max": max(sizes, default=None),
        "answer_size_mean": mean(answers),
        "answer_size_max": max(answers, default=None),
        **{
            f"parameter_error{family}_{name}{_SUFFIX[truth]}": quantile(found[truth], level)
            for truth in TRUTHS
            for family, found in (("", steady), ("_torque", turning))
            for name, level in (("median", 0.5), ("p90", 0.9))
        },
        "coverage_2sigma": share(covered),
        "coverage_2sigma_drawn": share(covered_drawn),
        "width_over_bound": quantile(widths, 0.5),
        "by_family": {name: _family([row for row in rows if row["family"] == name]) for name in FAMILIES},
        "probabilities": calibration(scores),
        "detection": detection_curves(scores),
        "by_kind": by_kind(scores),
        "by_outside_kind": by_outside_kind(scores),
        "thin": {case: _thin(group) for case, group in thin_cases.items() if group},
        "after_over_floor_median": quantile(over, 0.5),
        "after_over_floor_p90": quantile(over, 0.9),
        "before_mm_median": _millimetres(judged, "before_m"),
        "after_mm_median": _millimetres(judged, "after_m"),
        "floor_mm_median": _millimetres(judged, "floor_m"),
        "trace_s_median": quantile(times, 0.5),
        "trace_s_max": max(times, default=None),
        "redrawn": sum(s["redrawn"] > 0 for s in scores),
        "n": {
            **{name: len(flags) for name, flags in hits.items()},
            "alias_size_mean": len(sizes),
            "answer_size_mean": len(answers),
            **{f"parameter_error{_SUFFIX[truth]}": len(steady[truth]) for truth in TRUTHS},
            **{f"parameter_error_torque{_SUFFIX[truth]}": len(turning[truth]) for truth in TRUTHS},
            "coverage_2sigma": len(covered),
            "width_over_bound": len(widths),
            "after_over_floor": len(over),
            "trace_s": len(times),
            "worlds": len(scores),
        },
        "interval": {
            **{name: interval(flags) for name, flags in hits.items()},
            "coverage_2sigma": interval(covered),
            "coverage_2sigma_drawn": interval(covered_drawn),
        },
    }


def _hits(by_class: Mapping[str, Scores]) -> dict[str, list[bool]]:
    """Return for each share of worlds whether each world that counts is a hit."""
    none, outside, thin = by_class["none"], by_class["outside"], by_class["thin"]
    inside = [s for c in EFFECTS for s in by_class[c]]
    exact = {
        f"{name}_exact{suffix}": [s["exact"] for s in by_class[c] if s["identifiable"] or not only]
        for name, c in (("singles", "single"), ("pairs", "pair"), ("triples", "triple"))
        for suffix, only in (("_identifiable", True), ("", False))
    }
    return {
        **exact,
        "top1": [s["top1"] for s in by_class["single"] if s["identifiable"]],
        "top1_all": [s["top1"] for s in by_class["single"]],
        "in_alias": [s["in_alias"] for s in inside],
        "in_alias_identifiable": [s["in_alias"] for s in inside if s["identifiable"]],
        "in_answer": [s["in_answer"] for s in inside],
        "in_answer_identifiable": [s["in_answer"] for s in inside if s["identifiable"]],
        "false_alarm": [s["verdict"] != "nothing-missing" for s in none],
        "abstain_outside": [s["verdict"] == "outside-library" for s in outside if s["detectable"]],
        "abstain_undetectable": [s["verdict"] == "outside-library" for s in outside if not s["detectable"]],
        "abstain_inside": [s["verdict"] == "outside-library" for s in inside],
        "thin_wrong": [s["wrong"] for s in thin],
        "thin_told": [s["told"] for s in thin],
    }


def _family(rows: Scores) -> dict[str, Any]:
    """Return coverage, of effective and of drawn values, and width of the parameters of one family."""
    covered, covered_drawn = ([_covers(row, truth) for row in rows] for truth in TRUTHS)
    return {
        "coverage_2sigma_drawn": share(covered_drawn),
        "interval_drawn": interval(covered_drawn),
        "coverage_2sigma": share(covered),
        "interval": interval(covered),
        "n": len(covered),
        "width_over_bound": quantile((row["sd"] / row["bound_sd"] for row in rows if row["sd"]), 0.5),
    }


def outcome(score: Mapping[str, Any]) -> str:
    """Return the outcome of a world with thin data: one of OUTCOMES."""
    if score["verdict"] == "traced":
        return "wrong" if score["wrong"] else "right"
    if score["verdict"] == "failed":
        return "refused" if score["exit_code"] == REFUSED else "failed"
    return score["verdict"]


def _thin(scores: Scores) -> dict[str, int]:
    """Count the worlds of one case: all, by outcome, and those whose answers name the missing data."""
    outcomes = [outcome(s) for s in scores]
    counts = {name: outcomes.count(name) for name in OUTCOMES}
    return {"n": len(scores), **counts, "told": sum(s["told"] for s in scores)}


def relative_errors(scores: Scores, truth: str = "true") -> list[dict[str, Any]]:
    """Return errors over the truth's distance from neutral, for truths of typical size and SURE_SIGMA.

    `truth` is one of TRUTHS. Two values that were drawn as one vector count as one: the length of the error
    over that of the vector.
    """
    out = []
    for score in scores:
        groups: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
        for row in score["parameters"]:
            key = "" if row["turned"] else row["key"]
            groups.setdefault((row["effect"], key), []).append(row)
        for (effect, key), rows in groups.items():
            size = float(np.linalg.norm([r[truth] - r["neutral"] for r in rows]))
            if size < rows[0]["typical"] or size < SURE_SIGMA * max(r["bound_sd"] for r in rows):
                continue
            off = [_estimate(r) - r[truth] for r in rows]
            out.append(
                {
                    "world": score["world"],
                    "effect": effect,
                    "key": key,
                    "family": rows[0]["family"],
                    "error": float(np.linalg.norm(off)) / size,
                }
            )
    return out


def is_right(score: Mapping[str, Any]) -> bool:
    """Return whether a verdict is correct. Where nothing can be detected, it must name nothing for sure."""
    if score["class"] == "thin":
        return score["told"] and outcome(score) in THIN_GOOD
    wanted = {"none": "nothing-missing", "outside": "outside-library"}
    if score["class"] == "outside" and not score["detectable"]:
        return score["verdict"] != "traced"
    if score["class"] in wanted:
        return score["verdict"] == wanted[score["class"]]
    return bool(score["exact"])


def deviations(scores: Scores) -> dict[str, list[float]]:
    """Return errors of the parameters of correctly named effects, in reported sd, by family."""
    out: dict[str, list[float]] = {name: [] for name in FAMILIES}
    for score in scores:
        for row in score["parameters"]:
            if row["estimate"] is not None and row["sd"] > 0.0:
                out[row["family"]].append((row["estimate"] - row["true"]) / row["sd"])
    return out


def baseline_rows(scores: Scores) -> list[dict[str, Any]]:
    """Return the figures of tracing and of other methods on the same worlds; empty without other methods.

    `top1` (single effects), `pairs_exact` and `false_alarm` are shares and `n` their counts; for a method
    that names nothing, they are None and 0. `named_mean` is the mean number of effects named in worlds with
    effects, `after_mm_median` the error on held-out flights.
    """
    judged = [s for s in scores if s["baselines"]]
    methods = list(dict.fromkeys(name for s in judged for name in s["baselines"]))
    said = {TRACING: [_as_baseline(s) for s in judged]} if judged else {}
    said |= {name: [s["baselines"][name] for s in judged] for name in methods}
    classes = [s["class"] for s in judged]
    return [_baseline_row(name, list(zip(classes, found, strict=True))) for name, found in said.items()]


def _as_baseline(score: Mapping[str, Any]) -> dict[str, Any]:
    """Return the answer of tracing in the form of the other methods; every named effect counts."""
    alarm = ["something"] if score["verdict"] != "nothing-missing" else []
    return {
        "names": alarm if score["class"] == "none" else score["named"],
        "first_right": score["top1"],
        "exact": score["exact"],
        "after_m": score["after_m"],
    }


def _baseline_row(method: str, said: Sequence[tuple[str, Mapping[str, Any]]]) -> dict[str, Any]:
    naming = [(kind_class, one) for kind_class, one in said if one["names"] is not None]
    hits = {
        "top1": [one["first_right"] for kind_class, one in naming if kind_class == "single"],
        "pairs_exact": [one["exact"] for kind_class, one in naming if kind_class == "pair"],
        "false_alarm": [bool(one["names"]) for kind_class, one in naming if kind_class == "none"],
    }
    counts = [len(one["names"]) for kind_class, one in naming if kind_class in EFFECTS]
    errors = [1e3 * one["after_m"] for _, one in said if one["after_m"] is not None]
    return {
        "method": method,
        **{name: share(found) for name, found in hits.items()},
        "named_mean": mean(counts),
        "after_mm_median": quantile(errors, 0.5),
        "n": {name: len(found) for name, found in hits.items()},
    }


def confusion(scores: Scores) -> dict[str, dict[str, int]]:
    """Count worlds by the truth (a kind, a set of kinds, or nothing) and the effect named first.

    A verdict without names counts under its own name. Thin data are left out.
    """
    scores = [s for s in scores if s["class"] != "thin"]
    table: dict[str, dict[str, int]] = {}
    order = ("single", "outside", "pair", "triple", "none")
    for s in sorted(scores, key=lambda s: (order.index(s["class"]), s["kinds"])):
        row = {"none": "nothing", "pair": "a pair", "triple": "three effects"}.get(s["class"]) or s["kinds"][
            0
        ]
        column = "exact set" if s["class"] in EFFECTS[1:] and s["exact"] else _column(s)
        table.setdefault(row, {})
        table[row][column] = table[row].get(column, 0) + 1
    return table


def _column(score: Mapping[str, Any]) -> str:
    return score["named"][0] if score["verdict"] == "traced" and score["named"] else score["verdict"]


def _estimate(row: Mapping[str, Any]) -> float:
    return row["neutral"] if row["estimate"] is None else row["estimate"]


def _covers(row: Mapping[str, Any], truth: str) -> bool:
    return row["estimate"] is not None and abs(row["estimate"] - row[truth]) <= 2.0 * row["sd"]


def _millimetres(scores: Scores, key: str) -> float | None:
    value = quantile([s[key] for s in scores if s[key] is not None], 0.5)
    return None if value is None else 1e3 * value
