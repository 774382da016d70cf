"""The score of one world: its truth, opened once the verdict is a file, against that verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from host.effects import Effect, load_effects
from host.log import read_flight
from host.trace.parameters import Space, space
from host.vehicle import load_vehicle
from sitl.kinds import KINDS
from sitl.studies.files import Ledger, StudyError, read_json, sha256_of, write_json
from sitl.studies.flights import SCORE, TRUTH, VERDICT, Programme
from sitl.studies.scoring.bounds import Bounds, bounds, floor_m
from sitl.studies.scoring.effective import Values, effective
from sitl.studies.scoring.names import RATIO, collapsed, family, ordered
from sitl.studies.thin import CASES
from sitl.studies.worlds import SAME_RATIO

NAMING = ("traced", "undecided")
"""Verdicts that name effects."""

INSIDE = ("single", "pair", "none")
"""Classes of worlds in which the host has a form of everything, and enough data to hold numbers against."""


def library() -> dict[str, Effect]:
    """The effects that the host has a form of, by name."""
    return load_effects()


def open_truth(folder: Path, ledger: Ledger) -> dict[str, Any]:
    """The truth of a world whose verdict is a file, as it was sealed.

    Raises SealBroken where it is not what the ledger holds, StudyError where there is no verdict yet.
    """
    if not (folder / VERDICT).is_file():
        raise StudyError(f"world {folder.name}: its truth stays sealed until there is a verdict")
    ledger.check(folder.name, sha256_of(folder / TRUTH))
    return read_json(folder / TRUTH)


def score_world(folder: Path, ledger: Ledger, programme: Programme) -> dict[str, Any]:
    """The world's score, made once and kept as a file. Raises as `open_truth` does."""
    if (folder / SCORE).is_file():
        return read_json(folder / SCORE)
    truth = open_truth(folder, ledger)
    verdict = read_json(folder / VERDICT)
    vehicle, effects = load_vehicle(truth["vehicle"]), library()
    chosen = space(vehicle, effects)
    within = truth["class"] in INSIDE
    true: Values = {}
    known = floor = None
    if within:
        flights = [read_flight(folder / "flights" / log) for log in programme.logs(programme.learning)]
        held_out = [read_flight(folder / "flights" / log) for log in programme.logs(programme.held_out)]
        true = effective(vehicle, truth["effects"], chosen, flights)
        known = bounds(vehicle, chosen, true, flights, SAME_RATIO) if true else None
        floor = floor_m(vehicle, chosen, effects, true, truth["deviations"], held_out)
    score = {
        "world": folder.name,
        "class": truth["class"],
        "kinds": truth["kinds"],
        "case": truth["case"],
        "drawn": truth["effects"],
        "true": true,
        **judge(truth["kinds"], verdict, known, effects),
        "parameters": parameter_rows(truth, true, verdict["answer"], known, chosen),
        "floor_m": floor,
        "told": None if truth["case"] is None else is_told(truth["case"], verdict),
    }
    write_json(folder / SCORE, score)
    return score


def is_told(case: str, verdict: Mapping[str, Any]) -> bool:
    """Whether the answer on thin data says what they lack."""
    answer = verdict["answer"]
    said = [verdict["errors"], *answer.get("doubts", ())]
    said += [remark for audit in answer.get("audit", ()) for remark in audit["remarks"]]
    return any(words in line for words in CASES[case].says for line in said)


