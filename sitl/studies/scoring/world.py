"""Score of one world: comparison of the verdict with the truth, which is opened after the verdict."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from trimtab.host.effects import Effect, load_effects
from trimtab.host.log import read_flight
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.parameters import space
from trimtab.host.vehicle import load_vehicle
from trimtab.sitl.kinds import KINDS
from trimtab.sitl.studies.files import Ledger, StudyError, read_json, sha256_of, write_json
from trimtab.sitl.studies.flights import FEW, FLIGHTS, PLAIN, SCORE, STILL, TRUTH, VERDICT, Programme
from trimtab.sitl.studies.scoring.brought import brought_effects
from trimtab.sitl.studies.scoring.detection import detection_rows
from trimtab.sitl.studies.scoring.effective import (
    Effective,
    effective,
    floor_m,
    is_identifiable,
    nearest,
    off_by,
)
from trimtab.sitl.studies.scoring.names import (
    Ratio,
    collapsed,
    effect_of,
    ordered,
    ratios,
    with_scored_names,
)
from trimtab.sitl.studies.scoring.outside import outside_sigma
from trimtab.sitl.studies.scoring.probabilities import probability_rows
from trimtab.sitl.studies.thin import CASES

INSIDE = ("single", "pair", "triple", "none")
"""Classes of worlds whose effects are all in the library and whose data suffice to compare numbers."""


def library() -> dict[str, Effect]:
    """Return the host's effect library by name."""
    return load_effects()


def open_truth(folder: Path, ledger: Ledger) -> dict[str, Any]:
    """Return the sealed truth of a world that has a verdict.

    Raises SealBroken if the truth differs from the ledger, StudyError if there is no verdict yet.
    """
    if not (folder / VERDICT).is_file():
        raise StudyError(f"world {folder.name}: its truth stays sealed until there is a verdict")
    ledger.check(folder.name, sha256_of(folder / TRUTH))
    return read_json(folder / TRUTH)


def score_world(folder: Path, ledger: Ledger, programme: Programme) -> dict[str, Any]:
    """Score the world unless that is done, and return the score. Raises the errors of `open_truth`."""
    if (folder / SCORE).is_file():
        return read_json(folder / SCORE)
    truth = open_truth(folder, ledger)
    verdict = read_json(folder / VERDICT)
    vehicle, effects = load_vehicle(truth["vehicle"]), library()
    chosen, drawn, deviations = space(vehicle, effects), truth["effects"], truth["deviations"]
    known = floor = sigma = None
    if truth["class"] != "thin":
        learning, held_out = (
            [read_flight(folder / FLIGHTS / log) for log in programme.logs(routes)]
            for routes in (programme.learning, programme.held_out)
        )
        still, plain = (
            [read_flight(log) for log in sorted((folder / place).glob("*.mcap"))] for place in (STILL, PLAIN)
        )
        if truth["class"] == "outside":
            sigma = outside_sigma(vehicle, chosen, deviations, still, plain, learning)
        elif drawn:
            known = effective(vehicle, chosen, drawn, deviations, still, learning)
        if truth["class"] in INSIDE:
            values = off_by(chosen, deviations) if known is None else known.values
            floor = floor_m(vehicle, effects, values, drawn, held_out)
    brought = brought_effects(truth, vehicle, chosen)

    def scored(given: Mapping[str, Any]) -> dict[str, Any]:
        return {**given, "answer": with_scored_names(given["answer"], drawn, effects)}

    separations = None if known is None else nearest(known)
    judged = judge(truth["kinds"], scored(verdict), separations, effects, brought)
    score = {
        "world": folder.name,
        "class": truth["class"],
        "kinds": truth["kinds"],
        "case": truth["case"],
        "plant": truth["plant"],
        "redrawn": truth["redrawn"],
        "drawn": truth["effects"],
        "true": {} if known is None else known.true(),
        "brought": sorted(brought),
        **judged,
        "outside_sigma": sigma,
        "detectable": None if sigma is None else sigma >= RULES.detectable_sigma,
        "detection": [] if known is None else detection_rows(truth, judged, known, effects),
        "parameters": parameter_rows(truth, verdict["answer"], known),
        "floor_m": floor,
        "told": None if truth["case"] is None else is_told(truth["case"], verdict),
        "few": {
            data: judge_few(truth["kinds"], scored(read_json(folder / file)), effects, brought)
            for data, file in FEW.items()
            if (folder / file).is_file()
        },
    }
    write_json(folder / SCORE, score)
    return score


