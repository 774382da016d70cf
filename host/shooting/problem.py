"""A shooting problem in numbers, and the outcome of a solve."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

NODES_MAX = 1600
"""Greatest number of intervals of a problem."""


@dataclass(frozen=True, kw_only=True)
class Multipliers:
    """Lagrange multipliers at a solution of a chain (`trimtab.host.shooting.chain`), for another one like it.

    costates: of the gaps before the nodes. limits: of the fixed and the bounded quantities, positive at an
    upper bound, zero elsewhere; the unknowns of a stage, then its path rows. barrier: the barrier parameter.
    """

    costates: Annotated[np.ndarray, "states nodes"]
    limits: Annotated[np.ndarray, "quantities nodes"]
    barrier: float


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Bounds and a start for the unknowns of N intervals. Infinite bounds mean none; equal ones fix a value.

    leg_of: leg of each interval, ascending from 0. h0_s: nominal steps. Bounds are low, high. h_bounds: in
    units of h0_s; where both are 1 the steps are no unknowns. total_bounds_s: of the whole time; equal ones
    pin it. gates: frame, row by row, and centre of the gate at each interval's first node; None without any.
    Their rows follow the vehicle's path rows (`trimtab.host.shooting.places`). near: the start is near the
    solution; multipliers: those there, if known to the interior point method.
    """

    leg_of: Annotated[NDArray[np.int64], "intervals"]
    h0_s: Annotated[np.ndarray, "intervals"]
    parameters: Annotated[np.ndarray, "parameters intervals"]
    x_bounds: tuple[Annotated[np.ndarray, "states nodes"], Annotated[np.ndarray, "states nodes"]]
    u_bounds: tuple[Annotated[np.ndarray, "inputs intervals"], Annotated[np.ndarray, "inputs intervals"]]
    path_bounds: tuple[Annotated[np.ndarray, "rows intervals"], Annotated[np.ndarray, "rows intervals"]]
    h_bounds: tuple[float, float]
    total_bounds_s: tuple[float, float]
    x_start: Annotated[np.ndarray, "states nodes"]
    u_start: Annotated[np.ndarray, "inputs intervals"]
    h_start: Annotated[np.ndarray, "legs"]
    gates: Annotated[np.ndarray, "12 intervals"] | None = None
    near: bool = False
    multipliers: Multipliers | None = None

    def __post_init__(self) -> None:
        count = len(self.leg_of)
        if self.h0_s.shape != (count,) or not (self.h0_s > 0).all():
            raise ValueError(f"h0_s must be {count} positive steps")
        for name, array, columns in (
            ("x", self.x_start, count + 1),
            ("u", self.u_start, count),
            ("parameters", self.parameters, count),
        ):
            if array.shape[1] != columns:
                raise ValueError(f"{name} has {array.shape[1]} columns, {columns} wanted")
        if self.h_start.shape != (self.legs,):
            raise ValueError(f"h_start has shape {self.h_start.shape}, {self.legs} step sizes wanted")
        if not 0.0 < self.h_bounds[0] <= 1.0 <= self.h_bounds[1]:
            raise ValueError(f"the step box {self.h_bounds} must be positive and hold 1")

    @property
    def legs(self) -> int:
        """Number of legs, each with one step size."""
        return int(self.leg_of[-1]) + 1

    def times_s(self, h: Annotated[np.ndarray, "legs"]) -> Annotated[np.ndarray, "nodes"]:
        """Return the nodes' times with these step sizes, in units of h0_s."""
        return np.concatenate([[0.0], np.cumsum(h[self.leg_of] * self.h0_s)])

    @property
    def steps_free(self) -> bool:
        """Whether the step sizes are unknowns."""
        return self.h_bounds != (1.0, 1.0)


class SolveStatus(Enum):
    """The outcome of a solve; the value is a message for people."""

    SOLVED = "the solver converged"
    ACCEPTABLE = "the solver stopped at an acceptable point: its cost hardly changed any more"
    INFEASIBLE = (
        "the constraints contradict each other: the solver converged to a point that violates them least"
    )
    ITERATIONS = "the solver reached its limit of iterations without converging"
    RESTORATION = "the solver could not get back to a feasible point"
    INVALID_NUMBER = "the model gave a number that is not finite"
    STEP = "the solver's search direction became too small to make progress"
    OTHER = "the solver gave up"

    @property
    def usable(self) -> bool:
        """Whether the point may be used, subject to the checks of the reference."""
        return self in (SolveStatus.SOLVED, SolveStatus.ACCEPTABLE)


@dataclass(frozen=True, kw_only=True)
class Solution:
    """The last iterate: states x, inputs u, h in units of h0, and the nodes' times t_s.

    violation: largest violation of a constraint row. multipliers: None where the solver gives none. solver:
    its name.
    """

    status: SolveStatus
    x: Annotated[np.ndarray, "states nodes"]
    u: Annotated[np.ndarray, "inputs intervals"]
    h: Annotated[np.ndarray, "legs"]
    t_s: Annotated[np.ndarray, "nodes"]
    cost: float
    iterations: int
    solve_s: float
    multipliers: Multipliers | None
    violation: float
    solver: str
