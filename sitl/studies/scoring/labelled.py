"""Score of verdicts on recorded flights against their labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from trimtab.host.vehicle import ConfigurationError
from trimtab.sitl.studies.recorded import Group
from trimtab.sitl.studies.scoring.counts import interval, share
from trimtab.sitl.studies.scoring.names import effect_of
from trimtab.sitl.studies.scoring.world import library

SHARES = ("exact", "exact_names", "in_alias", "false_name")
Sets = Sequence[Sequence[str]]


def check_expected(groups: Sequence[Group], source: str) -> None:
    """Raise ConfigurationError for an expected effect that the library does not hold."""
    known = library()
    problems = [
        f"{source}: {group.name}: expected: no effect called {name}; known: {', '.join(known)}"
        for group in groups
        for names in group.expected
        for name in names
        if name not in known
    ]
    if problems:
        raise ConfigurationError(problems)


def score_row(row: Mapping[str, Any], expected: Sets) -> dict[str, Any]:
    """Return the score of a group's row (`real_row`) against the sets of effects that are right.

    `exact`, `exact_names` and `in_alias` are None if no set names an effect. `false_name` is None unless the
    empty set is the only right one and there is a verdict. If a verdict names nothing, its alias set is what
    it considers possible.
    """
    named = {effect["name"] for effect in row["effects"]}
    aliases = {alias["name"] for effect in row["effects"] for alias in effect["aliases"]}
    alias_set = named | aliases if named else set(map(effect_of, row["possible"]))
    right = [set(names) for names in expected]
    causes = [names for names in right if names]
    same = named in right and row["verdict"] != "failed"
    return {
        "expected": [list(names) for names in expected],
        "exact": row["verdict"] == "traced" and same if causes else None,
        "exact_names": same if causes else None,
        "in_alias": any(names <= alias_set for names in causes) if causes else None,
        "false_name": bool(named) if right and not causes and row["verdict"] != "failed" else None,
    }


def summary(scores: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the figures of a study from its scored rows, by JSON key; None if nothing was counted.

    `n` and `interval` have the keys of the shares. `confusion` counts answers by label: the names, or the
    verdict if nothing is named.
    """
    counted = {key: [row[key] for row in scores if row[key] is not None] for key in SHARES}
    confusion: dict[str, dict[str, int]] = {}
    for row in scores:
        if row["label"] is not None:
            answers = confusion.setdefault(row["label"], {})
            answer = " + ".join(sorted(effect["name"] for effect in row["effects"])) or row["verdict"]
            answers[answer] = answers.get(answer, 0) + 1
    return {
        **{key: share(found) for key, found in counted.items()},
        "failed": sum(row["verdict"] == "failed" for row in scores),
        "n": {**{key: len(found) for key, found in counted.items()}, "groups": len(scores)},
        "interval": {key: interval(found) for key, found in counted.items()},
        "confusion": confusion,
    }
