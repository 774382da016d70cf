"""Which effects were found, by their size and by their kind."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

from trimtab.host.effects import Effect
from trimtab.sitl.kinds import KINDS
from trimtab.sitl.studies.scoring.counts import interval, share
from trimtab.sitl.studies.scoring.effective import Effective
from trimtab.sitl.studies.scoring.names import collapsed, effect_of

SIZES = ("sigma", "tolerances")
"""Measures of the size of an effect: separation from its closest alias, and distance from neutral."""

EDGES = (0.0, 2.0, 4.2, 8.0, 16.0, 32.0, 64.0, float("inf"))
"""Edges of the rows of the detection curves, in sigma and in tolerances."""

Rows = Sequence[Mapping[str, Any]]


def detection_rows(
    truth: Mapping[str, Any], verdict: Mapping[str, Any], known: Effective, effects: Mapping[str, Effect]
) -> list[dict[str, Any]]:
    """Return name, both sizes, and whether it was found, for each effect of a world in the library.

    `verdict` is the result of `judge`. An effect is found if the verdict is `traced` and names it. Its size
    in tolerances is that of its drawn values; places and lengths do not count.
    """
    kinds, names = truth["kinds"], verdict["named"] if verdict["verdict"] == "traced" else ()
    named = collapsed(names, kinds, effects)
    return [
        {
            "effect": name,
            "sigma": min(verdict["separation"][name].values()),
            "tolerances": _tolerances(known, name, truth["effects"][name]),
            "found": collapsed([name], kinds, effects) <= named,
        }
        for name in known.candidates
    ]


def _tolerances(known: Effective, name: str, drawn: Mapping[str, float]) -> float:
    """Return the distance of drawn values from neutral, in tolerances."""
    sizes = {q.key for q in KINDS[name].quantities if q.drawn is None}
    columns = [known.space.columns[i] for i in known.space.owners[name]]
    return (
        sum(
            ((drawn.get(column.key, column.neutral) - column.neutral) / column.tolerance) ** 2
            for column in columns
            if column.key in sizes
        )
        ** 0.5
    )


def detection_curves(scores: Rows) -> dict[str, dict[str, Any]]:
    """Return the share of effects found by size, for each measure of SIZES: in total and by kind.

    A row has its edges, count, share and exact interval; the last one has no upper edge. Empty rows are left
    out.
    """
    rows = [row for score in scores for row in score["detection"]]
    kinds = sorted({row["effect"] for row in rows})
    return {
        size: {
            "total": _curve(rows, size),
            "kinds": {kind: _curve([row for row in rows if row["effect"] == kind], size) for kind in kinds},
        }
        for size in SIZES
    }


def _curve(rows: Rows, size: str) -> list[dict[str, Any]]:
    return [
        {
            "low": low,
            "high": None if high == EDGES[-1] else high,
            "n": len(found),
            "found": share(found),
            "interval": interval(found),
        }
        for low, high in pairwise(EDGES)
        if (found := [row["found"] for row in rows if low <= row[size] < high])
    ]


def by_kind(scores: Rows) -> dict[str, dict[str, Any]]:
    """Return counts for each kind of the library in the worlds: single effects, all effects, false names.

    `false` counts worlds in which the verdict is `traced` and names the kind, which is absent. Names of exact
    aliases count for the kind that is true.
    """
    inside = [s for s in scores if s["class"] != "thin"]
    kinds = {effect_of(name) for s in inside for name in (*s["named"], *s["kinds"])}
    kinds = sorted(kind for kind in kinds if not KINDS[kind].outside)
    return {kind: _inside_kind(kind, inside) for kind in kinds}


def _inside_kind(kind: str, scores: Rows) -> dict[str, Any]:
    singles = [s for s in scores if s["class"] == "single" and s["kinds"] == [kind]]
    rows = [row for s in scores for row in s["detection"] if row["effect"] == kind]
    return {
        "singles": len(singles),
        "exact": sum(s["exact"] for s in singles),
        "identifiable": sum(bool(s["identifiable"]) for s in singles),
        "exact_identifiable": sum(s["exact"] for s in singles if s["identifiable"]),
        "all": len(rows),
        "found": sum(row["found"] for row in rows),
        "false": sum(kind in map(effect_of, s["false_names"]) for s in scores),
    }


def by_outside_kind(scores: Rows) -> dict[str, dict[str, int]]:
    """Return counts for each kind outside the library: worlds, detectable ones, verdicts, false names."""
    outside = [s for s in scores if s["class"] == "outside"]

    def count(kind: str, holds: Callable[[Mapping[str, Any]], bool]) -> int:
        return sum(holds(s) for s in outside if s["kinds"] == [kind])

    return {
        kind: {
            "worlds": count(kind, lambda s: True),
            "detectable": count(kind, lambda s: s["detectable"]),
            "abstained_detectable": count(kind, lambda s: s["detectable"] and _abstained(s)),
            "abstained_rest": count(kind, lambda s: not s["detectable"] and _abstained(s)),
            "false": count(kind, lambda s: s["wrong"]),
        }
        for kind in sorted({s["kinds"][0] for s in outside})
    }


def _abstained(score: Mapping[str, Any]) -> bool:
    return score["verdict"] == "outside-library"
