"""Direct multiple shooting: many intervals joined into one sparse problem for Ipopt.

The unknowns are the states at N + 1 nodes, the inputs of N intervals and the step sizes in units of their
nominal value, one for each interval or one shared by all intervals of a leg (paper eq. 11 with every h in a
box). Sharing makes a step size one dense column in the sparse matrices instead of a variable of its own at
every node, and keeps the solver from trading steps against each other within a leg. All derivatives come from
`Stage`, mapped over the intervals; MUMPS factorises. The same problem gives the same iterates.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from enum import Enum
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from host.plan.stage import Stage, StageModel

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Multipliers:
    """Of the bounds on the unknowns and of the constraint rows, at a solution."""

    bounds: Array
    rows: Array


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Bounds and a start for the unknowns of N intervals. Infinite bounds mean none; equal ones fix a value.

    leg_of: (N,) leg of each interval, ascending from 0. h0_s: (N,) nominal steps. parameters: (np, N).
    x_bounds: two of (nx, N + 1); u_bounds: two of (nu, N); path_bounds: two of (rows, N); h_bounds: low,
    high, in units of h0_s. total_bounds_s: low, high of the whole time; equal ones pin it. x_start: (nx, N +
    1); u_start: (nu, N); h_start: (steps,). step_penalty: cost of (h - 1)^2 for each step size.
    """

    leg_of: NDArray[np.int64]
    shared_steps: bool
    h0_s: Array
    parameters: Array
    x_bounds: tuple[Array, Array]
    u_bounds: tuple[Array, Array]
    path_bounds: tuple[Array, Array]
    h_bounds: tuple[float, float]
    total_bounds_s: tuple[float, float]
    x_start: Array
    u_start: Array
    h_start: Array
    step_penalty: float
    warm: Multipliers | None = None

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
        if self.h_start.shape != (self.steps,):
            raise ValueError(f"h_start has shape {self.h_start.shape}, {self.steps} step sizes wanted")
        if not 0.0 < self.h_bounds[0] <= 1.0 <= self.h_bounds[1]:
            raise ValueError(f"the step box {self.h_bounds} must be positive and hold 1")

    @property
    def step_of(self) -> NDArray[np.int64]:
        """(N,) the step size variable of each interval."""
        return self.leg_of if self.shared_steps else np.arange(len(self.leg_of))

    @property
    def steps(self) -> int:
        """How many step sizes there are."""
        return int(self.step_of[-1]) + 1


_WARM = {
    "ipopt.warm_start_init_point": "yes",
    "ipopt.mu_init": 1e-4,
    "ipopt.warm_start_bound_push": 1e-6,
    "ipopt.warm_start_bound_frac": 1e-6,
    "ipopt.warm_start_slack_bound_push": 1e-6,
    "ipopt.warm_start_slack_bound_frac": 1e-6,
    "ipopt.warm_start_mult_bound_push": 1e-6,
}
"""For a start near the solution, with its multipliers; else Ipopt moves it into the middle of its box."""


class SolveStatus(Enum):
    """How a solve ended; the value is a sentence for a person."""

    SOLVED = "the solver converged"
    ACCEPTABLE = "the solver stopped at an acceptable point just short of its tolerance"
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


_STATUS = {
    "Solve_Succeeded": SolveStatus.SOLVED,
    "Solved_To_Acceptable_Level": SolveStatus.ACCEPTABLE,
    "Infeasible_Problem_Detected": SolveStatus.INFEASIBLE,
    "Maximum_Iterations_Exceeded": SolveStatus.ITERATIONS,
    "Restoration_Failed": SolveStatus.RESTORATION,
    "Invalid_Number_Detected": SolveStatus.INVALID_NUMBER,
    "Search_Direction_Becomes_Too_Small": SolveStatus.STEP,
}


@dataclass(frozen=True, kw_only=True)
class Solution:
    """The last iterate. x: (nx, N + 1); u: (nu, N); h: (steps,) in units of h0; t_s: (N + 1,) node times.

    violation: by how much it misses the constraint rows at most.
    """

    status: SolveStatus
    x: Array
    u: Array
    h: Array
    t_s: Array
    cost: float
    iterations: int
    solve_s: float
    multipliers: Multipliers
    violation: float


