"""Direct multiple shooting: many intervals joined into one sparse problem.

The unknowns are the states at N + 1 nodes, the inputs of N intervals and the step sizes in units of their
nominal value, one for each leg (paper eq. 11 with every h in a box). All are in the order of the nodes, so a
solver for sparse problems (Ipopt) sees a narrow band. A step size is an input of its leg's first interval and
a state of the others. Where the total time is bounded, the elapsed time is a state too. Values that bounds
fix become rows. `trimtab.host.shooting.chain` has the same problem as a chain of equal stages.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from trimtab.host.route.shapes import Shape
from trimtab.host.shooting.intervals import Engine
from trimtab.host.shooting.places import Places
from trimtab.host.shooting.problem import Problem
from trimtab.host.shooting.sparse import Pattern, ranks

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class Assembly:
    """Objective, constraints and their derivatives over all intervals, as functions of one vector w.

    w: node by node the states, the step size where it is a state, the time, the inputs, the step size where
    it is an input. Rows: node by node the gaps to the next node, the bounded path rows, the fixed values.
    """

    def __init__(self, engine: Engine, problem: Problem, keep_out: Sequence[Shape] = ()) -> None:
        self.problem, self.count = problem, len(problem.leg_of)
        self.nx, self.nu = engine.model.nx, engine.model.nu
        self._intervals = engine.over(problem.h0_s, problem.parameters)
        self._vehicle_rows = problem.path_bounds[0].shape[0]
        self._places: Places | None = None
        if keep_out or problem.gates is not None:
            self._places = Places(problem.gates, keep_out, self.count)
            self._vehicle_rows -= self._places.rows
        self._place_unknowns()
        self._place_rows()
        self._plan_gradient()
        self._plan_jacobian()
        self._plan_hessian()
        self._at: Array = np.full(self.width, np.nan)
        self._computed: set[str] = set()

    # Places of unknowns and rows.

    def _place_unknowns(self) -> None:
        problem, count, nx, nu = self.problem, self.count, self.nx, self.nu
        leg_of = problem.leg_of
        first = np.concatenate([[True], leg_of[1:] != leg_of[:-1]])
        free = problem.steps_free
        self._timed = free and bool(np.isfinite(problem.total_bounds_s).any())
        self._h_is_input = first & free
        self._h_is_state = np.append(~first & free, False)
        t_is_state = np.arange(count + 1) > 0
        t_is_state &= self._timed
        self.nx_of = nx + self._h_is_state + t_is_state.astype(int)
        self.nu_of = np.append(nu + self._h_is_input.astype(int), 0)
        sizes = self.nx_of + self.nu_of
        start = np.concatenate([[0], np.cumsum(sizes)])
        self.width, self.start_of = int(start[-1]), start[:-1]
        self.stage_of = np.repeat(np.arange(count + 1), sizes)
        self._x_at = start[:-1, None] + np.arange(nx)
        self._u_at = (start[:-1] + self.nx_of)[:-1, None] + np.arange(nu)
        self._t_at = np.where(t_is_state, start[:-1] + nx + self._h_is_state, -1)
        h_state = np.where(self._h_is_state, start[:-1] + nx, -1)
        self._h_at = np.where(self._h_is_input, self._u_at[:, -1] + 1, h_state[:-1]) if free else None
        self._h_state_at = h_state
        self._first_of = np.flatnonzero(first)
        # Seconds that a step size of 1 gives all the intervals that share it.
        self._shared_s: Array = np.bincount(leg_of, weights=problem.h0_s).astype(float)[leg_of]

    def _place_rows(self) -> None:
        """Place the rows and set their bounds; equal bounds on unknowns become rows."""
        problem, count = self.problem, self.count
        low, high = self._spread(problem.x_bounds, problem.u_bounds)
        fixed = (low == high) & np.isfinite(low)
        self._fixed_at = np.flatnonzero(fixed)
        fixed_stage = self.stage_of[self._fixed_at]
        bounded = np.isfinite(problem.path_bounds[0]) | np.isfinite(problem.path_bounds[1])
        gaps = np.append(self.nx_of[1:], 0)
        paths = np.append(bounded.sum(axis=0), 0)
        sizes = gaps + paths + np.bincount(fixed_stage, minlength=count + 1)
        start = np.concatenate([[0], np.cumsum(sizes)])
        self.height = int(start[-1])
        self._gap_at = start[:-2, None] + np.arange(self.nx)
        after = start[:-2] + self.nx
        self._h_row = np.where(self._h_is_state[1:], after, -1)
        self._t_row = np.where(self._t_at[1:] >= 0, after + self._h_is_state[1:], -1)
        order = np.cumsum(bounded, axis=0) - 1
        self._path_at = np.where(bounded, (start[:-2] + gaps[:-1])[None, :] + order, -1).T
        self._fix_at = (start[:-1] + gaps + paths)[fixed_stage] + ranks(fixed_stage)
        self.g_low, self.g_high = np.zeros(self.height), np.zeros(self.height)
        k, row = np.nonzero(self._path_at >= 0)
        at = self._path_at[k, row]
        self.g_low[at], self.g_high[at] = (bound[row, k] for bound in problem.path_bounds)
        self.g_low[self._fix_at] = self.g_high[self._fix_at] = low[self._fixed_at]
        low[self._fixed_at], high[self._fixed_at] = -np.inf, np.inf
        self.low, self.high = low, high

    def _spread(self, x: tuple[Array, Array], u: tuple[Array, Array]) -> tuple[Array, Array]:
        """Return the bounds of w."""
        problem = self.problem
        low, high = np.full(self.width, -np.inf), np.full(self.width, np.inf)
        for bound, of_x, of_u in zip((low, high), x, u, strict=True):
            bound[self._x_at], bound[self._u_at] = of_x.T, of_u.T
        if self._h_at is not None:
            at = self._h_at[self._first_of]
            low[at], high[at] = problem.h_bounds
        if self._timed:
            low[self._t_at[-1]], high[self._t_at[-1]] = problem.total_bounds_s
        return low, high

    def _columns(self, entries: Index) -> Index:
        """Return the places (N, entries) of z = (x, u, h) in w; -1 for a step size that is no unknown."""
        h = np.full(self.count, -1) if self._h_at is None else self._h_at
        return np.hstack([self._x_at[:-1], self._u_at, h[:, None]])[:, entries]

    def _plan_jacobian(self) -> None:
        """Set the pattern of dg/dw, its constant entries, and the places of the intervals' numbers."""
        intervals, places = self._intervals, self._places
        parts: list[tuple[Index, Index, Array]] = []

        def constant(rows: Index, columns: Index, value: float | Array) -> None:
            used = (rows >= 0) & (columns >= 0)
            parts.append((rows[used], columns[used], np.broadcast_to(value, rows.shape)[used]))

        constant(self._gap_at.ravel(), self._x_at[1:].ravel(), 1.0)
        constant(self._fix_at, self._fixed_at, 1.0)
        if self._h_at is not None:
            constant(self._h_row, self._h_state_at[1:], 1.0)
            constant(self._h_row, self._h_at, -1.0)
        if self._timed and self._h_at is not None:
            constant(self._t_row, self._t_at[1:], 1.0)
            constant(self._t_row, self._t_at[:-1], -1.0)
            constant(np.where(self._h_is_input, self._t_row, -1), self._h_at, -self._shared_s)
        fixed = len(parts)
        sources: list[Index] = []  # places of the entries in the intervals' outputs
        for output, rows in (
            (intervals.x_slope, self._gap_at[:, intervals.x_slope.rows]),
            (intervals.path_slope, self._path_at[:, intervals.path_slope.rows]),
        ):
            columns = self._columns(output.columns)
            used = (rows >= 0) & (columns >= 0)
            parts.append((rows[used], columns[used], np.zeros(int(used.sum()))))
            sources.append(output.at[used])
        if places is not None:
            rows = np.repeat(self._path_at[:, self._vehicle_rows :], 3, axis=1)
            columns = np.tile(self._x_at[:-1, :3], (1, places.rows))
            used = rows >= 0
            parts.append((rows[used], columns[used], np.zeros(int(used.sum()))))
            sources.append(np.flatnonzero(used))
        self.slopes = Pattern([part[:2] for part in parts], self.height, self.width)
        located = [self.slopes.find(rows, columns) for rows, columns, _ in parts]
        self._jacobian_constants = np.zeros(self.slopes.count)
        for place, (_, _, values) in zip(located, parts, strict=True):
            self._jacobian_constants[place] = values
        self._jacobian_places = [
            (place, source) for place, source in zip(located[fixed:], sources, strict=True)
        ]

    def _plan_gradient(self) -> None:
        output = self._intervals.cost_slope
        columns = self._columns(output.rows)
        used = columns >= 0
        self._gradient_to, self._gradient_from = columns[used], output.at[used]

    def _plan_hessian(self) -> None:
        output = self._intervals.hessian
        rows, columns = self._columns(output.rows), self._columns(output.columns)
        used = (rows >= 0) & (columns >= 0)
        self._hessian_from = output.at[used]
        up = np.minimum(rows, columns)[used]
        over = np.maximum(rows, columns)[used]
        parts = [(up, over)]
        if self._places is not None:
            i, j = np.triu_indices(3)
            parts.append((self._x_at[:-1][:, i].ravel(), self._x_at[:-1][:, j].ravel()))
        self.upper = Pattern(parts, self.width, self.width)
        self._hessian_to, *self._hessian_places_to = (self.upper.find(*part) for part in parts)

    # Numbers.

    def _set(self, w: Array) -> None:
        if np.array_equal(w, self._at):
            return
        self._at[:] = w
        self._computed.clear()
        h = np.ones(self.count) if self._h_at is None else w[self._h_at]
        self._intervals.set(w[self._x_at[:-1]], w[self._u_at], h)

    def _need(self, name: str, compute: Callable[[], None]) -> None:
        if name not in self._computed:
            compute()
            self._computed.add(name)

    def _placed(self, w: Array) -> tuple[Array, Array]:
        """Return values and slopes of the rows of gates and keep-out shapes, computed once at a point."""
        assert self._places is not None
        places, p = self._places, w[self._x_at[:-1, :3]]
        self._need("places", lambda: places.first(p))
        return places.value, places.slope

    def objective(self, w: Annotated[np.ndarray, "unknowns"]) -> float:
        """Return the cost."""
        self._set(w)
        self._need("values", self._intervals.values)
        cost = self._intervals.cost
        return float(cost.flat[cost.at].sum())

    def gradient(self, w: Annotated[np.ndarray, "unknowns"]) -> Annotated[np.ndarray, "unknowns"]:
        """Return the slope of the cost."""
        self._set(w)
        if "slopes" not in self._computed:
            self._need("gradient", self._intervals.gradient)
        out = np.zeros(self.width)
        out[self._gradient_to] = self._intervals.cost_slope.flat[self._gradient_from]
        return out

    def rows(self, w: Annotated[np.ndarray, "unknowns"]) -> Annotated[np.ndarray, "rows"]:
        """Return the constraint rows."""
        self._set(w)
        self._need("values", self._intervals.values)
        out = np.zeros(self.height)
        x_next, path = self._intervals.x_next, self._intervals.path
        out[self._gap_at] = w[self._x_at[1:]] - x_next.flat[x_next.at]
        vehicle_rows = self._path_at[:, : self._vehicle_rows]
        used = vehicle_rows >= 0
        out[vehicle_rows[used]] = path.flat[path.at[used]]
        if self._places is not None:
            value, _ = self._placed(w)
            more = self._path_at[:, self._vehicle_rows :]
            out[more[more >= 0]] = value[more >= 0]
        out[self._fix_at] = w[self._fixed_at]
        if self._h_at is not None:
            k = np.flatnonzero(self._h_row >= 0)
            out[self._h_row[k]] = w[self._h_state_at[k + 1]] - w[self._h_at[k]]
            k = np.flatnonzero(self._t_row >= 0)
            before = np.where(self._t_at[k] >= 0, w[self._t_at[k]], 0.0)
            change = np.where(self._h_is_input[k], self._shared_s[k] * w[self._h_at[k]], 0.0)
            out[self._t_row[k]] = w[self._t_at[k + 1]] - before - change
        return out

    def violation(self, w: Annotated[np.ndarray, "unknowns"]) -> float:
        """Return the largest violation of a row's bounds; infinity where a row is not finite."""
        rows = self.rows(w)
        missed = float(np.maximum(self.g_low - rows, rows - self.g_high).max())
        return max(0.0, missed) if np.isfinite(rows).all() else float("inf")

    def jacobian(self, w: Annotated[np.ndarray, "unknowns"]) -> Annotated[np.ndarray, "nonzeros"]:
        """Return the nonzeros of dg/dw in the order of `slopes`."""
        self._set(w)
        self._need("slopes", self._intervals.slopes)
        out = self._jacobian_constants.copy()
        (to, source), (path_to, path_source), *more = self._jacobian_places
        out[to] = -self._intervals.x_slope.flat[source]
        out[path_to] = self._intervals.path_slope.flat[path_source]
        if self._places is not None:
            _, slope = self._placed(w)
            out[more[0][0]] = slope.ravel()[more[0][1]]
        return out

    def hessian(
        self, w: Annotated[np.ndarray, "unknowns"], sigma: float, lam: Annotated[np.ndarray, "rows"]
    ) -> Annotated[np.ndarray, "nonzeros"]:
        """Return the nonzeros of the upper triangle of the Hessian of sigma f + lam' g."""
        self._set(w)
        path = np.where(self._path_at >= 0, lam[self._path_at], 0.0)
        self._intervals.compute_hessian(sigma, -lam[self._gap_at], path[:, : self._vehicle_rows])
        out = np.zeros(self.upper.count)
        out[self._hessian_to] = self._intervals.hessian.flat[self._hessian_from]
        if self._places is not None:
            gate_hessian = self._places.second(w[self._x_at[:-1, :3]], path[:, self._vehicle_rows :])
            i, j = np.triu_indices(3)
            out[self._hessian_places_to[0]] += gate_hessian[:, i, j].ravel()
        return out

    def start(self) -> Annotated[np.ndarray, "unknowns"]:
        """Return the start, clipped to the bounds, with fixed values set."""
        p = self.problem
        w = np.zeros(self.width)
        w[self._x_at], w[self._u_at] = p.x_start.T, p.u_start.T
        if self._h_at is not None:
            w[self._h_at] = p.h_start[p.leg_of]
        if self._timed:
            total = np.cumsum(np.bincount(p.leg_of, weights=p.h0_s) * p.h_start)
            k = np.flatnonzero(self._t_at >= 0)
            w[self._t_at[k]] = total[p.leg_of[k - 1]]
        w[self._fixed_at] = self.g_low[self._fix_at]
        return np.clip(w, self.low, self.high)

    def split(
        self, w: Annotated[np.ndarray, "unknowns"]
    ) -> tuple[
        Annotated[np.ndarray, "states nodes"],
        Annotated[np.ndarray, "inputs intervals"],
        Annotated[np.ndarray, "legs"],
    ]:
        """Return the states x, inputs u and step sizes h of a vector w."""
        h = np.ones(self.problem.legs) if self._h_at is None else w[self._h_at[self._first_of]]
        return w[self._x_at].T, w[self._u_at].T, h
