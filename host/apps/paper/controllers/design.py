"""The balanced design: which controllers fly on which course, at which speed, in which world.

A full factorial of controllers, trajectories, courses, speeds and worlds would take thousands of flights. The
unit is therefore a cell: one course at one speed in one world. A cell flies one of the four sets (DFBC or
MPC, with the paper's regressor or ours), with all controllers of the set on all five trajectories. All
flights of a cell have the same waypoints, time, noise, turbulence and battery, so that controllers and
trajectories are compared within cells.

A world has four courses of its own and three speeds. The set of a cell is (course + speed) mod 4. That is a
Youden square: an incomplete-block design with the courses as blocks, the speeds as positions and the sets as
treatments (v = b = 4, k = r = 3, lambda = 2). In every world, each set flies once at each speed and on three
different courses, and each pair of sets shares two courses. Every controller of every set therefore flies
every trajectory equally often, at every speed and in every world.

The baseline also flies those of BASELINE_TRAJECTORIES that it does not fly in the cell's set, as anchors. The
error ratio of the baseline thus rests on all courses. These flights are not in the rows of the design.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from trimtab.host.apps.paper.controllers.table import (
    BASELINE,
    BASELINE_TRAJECTORIES,
    SETS,
    TRAJECTORIES,
    Set,
)

COURSES = len(SETS)
"""Courses of a world."""
SPEEDS = {"fast": 1.0, "middle": 1.25, "slow": 1.6}
"""Time of a course at each speed, over the least time in which min-snap keeps the limits."""


@dataclass(frozen=True, kw_only=True)
class Cell:
    """A course at one speed, and the set that flies there."""

    course: int
    speed: str
    flown: Set

    @property
    def anchors(self) -> Sequence[str]:
        """The trajectories that the baseline flies in addition."""
        flown = TRAJECTORIES if BASELINE in self.flown.controllers else ()
        return tuple(kind for kind in BASELINE_TRAJECTORIES if kind not in flown)


def cells(course: int) -> tuple[Cell, ...]:
    """Return the cells of a course, one for each speed; they are the same in every world."""
    return tuple(
        Cell(course=course, speed=speed, flown=SETS[(course + k) % len(SETS)])
        for k, speed in enumerate(SPEEDS)
    )
