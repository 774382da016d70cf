"""Calibration of the probabilities that verdicts give to effects: how often such an effect is there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from trimtab.host.effects import Effect
from trimtab.sitl.studies.flights import FEW
from trimtab.sitl.studies.scoring.counts import interval, mean, share
from trimtab.sitl.studies.scoring.names import collapsed, ratios

SURE = 0.95
"""Probability from which on an effect counts as given for sure."""

EDGES = (0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99, 0.999, 1.0)
"""Edges of the rows of the reliability diagram. A row includes its upper edge, and SURE its row above."""

FULL_SET, OUTSIDE, THIN_DATA = "full set", "outside the library", "thin data"
DATA = (*FEW, FULL_SET, OUTSIDE, THIN_DATA)
"""What was traced: one flight, one pair of repeat flights, or all flights of worlds inside the library, all
flights of worlds outside it, or incomplete data.
"""

Rows = Sequence[Mapping[str, Any]]


def probability_rows(
    answer: Mapping[str, Any],
    kinds: Sequence[str],
    effects: Mapping[str, Effect],
    brought: frozenset[str] = frozenset(),
) -> list[dict[str, Any]]:
    """Return name, probability, and whether it is there, for each named and each possible effect.

    Exact aliases count as one effect, with the greater probability. If mass or thrust gain is true, an
    inertia beside the alias is neither right nor wrong, and has no row. A named inertia is so only beside a
    named alias. Nor has an effect a row that is `brought`.
    """
    named, possible = (
        {each["name"]: each["probability"] for each in answer.get(key, ())} for key in ("effects", "possible")
    )
    counted = {name: collapsed(named, kinds, effects, brought) for name in named}
    counted |= {name: collapsed([*named, *possible], kinds, effects, brought) for name in possible}
    truth = collapsed(kinds, kinds, effects)
    merged = {name: ratio.name for ratio in ratios(effects) for name in ratio.alike}
    probability: dict[str, float] = {}
    for name, p in (possible | named).items():
        known_as = merged.get(name, name)
        if known_as in counted[name]:
            probability[known_as] = max(p, probability.get(known_as, 0.0))
    return [{"name": name, "probability": p, "there": name in truth} for name, p in probability.items()]


def calibration(scores: Rows) -> dict[str, dict[str, Any]]:
    """Return the calibration of all probabilities by kind of data, see `calibration_of`."""
    groups: dict[str, list[Mapping[str, Any]]] = {data: [] for data in DATA}
    for score in scores:
        groups[data_of(score)].append(score)
        for few, answer in score["few"].items():
            groups[few].append(answer)
    return {data: _of_answers(answers) for data, answers in groups.items()}


def _of_answers(answers: Rows) -> dict[str, Any]:
    """Return the calibration of answers, and the share with a false name: of all, and of those traced."""
    wrong = [answer["wrong"] for answer in answers]
    traced = [answer["wrong"] for answer in answers if answer["verdict"] == "traced"]
    return {
        "worlds": len(wrong),
        "false_names": share(wrong),
        "false_names_interval": interval(wrong),
        "traced": len(traced),
        "false_names_of_traced": share(traced),
        "false_names_of_traced_interval": interval(traced),
        **calibration_of([row for answer in answers for row in answer["probabilities"]]),
    }


def data_of(score: Mapping[str, Any]) -> str:
    """Return the kind of data, of DATA, that the verdict on all flights of a world counts in."""
    return {"thin": THIN_DATA, "outside": OUTSIDE}.get(score["class"], FULL_SET)


def calibration_of(rows: Rows) -> dict[str, Any]:
    """Return the calibration of probabilities: `n`, `sure`, `brier`, and `bins` of the reliability diagram.

    `sure` counts the effects given at least SURE. A bin has its edges, count, mean probability, and the
    share that is there. Empty bins are left out.
    """
    sure = [row["there"] for row in rows if row["probability"] >= SURE]
    return {
        "n": len(rows),
        "sure": share(sure),
        "sure_n": len(sure),
        "sure_interval": interval(sure),
        "brier": mean([(row["probability"] - row["there"]) ** 2 for row in rows]),
        "bins": [
            {
                "low": low,
                "high": high,
                "n": len(inside),
                "mean": mean([row["probability"] for row in inside]),
                "there": share([row["there"] for row in inside]),
                "interval": interval([row["there"] for row in inside]),
            }
            for low, high in pairwise(EDGES)
            if (inside := [row for row in rows if _is_in(row["probability"], low, high)])
        ],
    }


def _is_in(probability: float, low: float, high: float) -> bool:
    """Return whether a bin holds the probability. Exactly 0 and exactly SURE belong to the bin above."""
    above = probability >= low if low in (0.0, SURE) else probability > low
    below = probability < high if high == SURE else probability <= high
    return above and below