def solve(
    model: StageModel, stage: Stage, problem: Problem, *, tolerance: float, max_iterations: int
) -> Solution:
    """The local optimum from the given start. `solve_s` is processor time and the only number that varies."""
    started = time.process_time()
    assembly = Assembly(model, stage, problem)
    options: dict[str, Any] = {
        "cache": assembly.derivatives,
        "no_nlp_grad": True,
        "calc_lam_p": False,
        "print_time": False,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.tol": tolerance,
        "ipopt.max_iter": max_iterations,
    }
    low, high = assembly.bounds()
    g_low, g_high = assembly.row_bounds()
    given = {"x0": assembly.start(), "lbx": low, "ubx": high, "lbg": g_low, "ubg": g_high}
    if problem.warm is not None:
        options |= _WARM
        given |= {"lam_x0": problem.warm.bounds, "lam_g0": problem.warm.rows}
    solver = ca.nlpsol("plan", "ipopt", assembly.nlp, options)
    found = solver(**given)
    stats = solver.stats()
    x, u, h = assembly.split(np.asarray(found["x"]).ravel())
    steps = h[problem.step_of] * problem.h0_s
    return Solution(
        status=_STATUS.get(stats["return_status"], SolveStatus.OTHER),
        x=x,
        u=u,
        h=h,
        t_s=np.concatenate([[0.0], np.cumsum(steps)]),
        cost=float(found["f"]),
        iterations=int(stats["iter_count"]),
        solve_s=time.process_time() - started,
        multipliers=Multipliers(
            bounds=np.asarray(found["lam_x"]).ravel(), rows=np.asarray(found["lam_g"]).ravel()
        ),
        violation=_violation(np.asarray(found["g"]).ravel(), g_low, g_high),
    )


def _violation(rows: Array, low: Array, high: Array) -> float:
    """Largest distance of a row from its bounds; infinity where one is not a number."""
    missed = float(np.maximum(low - rows, rows - high).max())
    return max(0.0, missed) if np.isfinite(rows).all() else float("inf")