def judge(
    kinds: Sequence[str], verdict: Mapping[str, Any], known: Bounds | None, effects: Mapping[str, Effect]
) -> dict[str, Any]:
    """What the verdict says of a world that holds `kinds`, as plain data.

    `known` is None where the world holds nothing of the library. An undecided verdict on an identifiable
    world misses.
    """
    answer = verdict["answer"]
    said = answer.get("verdict", "failed")
    named = [
        {**e, "neutral": dict(zip(effects[e["name"]].keys, effects[e["name"]].neutral, strict=True))}
        for e in answer.get("effects", ())
    ]
    first = ordered(named)
    names = collapsed(first, kinds)
    truth = collapsed(kinds, kinds)
    aliases = {a["name"] for e in named for a in e["aliases"]}
    identifiable = None if known is None else known.identifiable
    right = set(first[:1]) <= set(kinds) or collapsed(first[:1], kinds) <= truth
    decided = said == "traced" or (said == "undecided" and not identifiable)
    sizes = [
        1 + len(collapsed((a["name"] for a in e["aliases"]), kinds) - collapsed([e["name"]], kinds))
        for e in named
    ]
    before, after = answer.get("before") or {}, answer.get("after") or {}
    return {
        "exit_code": verdict["exit_code"],
        "errors": verdict["errors"][-500:] if verdict["exit_code"] else "",
        "verdict": said,
        "named": first,
        "first": (sorted(collapsed(first[:1], kinds)) or [None])[0],
        "aliases": sorted(aliases),
        "reasons": answer.get("reasons", []),
        "identifiable": identifiable,
        "separation": None if known is None else {k: dict(v) for k, v in known.separation.items()},
        "wrong": said == "traced" and not names <= truth,
        "top1": bool(first) and right and decided,
        "exact": bool(first) and names == truth and decided,
        "in_alias": bool(kinds) and truth <= collapsed({*first, *aliases}, kinds),
        "alias_sizes": sizes,
        "before_m": before.get("position_rmse_m"),
        "after_m": after.get("position_rmse_m"),
        "trace_s": verdict["trace_s"],
    }


def parameter_rows(
    truth: Mapping[str, Any],
    true: Values,
    answer: Mapping[str, Any],
    known: Bounds | None,
    chosen: Space,
) -> list[dict[str, Any]]:
    """A row for each parameter of each true effect that was named: truth, estimate, sd, bound, typical size.

    Of mass and thrust gain the row is their observable ratio. A parameter that was drawn off neutral and is
    not among the named one's keys (another rotor) has no estimate.
    """
    found = {e["name"]: e["parameters"] for e in answer.get("effects", ())}
    if known is None:
        return []
    rows = []
    for name, values in true.items():
        if name in ("mass", "thrust-gain"):
            rows += _ratio_row(name, truth, true, found, known, chosen)
            continue
        if name not in found:
            continue
        gain = _gain(truth, true) if name == "inertia" else 1.0
        for i in chosen.owners[name]:
            column = chosen.columns[i]
            if truth["effects"][name].get(column.key, column.neutral) == column.neutral:
                continue
            estimate = found[name].get(column.key)
            rows.append(
                {
                    "effect": name,
                    "key": column.key,
                    "family": family(name),
                    "turned": KINDS[name].spread == "turned",
                    "true": values[column.key] / gain,
                    "estimate": None if estimate is None else estimate["value"],
                    "sd": None if estimate is None else estimate["sd"],
                    "bound_sd": known.sd[name][column.key],
                    "neutral": column.neutral,
                    "typical": column.scale,
                }
            )
    return rows


def _gain(truth: Mapping[str, Any], true: Values) -> float:
    """The thrust gain that the vehicle flies with."""
    return _factor("thrust-gain", "gain", truth, true)


def _factor(name: str, key: str, truth: Mapping[str, Any], true: Values) -> float:
    """A factor of the vehicle: the effect's, else 1 and what the build is off by."""
    return true[name][key] if name in true else 1.0 + truth["deviations"].get(f"{name}.{key}", 0.0)


def _ratio_row(
    name: str,
    truth: Mapping[str, Any],
    true: Values,
    found: Mapping[str, Any],
    known: Bounds,
    chosen: Space,
) -> list[dict[str, Any]]:
    """The row of thrust over mass where either was named, to first order in the standard deviations."""
    if not {"mass", "thrust-gain"} & set(found):
        return []
    mass = _factor("mass", "factor", truth, true)
    gain = found.get("thrust-gain", {}).get("gain", {"value": 1.0, "sd": 0.0})
    factor = found.get("mass", {}).get("factor", {"value": 1.0, "sd": 0.0})
    ratio = gain["value"] / factor["value"]
    share = ((gain["sd"] / gain["value"]) ** 2 + (factor["sd"] / factor["value"]) ** 2) ** 0.5
    (bound,) = known.sd[name].values()
    return [
        {
            "effect": name,
            "key": RATIO,
            "family": family(name),
            "turned": False,
            "true": _gain(truth, true) / mass,
            "estimate": ratio,
            "sd": ratio * share,
            "bound_sd": bound,
            "neutral": 1.0,
            "typical": chosen.columns[chosen.owners[name][0]].scale,
        }
    ]
