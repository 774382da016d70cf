"""The paper's claims about controllers and trajectories, tested on the balanced design."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trimtab.host.apps.paper.controllers.statistics import FAILED_M, Effect, effect, error_m, holm
from trimtab.host.apps.paper.controllers.table import (
    BASELINE,
    FAMILIES,
    FEEDFORWARD,
    MIN_RESIDUAL,
    MIN_RESIDUAL_STAR,
    MIN_SNAP,
    REGRESSORS,
    SETS,
    TRAJECTORIES,
    Family,
    Regressor,
    Set,
)

Key = tuple[str, str]
"""Controller and trajectory."""
WORDS: Mapping[str, str] = {
    "neural-best-mpc": "Neural has the least error of the MPCs",
    "neural-better-than-neural-c": "Neural has less error than Neural-C",
    "feedforward-helps": "the DFBC has less error with neural feed-forward",
    "star-lifts-all": "every controller has less error on Min-Residual* than on Min-Snap",
    "star-makes-alike": "controllers differ less on Min-Residual* than on Min-Snap",
    "star-better-than-plain": "Min-Residual* has less error than Min-Residual",
    "baseline-beats-feedforward": "baseline on Min-Residual has less error than Neural on Min-Snap",
}
"""Each claim by its code."""
_RIVALS = ("mpc", "mpc-l1", "mpc-neural-c")
"""The MPCs of the paper other than Neural."""


@dataclass(frozen=True, kw_only=True)
class Cell:
    """The errors of one cell, m, by controller and trajectory.

    anchors_m: of the baseline, by trajectory, where it is not in the set. steps_ms: median processor time of
    a control step of the controllers on the host.
    """

    place: tuple[int, int]
    speed: str
    flown: Set
    errors_m: Mapping[Key, float]
    anchors_m: Mapping[str, float]
    steps_ms: Mapping[Key, float]

    @property
    def baseline_m(self) -> float:
        """Error of the baseline on min-snap."""
        return self.baseline(MIN_SNAP)

    def baseline(self, trajectory: str) -> float:
        """Return the error of the baseline on a trajectory that it flies in every cell."""
        if trajectory in self.anchors_m:
            return self.anchors_m[trajectory]
        return self.errors_m[BASELINE.name, trajectory]


def cells_of(results: Sequence[Mapping[str, Any]]) -> list[Cell]:
    """Return the cells of the pieces of the balanced design."""
    found = []
    for result in results:
        for speed in dict.fromkeys(row["speed"] for row in result["rows"]):
            rows = [row for row in result["rows"] if row["speed"] == speed]
            flown = next(
                each
                for each in SETS
                if (each.family, each.regressor) == (rows[0]["family"], rows[0]["regressor"])
            )
            found.append(
                Cell(
                    place=(result["world"], result["course"]),
                    speed=speed,
                    flown=flown,
                    errors_m={
                        (row["controller"], row["trajectory"]): error_m(row)
                        for row in rows
                        if not row["anchor"]
                    },
                    anchors_m={row["trajectory"]: error_m(row) for row in rows if row["anchor"]},
                    steps_ms={
                        (row["controller"], row["trajectory"]): row["step_ms_p50"]
                        for row in rows
                        if "step_ms_p50" in row
                    },
                )
            )
    return found


def over_courses(cells: Sequence[Cell], ratios: Callable[[Cell], Sequence[float]]) -> Effect:
    """Return the effect of the ratios that each cell gives."""
    by_course: dict[tuple[int, int], list[float]] = {}
    for cell in cells:
        by_course.setdefault(cell.place, []).extend(ratios(cell))
    return effect(by_course)


def compare(cells: Sequence[Cell], one: Key, other: Key) -> Effect:
    """Return the effect of flying `one` instead of `other` in the same cell."""
    return over_courses(cells, lambda cell: [cell.errors_m[one] / cell.errors_m[other]])


def spread_ratio(cell: Cell) -> float:
    """Return the spread of the controllers on min-residual* over that on min-snap.

    The spread is the standard deviation of the logarithm of the error. With a failure it counts as greatest.
    """
    spreads, failed = [], []
    for trajectory in (MIN_RESIDUAL_STAR, MIN_SNAP):
        errors = [error for (_, flown), error in cell.errors_m.items() if flown == trajectory]
        spreads.append(float(np.std(np.log(errors))))
        failed.append(max(errors) >= FAILED_M)
    if any(failed):
        return FAILED_M ** (failed[0] - failed[1])
    return spreads[0] / spreads[1]


def claims(cells: Sequence[Cell]) -> list[dict[str, Any]]:
    """Return a row for each claim, regressor and family.

    A claim of several comparisons has the effect of the weakest one, and is confirmed if all of them are. An
    effect is a ratio of errors, below 1 where the claim holds; that of star-makes-alike is a ratio of the
    spreads.
    """
    rows = []
    for regressor in REGRESSORS:
        for family in FAMILIES:
            chosen = [c for c in cells if (c.flown.family, c.flown.regressor) == (family, regressor)]
            for claim, effects in _of_set(chosen, family, regressor).items():
                rows.append(_row(claim, regressor, family, effects))
    corrected = holm([row["p"] for row in rows])
    return [row | {"p_holm": p} for row, p in zip(rows, corrected, strict=True)]


def _of_set(cells: Sequence[Cell], family: Family, regressor: Regressor) -> dict[str, list[Effect]]:
    """Return the comparisons of each claim that a set tests."""
    names = [each.name for each in Set(family=family, regressor=regressor).controllers]
    found: dict[str, list[Effect]] = {}
    if family == "mpc":
        against = [on_all(cells, "mpc-neural", rival) for rival in _RIVALS]
        found["neural-best-mpc"] = against
        found["neural-better-than-neural-c"] = [against[_RIVALS.index("mpc-neural-c")]]
    else:
        found["feedforward-helps"] = [on_all(cells, FEEDFORWARD.name, BASELINE.name)]
        found["baseline-beats-feedforward"] = [
            compare(cells, (BASELINE.name, MIN_RESIDUAL), (FEEDFORWARD.name, MIN_SNAP))
        ]
    found["star-lifts-all"] = [compare(cells, (name, MIN_RESIDUAL_STAR), (name, MIN_SNAP)) for name in names]
    found["star-makes-alike"] = [over_courses(cells, lambda cell: [spread_ratio(cell)])]
    found["star-better-than-plain"] = [
        over_courses(
            cells,
            lambda cell: [
                cell.errors_m[name, MIN_RESIDUAL_STAR] / cell.errors_m[name, MIN_RESIDUAL] for name in names
            ],
        )
    ]
    return found


def on_all(cells: Sequence[Cell], one: str, other: str) -> Effect:
    """Return the effect of a controller over another on all trajectories."""
    return over_courses(
        cells, lambda cell: [cell.errors_m[one, t] / cell.errors_m[other, t] for t in TRAJECTORIES]
    )


def _row(claim: str, regressor: str, family: str, effects: Sequence[Effect]) -> dict[str, Any]:
    """Return the row of a claim from its comparisons."""
    weakest = max(effects, key=lambda each: each.upper)
    known = [each.p for each in effects if each.p is not None]
    return {
        "claim": claim,
        "regressor": regressor,
        "family": family,
        "confirmed": all(each.confirmed for each in effects),
        "effect": weakest.median,
        "ci95": None if weakest.ci95 is None else list(weakest.ci95),
        "p": max(known) if len(known) == len(effects) else None,
        "courses": weakest.courses,
        "comparisons": len(effects),
    }