def is_told(case: str, verdict: Mapping[str, Any]) -> bool:
    """Return whether the answer for thin data names the missing data."""
    answer = verdict["answer"]
    codes = {finding["code"] for finding in answer.get("findings", ())} | {answer.get("code")}
    return not codes.isdisjoint(CASES[case].codes)


def judge(
    kinds: Sequence[str],
    verdict: Mapping[str, Any],
    separations: Mapping[str, Mapping[str, float]] | None,
    effects: Mapping[str, Effect],
    brought: frozenset[str] = frozenset(),
) -> dict[str, Any]:
    """Compare the verdict with a world of effects `kinds`, and return the comparison as plain data.

    The names of the verdict are those of `with_scored_names`. `separations`, sigma, are of each true effect
    from each other candidate; None for worlds without an effect of the library, and for thin data and few
    flights. `brought`: see `brought_effects`. An undecided verdict on an identifiable world counts as a miss.
    If a verdict names nothing, its alias set is what it considers possible. The whole answer also contains
    what it considers possible beside the names.
    """

    def alike(names: Iterable[str]) -> frozenset[str]:
        return collapsed(names, kinds, effects, brought)

    answer = verdict["answer"]
    said = answer.get("verdict", "failed")
    named = [
        {**e, "neutral": dict(zip(effect.keys, effect.neutral, strict=True))}
        for e in answer.get("effects", ())
        for effect in (effects[effect_of(e["name"])],)
    ]
    first = ordered(named)
    names = alike(first)
    truth = alike(kinds)
    not_excluded = {p["name"] for p in answer.get("possible", ())}
    possible = set[str]() if named else not_excluded
    aliases = {a["name"] for e in named for a in e["aliases"]} | possible
    identifiable = None if separations is None else is_identifiable(separations)
    leading = collapsed(first[:1], kinds, effects)
    decided = said == "traced" or (said == "undecided" and not identifiable)
    sizes = [1 + len(alike(a["name"] for a in e["aliases"]) - alike([e["name"]])) for e in named]
    if possible:
        sizes = [len(alike(possible))]
    whole = alike({*first, *aliases, *not_excluded})
    before, after = answer.get("before") or {}, answer.get("after") or {}
    return {
        "exit_code": verdict["exit_code"],
        "errors": verdict["errors"][-500:] if verdict["exit_code"] else "",
        "verdict": said,
        "named": first,
        "first": (sorted(leading) or [None])[0],
        "aliases": sorted(aliases),
        "reasons": answer.get("reasons", []),
        "identifiable": identifiable,
        "separation": separations,
        "wrong": said == "traced" and not names <= truth,
        "false_names": [n for n in first if alike([n]) & (names - truth)] if said == "traced" else [],
        "top1": bool(first) and leading <= truth and decided,
        "exact": bool(first) and names == truth and decided,
        "in_alias": bool(kinds) and truth <= alike({*first, *aliases}),
        "alias_sizes": sizes,
        "in_answer": bool(kinds) and truth <= whole,
        "answer_size": len(whole),
        "probabilities": probability_rows(answer, kinds, effects, brought),
        "before_m": before.get("position_rmse_m"),
        "after_m": after.get("position_rmse_m"),
        "trace_s": verdict["trace_s"],
    }


def judge_few(
    kinds: Sequence[str],
    verdict: Mapping[str, Any],
    effects: Mapping[str, Effect],
    brought: frozenset[str],
) -> dict[str, Any]:
    """Compare a verdict on few flights with the world, as `judge` does, without what needs all flights."""
    judged = judge(kinds, verdict, None, effects, brought)
    keys = ("exit_code", "errors", "verdict", "named", "wrong", "probabilities", "trace_s")
    return {key: judged[key] for key in keys}