class Assembly:
    """Objective, constraints and their derivatives over all intervals, as CasADi functions of one vector w.

    w = (x_0 .. x_N, u_0 .. u_{N-1}, h). Rows: N * nx gaps, N * np path rows, then the total time.
    """

    def __init__(self, model: StageModel, stage: Stage, problem: Problem) -> None:
        self.problem, self.count = problem, len(problem.leg_of)
        self.nx, self.nu = model.nx, model.nu
        self.rows = stage.value.size1_out("path")
        self.width = self.nx * (self.count + 1) + self.nu * self.count + problem.steps
        self.height = (self.nx + self.rows) * self.count + 1
        w = ca.MX.sym("w", self.width)
        none = ca.MX.sym("p", 0, 1)
        self._arguments = self._interval_arguments(w)
        x_next, cost, path = stage.value.map(self.count)(*self._arguments)
        gaps = x_next - self._x(w)[:, 1:]
        h = w[self.width - problem.steps :]
        self._time_row = np.bincount(problem.step_of, weights=problem.h0_s)
        g = ca.vertcat(ca.vec(gaps), ca.vec(path), ca.dot(ca.DM(self._time_row), h))
        f = ca.sum2(cost) + problem.step_penalty * ca.sumsqr(h - 1)
        self.nlp = {"x": w, "f": f, "g": g}
        self.derivatives = {
            "nlp_grad_f": self._gradient(w, none, stage, f),
            "nlp_jac_g": self._jacobian(w, none, stage, g),
            "nlp_hess_l": self._hessian(w, none, stage),
        }

    def _x(self, w: ca.MX) -> ca.MX:
        return ca.reshape(w[: self.nx * (self.count + 1)], self.nx, self.count + 1)

    def _interval_arguments(self, w: ca.MX) -> list[ca.MX | ca.DM]:
        first = self.nx * (self.count + 1)
        u = ca.reshape(w[first : first + self.nu * self.count], self.nu, self.count)
        steps = (first + self.nu * self.count + self.problem.step_of).tolist()
        return [
            self._x(w)[:, : self.count],
            u,
            ca.reshape(w[steps], 1, self.count),
            ca.DM(self.problem.h0_s).T,
            ca.DM(self.problem.parameters),
        ]

    def _columns(self) -> NDArray[np.int64]:
        """(N, nx + nu + 1): where each interval's z lies in w."""
        k = np.arange(self.count)[:, None]
        first = self.nx * (self.count + 1)
        return np.hstack(
            [
                k * self.nx + np.arange(self.nx),
                first + k * self.nu + np.arange(self.nu),
                first + self.nu * self.count + self.problem.step_of[:, None],
            ]
        )

    def _gradient(self, w: ca.MX, none: ca.MX, stage: Stage, f: ca.MX) -> ca.Function:
        """Gradients of the intervals, scattered: step sizes are shared, everything else stands alone."""
        cost_slope = stage.gradient.map(self.count)(*self._arguments)
        columns = self._columns().ravel()
        scatter = ca.DM.triplet(
            columns.tolist(), list(range(len(columns))), ca.DM.ones(len(columns)), self.width, len(columns)
        )
        h_first = self.width - self.problem.steps
        penalty = ca.vertcat(ca.MX(h_first, 1), 2 * self.problem.step_penalty * (w[h_first:] - 1))
        gradient = ca.densify(
            scatter @ ca.vec(cost_slope) + penalty
        )  # the solver reads it without its pattern
        return ca.Function("nlp_grad_f", [w, none], [f, gradient], ["x", "p"], ["f", "grad:f:x"])

    def _jacobian(self, w: ca.MX, none: ca.MX, stage: Stage, g: ca.MX) -> ca.Function:
        x_slope, path_slope = stage.slopes.map(self.count)(*self._arguments)
        columns = self._columns()
        intervals = np.arange(self.count)[:, None]
        parts: list[tuple[NDArray[np.int64], NDArray[np.int64], ca.MX | ca.DM]] = []
        for sparsity, values, offset, rows in (
            (stage.slopes.sparsity_out("x_slope"), x_slope, 0, self.nx),
            (stage.slopes.sparsity_out("path_slope"), path_slope, self.nx * self.count, self.rows),
        ):
            row, column = (np.array(index, dtype=np.int64) for index in sparsity.get_triplet())
            parts.append(
                ((offset + intervals * rows + row).ravel(), columns[:, column].ravel(), ca.vec(values.nz[:]))
            )
        gap = np.arange(self.nx * self.count)
        parts.append((gap, gap + self.nx, ca.DM(-np.ones(len(gap)))))
        steps = np.arange(self.problem.steps)
        parts.append(
            (
                np.full(len(steps), self.height - 1),
                self.width - self.problem.steps + steps,
                ca.DM(self._time_row),
            )
        )
        matrix = _sparse(parts, self.height, self.width)
        return ca.Function("nlp_jac_g", [w, none], [g, matrix], ["x", "p"], ["g", "jac:g:x"])

    def _hessian(self, w: ca.MX, none: ca.MX, stage: Stage) -> ca.Function:
        sigma = ca.MX.sym("lam_f")
        lam = ca.MX.sym("lam_g", self.height)
        split = self.nx * self.count
        blocks = stage.hessian.map(self.count)(
            *self._arguments,
            ca.repmat(sigma, 1, self.count),
            ca.reshape(lam[:split], self.nx, self.count),
            ca.reshape(lam[split : self.height - 1], self.rows, self.count),
        )
        sparsity = stage.hessian.sparsity_out("hessian")
        row, column = (np.array(index, dtype=np.int64) for index in sparsity.get_triplet())
        values = ca.reshape(blocks.nz[:], len(row), self.count)
        last = self.nx + self.nu
        shared = (row == last) & (column == last)
        alone = np.flatnonzero(~shared)
        columns = self._columns()
        parts: list[tuple[NDArray[np.int64], NDArray[np.int64], ca.MX | ca.DM]] = [
            (
                columns[:, row[alone]].ravel(),
                columns[:, column[alone]].ravel(),
                ca.vec(values[alone.tolist(), :]),
            )
        ]
        steps = np.arange(self.problem.steps)
        total = 2 * self.problem.step_penalty * sigma * ca.MX.ones(self.problem.steps)
        if shared.any():
            gather = ca.DM.triplet(
                self.problem.step_of.tolist(),
                list(range(self.count)),
                ca.DM.ones(self.count),
                self.problem.steps,
                self.count,
            )
            total += gather @ ca.vec(values[np.flatnonzero(shared).tolist(), :])
        diagonal = self.width - self.problem.steps + steps
        parts.append((diagonal, diagonal, total))
        matrix = _sparse(parts, self.width, self.width)
        return ca.Function(
            "nlp_hess_l",
            [w, none, sigma, lam],
            [matrix],
            ["x", "p", "lam:f", "lam:g"],
            ["triu:hess:gamma:x:x"],
        )

    def bounds(self) -> tuple[Array, Array]:
        """Bounds of w."""
        p = self.problem
        low, high = (
            np.concatenate([x.ravel(order="F"), u.ravel(order="F"), np.full(p.steps, h)])
            for x, u, h in zip(p.x_bounds, p.u_bounds, p.h_bounds, strict=True)
        )
        return low, high

    def row_bounds(self) -> tuple[Array, Array]:
        """Bounds of the constraint rows."""
        p = self.problem
        gap = np.zeros(self.nx * self.count)
        low, high = (
            np.concatenate([gap, path.ravel(order="F"), [total]])
            for path, total in zip(p.path_bounds, p.total_bounds_s, strict=True)
        )
        return low, high

    def start(self) -> Array:
        """The start, clipped to its bounds by Ipopt."""
        p = self.problem
        return np.concatenate([p.x_start.ravel(order="F"), p.u_start.ravel(order="F"), p.h_start])

    def split(self, w: Array) -> tuple[Array, Array, Array]:
        """x, u and h of a vector w."""
        first = self.nx * (self.count + 1)
        second = first + self.nu * self.count
        return (
            w[:first].reshape(self.count + 1, self.nx).T,
            w[first:second].reshape(self.count, self.nu).T,
            w[second:],
        )


def _sparse(
    parts: list[tuple[NDArray[np.int64], NDArray[np.int64], ca.MX | ca.DM]], height: int, width: int
) -> ca.MX:
    """A sparse matrix from (rows, columns, values) without repeated entries."""
    rows = np.concatenate([part[0] for part in parts])
    columns = np.concatenate([part[1] for part in parts])
    order = np.lexsort((rows, columns))
    pattern = ca.Sparsity.triplet(height, width, rows.tolist(), columns.tolist())
    if pattern.nnz() != len(rows):
        raise ValueError("entries of a sparse matrix repeat")
    values = ca.vertcat(*[ca.MX(part[2]) if isinstance(part[2], ca.DM) else part[2] for part in parts])
    return ca.MX(pattern, values[order.tolist()])
