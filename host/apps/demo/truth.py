"""The sealed truth of a demo beside its verdict. It is opened only after the verdict is a file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trimtab.host.apps.demo.files import JSON_NAME
from trimtab.host.effects import Effect
from trimtab.host.link.simulated import TRUTH_SUFFIX


@dataclass(frozen=True, kw_only=True)
class Row:
    """A parameter of an effect that the world holds or the verdict names.

    true: None if the world does not hold the effect. found, sd: None if the verdict does not name it.
    """

    effect: str
    key: str
    unit: str
    true: float | None
    found: float | None
    sd: float | None

    @property
    def sigmas(self) -> float | None:
        """Found minus true in standard deviations of the found value; None where one is missing."""
        if self.true is None or self.found is None or not self.sd:
            return None
        return (self.found - self.true) / self.sd


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """What of a verdict is true.

    Attributes
    ----------
    verdict
        As of tracing.
    found, missed
        Effects of the world that are named, also by an exact alias, and that are not.
    invented
        Named effects that the world does not hold.
    outside
        Effects of the world that the library does not hold.
    """

    verdict: str
    found: tuple[str, ...]
    missed: tuple[str, ...]
    invented: tuple[str, ...]
    outside: tuple[str, ...]
    rows: tuple[Row, ...]

    @property
    def is_right(self) -> bool:
        """Whether the verdict is the one that the world asks for."""
        if self.outside:
            return self.verdict == "outside-library"
        if not (self.found or self.missed):
            return self.verdict == "nothing-missing"
        return self.verdict == "traced" and not self.missed and not self.invented


def open_truth(folder: Path, log: str, log_id: str) -> dict[str, Any]:
    """Return the sealed truth of a flight of a demo with a verdict, from the file beside its log.

    Raises ValueError if there is no verdict file yet, or if the truth is that of another log.
    """
    if not (folder / JSON_NAME).is_file():
        raise ValueError(f"{folder}: the truth stays sealed until {JSON_NAME} is written")
    truth = json.loads((folder / f"{log}{TRUTH_SUFFIX}").read_text(encoding="utf-8"))
    if truth["log"] != log_id:
        raise ValueError(f"{folder / log}: the truth beside it is of log {truth['log']}, not {log_id}")
    return truth


def judge(
    answer: Mapping[str, Any], true: Mapping[str, Mapping[str, float]], effects: Mapping[str, Effect]
) -> Judgement:
    """Compare the answer of a trace with the effects that a world holds, by name and key."""
    named = {effect["name"]: effect["parameters"] for effect in answer["effects"]}
    met = {name: _meant(name, true, effects) for name in named}
    found = set().union(*met.values()) if met else set[str]()
    return Judgement(
        verdict=answer["verdict"],
        found=tuple(name for name in true if name in found),
        missed=tuple(name for name in true if name not in found),
        invented=tuple(name for name in named if not met[name]),
        outside=tuple(name for name in true if name not in effects),
        rows=tuple(
            row for name in dict.fromkeys([*true, *named]) for row in _rows(name, true, named, effects)
        ),
    )


def _meant(name: str, true: Mapping[str, object], effects: Mapping[str, Effect]) -> set[str]:
    """Return the effects of the world that a named effect states: itself, or what no flight distinguishes.

    Thrust, mass and inertia show in two ratios only: beside a true mass, an inertia is the same statement.
    """
    if name in true:
        return {name}
    alike = _aliases(name, effects)
    relative = effects[name].observed_relative_to
    if relative is not None:
        alike |= {relative} | _aliases(relative, effects)
    return alike & set(true)


def _aliases(name: str, effects: Mapping[str, Effect]) -> set[str]:
    """Return the exact aliases of an effect, whichever of the two states them."""
    stated = {alias.effect for alias in effects[name].exact_aliases}
    return stated | {
        other.name for other in effects.values() if name in {alias.effect for alias in other.exact_aliases}
    }


def _rows(
    name: str,
    true: Mapping[str, Mapping[str, float]],
    named: Mapping[str, Mapping[str, Mapping[str, Any]]],
    effects: Mapping[str, Effect],
) -> list[Row]:
    """Return a row for each parameter of an effect."""
    units = {p.key: p.unit for p in effects[name].parameters} if name in effects else {}
    drawn, values = true.get(name, {}), named.get(name, {})
    return [
        Row(
            effect=name,
            key=key,
            unit=units.get(key, ""),
            true=drawn.get(key),
            found=values[key]["value"] if key in values else None,
            sd=values[key]["sd"] if key in values else None,
        )
        for key in dict.fromkeys([*drawn, *values])
    ]


def judgement_words(judgement: Judgement) -> str:
    """Return a sentence on the verdict."""
    if judgement.is_right:
        names = ", ".join(judgement.found)
        return (
            f"The verdict is right: {names} exist, and no other effect was named."
            if names
            else ("The verdict is right: the world holds no effect of the library.")
        )
    parts = [
        f"{what}: {', '.join(names)}"
        for what, names in (
            ("found", judgement.found),
            ("missed", judgement.missed),
            ("invented", judgement.invented),
            ("not in the library", judgement.outside),
        )
        if names
    ]
    decided = "undecided" if judgement.verdict == "undecided" else "not right"
    return f"The verdict is {decided}. " + (f"{'; '.join(parts)}." if parts else "The world holds no effect.")