def parameter_rows(
    truth: Mapping[str, Any], answer: Mapping[str, Any], known: Effective | None
) -> list[dict[str, Any]]:
    """Return a row with truth, estimate, sd, bound and typical size for each parameter of each named effect.

    Only true effects count. `true` is the effective value, `drawn` the one that the plant has. For exact
    aliases (mass and thrust gain), the row is their observable ratio. A parameter off neutral that is not
    among the named keys (another rotor) has no estimate.
    """
    found = {e["name"]: e["parameters"] for e in answer.get("effects", ())}
    if known is None:
        return []
    rows, effects = [], known.space.effects
    of_ratio = {name: ratio for ratio in ratios(effects) for name in ratio.alike}
    for name, values in known.true().items():
        if name in of_ratio:
            rows += _ratio_row(truth, name, of_ratio[name], found, known)
            continue
        if name not in found:
            continue
        over = effects[name].observed_relative_to
        relative_to = relative_to_drawn = 1.0
        if over is not None:
            (key, *_) = effects[over].keys
            relative_to, relative_to_drawn = known.values[over][key], _as_drawn(truth, known, over, key)
        for i in known.space.owners[name]:
            column = known.space.columns[i]
            if truth["effects"][name].get(column.key, column.neutral) == column.neutral:
                continue
            estimate = found[name].get(column.key)
            rows.append(
                {
                    "effect": name,
                    "key": column.key,
                    "family": effects[name].family,
                    "turned": KINDS[name].spread == "turned",
                    "true": values[column.key] / relative_to,
                    "drawn": _as_drawn(truth, known, name, column.key) / relative_to_drawn,
                    "estimate": None if estimate is None else estimate["value"],
                    "sd": None if estimate is None else estimate["sd"],
                    "bound_sd": known.bound_sd(name, column.key),
                    "neutral": column.neutral,
                    "typical": column.scale,
                }
            )
    return rows


def _as_drawn(truth: Mapping[str, Any], known: Effective, owner: str, key: str) -> float:
    """Return the value that a parameter was drawn with: that of the effect, else that of the build."""
    if owner in truth["effects"]:
        return truth["effects"][owner][key]
    (neutral,) = (c.neutral for c in known.space.columns if (c.owner, c.key) == (owner, key))
    return neutral + truth["deviations"].get(f"{owner}.{key}", 0.0)


def _ratio_row(
    truth: Mapping[str, Any], name: str, ratio: Ratio, found: Mapping[str, Any], known: Effective
) -> list[dict[str, Any]]:
    """Return the row of a ratio if either effect was named, to first order in the standard deviations."""
    if not ratio.alike & set(found):
        return []
    over, under = (
        found.get(e.name, {}).get(e.keys[0], {"value": e.neutral[0], "sd": 0.0})
        for e in (ratio.over, ratio.under)
    )
    true_over, true_under = (known.values[e.name][e.keys[0]] for e in (ratio.over, ratio.under))
    drawn_over, drawn_under = (_as_drawn(truth, known, e.name, e.keys[0]) for e in (ratio.over, ratio.under))
    estimate = over["value"] / under["value"]
    share = ((over["sd"] / over["value"]) ** 2 + (under["sd"] / under["value"]) ** 2) ** 0.5
    key, *_ = known.true()[name]
    return [
        {
            "effect": name,
            "key": ratio.name,
            "family": known.space.effects[name].family,
            "turned": False,
            "true": true_over / true_under,
            "drawn": drawn_over / drawn_under,
            "estimate": estimate,
            "sd": estimate * share,
            "bound_sd": known.bound_sd(name, key),
            "neutral": ratio.over.neutral[0] / ratio.under.neutral[0],
            "typical": known.space.columns[known.space.owners[name][0]].scale,
        }
    ]
