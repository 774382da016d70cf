"""From a route to a shooting problem and back: grid, bounds, starts, and the spline of a solution."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from trimtab.host.base.errors import UsageError
from trimtab.host.models.airframe import RATE, THETA, THRUST, P, V
from trimtab.host.plan.box import SolverBox
from trimtab.host.plan.dynamics import (
    INPUTS,
    JERK_ROW,
    PATH_ROWS,
    SPEED_ROW,
    STATES,
    TILT_ROW,
    Dynamics,
    Weights,
)
from trimtab.host.plan.smooth import fit
from trimtab.host.plan.table import Table, evaluate, flat_states, yaw_at
from trimtab.host.route import Gate
from trimtab.host.shooting.intervals import Engine
from trimtab.host.shooting.places import GATE_ROWS
from trimtab.host.shooting.problem import NODES_MAX, Multipliers, Problem, Solution
from trimtab.host.vehicle import Limits
from trimtab.protocol.blobs import YawNode

Array = NDArray[np.float64]

NODE_S = 0.07
COARSE = 100
"""Intervals of the coarsest grid; a finer grid starts from the solution of the grid half as fine."""
_DATA_S = 0.1
_LEG_NODES_MIN = 4
_YAW_SLACK = 0.3
"""rad around the requested heading; the cost keeps it two orders of magnitude closer."""


@dataclass(frozen=True, kw_only=True)
class Grid:
    """The distribution of intervals over the legs.

    counts: intervals of each leg. h0_s: nominal step of each. times_fixed: the waypoints'
    times are given, and the steps are no unknowns.
    """

    counts: Annotated[NDArray[np.int64], "legs"]
    h0_s: Annotated[np.ndarray, "legs"]
    times_fixed: bool

    @property
    def waypoints(self) -> Annotated[NDArray[np.int64], "waypoints"]:
        """Node of each waypoint."""
        return np.concatenate([[0], np.cumsum(self.counts)])

    @property
    def leg_of(self) -> Annotated[NDArray[np.int64], "intervals"]:
        """Leg of each interval."""
        return np.repeat(np.arange(len(self.counts)), self.counts)

    @property
    def step_s(self) -> float:
        """The mean nominal step."""
        return float(self.counts @ self.h0_s) / float(self.counts.sum())

    @property
    def times_s(self) -> Annotated[np.ndarray, "nodes"]:
        """Nominal times of the nodes."""
        return np.concatenate([[0.0], np.cumsum(self.h0_s[self.leg_of])])


def make_grid(durations_s: Annotated[np.ndarray, "legs"], nodes: int | None, *, times_fixed: bool) -> Grid:
    """Return about `nodes` intervals, in proportion to the legs' nominal durations, at least four a leg.

    Without `nodes` a step takes about 70 ms, within 60 to 1600 intervals. Beyond 1600, the legs that were
    rounded up most lose intervals. Raises UsageError for more legs than 1600 intervals suffice for.
    """
    if (legs := len(durations_s)) > NODES_MAX // _LEG_NODES_MIN:
        raise UsageError(
            f"{legs} legs: at {_LEG_NODES_MIN} intervals a leg {NODES_MAX} are enough for "
            f"{NODES_MAX // _LEG_NODES_MIN}; split the route, or plan it with min-snap"
        )
    total_s = float(durations_s.sum())
    wanted = nodes or int(np.clip(np.ceil(total_s / NODE_S), 60, NODES_MAX))
    shares = durations_s / total_s * wanted
    counts = np.maximum(_LEG_NODES_MIN, np.rint(shares).astype(np.int64))
    while counts.sum() > NODES_MAX:
        counts[np.argmax(np.where(counts > _LEG_NODES_MIN, counts - shares, -np.inf))] -= 1
    return Grid(counts=counts, h0_s=durations_s / counts, times_fixed=times_fixed)


def coarser(grid: Grid) -> Grid | None:
    """Return the grid with half as many intervals on every leg; None where those are too few."""
    counts = np.maximum(_LEG_NODES_MIN, (grid.counts + 1) // 2)
    if len(grid.leg_of) < 2 * COARSE or counts.sum() > 0.7 * len(grid.leg_of):
        return None
    return Grid(counts=counts, h0_s=grid.counts * grid.h0_s / counts, times_fixed=grid.times_fixed)


def on_grid(
    engine: Engine, problem: Problem, solution: Solution, old: Grid, new: Grid
) -> tuple[Annotated[np.ndarray, "states nodes"], Annotated[np.ndarray, "inputs intervals"]]:
    """Return states and inputs of a problem's solution at another grid's nodes, leg by leg.

    The solution is integrated between its nodes, so it has almost no gaps on the new grid.
    """
    passed = new.leg_of + _share(new) + 1e-9  # legs, at every node but the last
    at = np.searchsorted(old.leg_of + _share(old), passed, side="right") - 1
    share = np.maximum((passed - 1e-9 - (old.leg_of + _share(old))[at]) * old.counts[old.leg_of[at]], 0.0)
    intervals = engine.over(problem.h0_s[at], problem.parameters[:, at])
    intervals.set(solution.x[:, at].T, solution.u[:, at].T, share * solution.h[problem.leg_of][at])
    intervals.values()
    x = intervals.x_next.dense(engine.model.nx)[:, :, 0].T
    return np.hstack([x, solution.x[:, -1:]]), solution.u[:, at]


def multipliers_on_grid(multipliers: Multipliers, old: Grid, new: Grid) -> Multipliers:
    """Return a solution's multipliers at another grid's nodes: those of limits where a node is shared."""
    at_old, at_new = (np.append(grid.leg_of + _share(grid), len(grid.counts)) for grid in (old, new))
    costates = np.array([np.interp(at_new, at_old, row) for row in multipliers.costates])
    nearest = np.minimum(np.searchsorted(at_old, at_new - 1e-9), len(at_old) - 1)
    shared = np.abs(at_old[nearest] - at_new) < 1e-9
    limits = np.where(shared, multipliers.limits[:, nearest], 0.0)
    return replace(multipliers, costates=costates, limits=limits)


def _share(grid: Grid) -> Array:
    """Return the share (N,) of its leg that each node has behind it."""
    return (np.arange(len(grid.leg_of)) - grid.waypoints[grid.leg_of]) / grid.counts[grid.leg_of]


def linear_start(
    dynamics: Dynamics,
    waypoints_ned: Annotated[np.ndarray, "waypoints 3"],
    grid: Grid,
    yaw: Annotated[np.ndarray, "nodes"],
) -> tuple[Annotated[np.ndarray, "states nodes"], Annotated[np.ndarray, "inputs intervals"]]:
    """Return states at rest on straight lines between waypoints, and inputs (paper section IV-C.3)."""
    count = int(grid.counts.sum())
    steady = dynamics.steady(float(yaw[0]), p_ned=waypoints_ned[0])
    x = np.repeat(steady[:, None], count + 1, axis=1)
    x[THETA.stop - 1] = yaw
    for axis in range(3):
        x[axis] = np.interp(np.arange(count + 1), grid.waypoints, waypoints_ned[:, axis])
    return x, np.zeros((INPUTS, count))


def table_start(
    dynamics: Dynamics, table: Table, grid: Grid, yaws: Sequence[YawNode]
) -> tuple[Annotated[np.ndarray, "states nodes"], Annotated[np.ndarray, "inputs intervals"]]:
    """Return states and inputs along a table at the grid's nominal times."""
    times_us = np.minimum(grid.times_s * 1e6, table.times_us[-1])
    x = flat_states(dynamics.vehicle, table, yaws, times_us)
    x[THRUST] /= dynamics.hover_n
    u = np.diff(x[THRUST], axis=1) / np.diff(grid.times_s)
    return x, u


def along(table: Table, times_s: Annotated[np.ndarray, "times"]) -> Annotated[np.ndarray, "3 times"]:
    """Return the positions on a table at these times."""
    return evaluate(table, np.minimum(times_s * 1e6, float(table.times_us[-1])))[0]


def make_problem(  # noqa: PLR0913 (the data of one problem)
    dynamics: Dynamics,
    waypoints_ned: Annotated[np.ndarray, "waypoints 3"],
    grid: Grid,
    limits: Limits,
    box: SolverBox,
    *,
    yaw: Annotated[np.ndarray, "nodes"],
    smoothing: float,
    weights: Weights,
    unavoidable: Annotated[np.ndarray, "6"],
    start: tuple[Annotated[np.ndarray, "states nodes"], Annotated[np.ndarray, "inputs intervals"]],
    h_bounds: tuple[float, float],
    total_bounds_s: tuple[float, float],
    end_velocities_ned: Sequence[Sequence[float]],
    gates: Sequence[Gate],
    shapes: int,
    free_yaw: bool = False,
    tracked_ned: Annotated[np.ndarray, "3 nodes"] | None = None,
) -> Problem:
    """Return the problem in this box.

    yaw: requested heading at the nodes; with free_yaw only the first counts, and those at rest at
    the ends. smoothing: factor on the weight of the thrust rates. unavoidable: residual that the cost
    leaves out. end_velocities_ned: at start and end, where nothing accelerates. gates: of the waypoints that
    need not be met exactly. shapes: number of keep-out shapes. tracked_ned: positions to track.
    """
    count = int(grid.counts.sum())
    low, high = _box_bounds(dynamics, limits, box, yaw)
    exact = np.setdiff1d(np.arange(len(waypoints_ned)), [gate.waypoint for gate in gates])
    low[P, grid.waypoints[exact]] = high[P, grid.waypoints[exact]] = waypoints_ned[exact].T
    for node, velocity in zip((0, count), end_velocities_ned, strict=True):
        steady = dynamics.steady(float(yaw[node]), velocity, waypoints_ned[0 if node == 0 else -1])
        low[P.stop :, node] = high[P.stop :, node] = steady[P.stop :]
    if free_yaw:
        low[THETA.stop - 1, 1:], high[THETA.stop - 1, 1:] = -np.inf, np.inf
    # The reference starts and ends with no jerk: the first and the last interval change no thrust.
    change = np.full((INPUTS, count), np.inf)
    change[:, [0, -1]] = 0.0
    return Problem(
        leg_of=grid.leg_of,
        h0_s=grid.h0_s[grid.leg_of],
        parameters=dynamics.parameters(
            yaw[:-1],
            smoothing=smoothing,
            weights=weights,
            limits=limits,
            rest=unavoidable,
            tracked_ned=None if tracked_ned is None else tracked_ned[:, :-1],
        ),
        x_bounds=(low, high),
        u_bounds=(-change, change),
        path_bounds=_path_bounds(grid, limits, box, end_velocities_ned, gates, shapes, free_yaw),
        h_bounds=(1.0, 1.0) if grid.times_fixed else h_bounds,
        total_bounds_s=total_bounds_s,
        x_start=start[0],
        u_start=start[1],
        h_start=np.ones(len(grid.counts)),
        gates=_frames(gates, waypoints_ned, grid) if gates else None,
    )


def _box_bounds(dynamics: Dynamics, limits: Limits, box: SolverBox, yaw: Array) -> tuple[Array, Array]:
    """Return the bounds of the states (16, N + 1) by geofence, tilt, heading, body rates and thrusts."""
    low, high = np.full((STATES, len(yaw)), -np.inf), np.full((STATES, len(yaw)), np.inf)
    for axis, (near, far) in enumerate(limits.geofence_m):
        low[axis], high[axis] = near + box.fence_m, far - box.fence_m
    high[2] = np.minimum(high[2], -box.floor_m)
    tilt = np.radians(box.tilt_deg)
    low[THETA.start : THETA.start + 2], high[THETA.start : THETA.start + 2] = -tilt, tilt
    low[THETA.stop - 1], high[THETA.stop - 1] = yaw - _YAW_SLACK, yaw + _YAW_SLACK
    rate = np.array(box.body_rate_rad_s)[:, None]
    low[RATE], high[RATE] = -rate, rate
    per_hover = dynamics.vehicle.thrust_max_n / dynamics.hover_n
    low[THRUST], high[THRUST] = (share * per_hover for share in box.thrust_share)
    return low, high


def _path_bounds(
    grid: Grid,
    limits: Limits,
    box: SolverBox,
    end_velocities_ned: Sequence[Sequence[float]],
    gates: Sequence[Gate],
    shapes: int,
    free_yaw: bool,
) -> tuple[Array, Array]:
    """Return the bounds (rows, N) of the path rows: limits, gates, then keep-out shapes."""
    first_gate = PATH_ROWS + free_yaw
    first_shape = first_gate + (GATE_ROWS if gates else 0)
    shape = (first_shape + shapes, int(grid.counts.sum()))
    low, high = np.full(shape, -np.inf), np.full(shape, np.inf)
    low[TILT_ROW] = np.cos(np.radians(box.tilt_deg))
    high[SPEED_ROW] = (box.speed_m_s / limits.speed_max_m_s) ** 2
    if any(end_velocities_ned[0]):
        high[SPEED_ROW, 0] = np.inf  # the route gives this speed, which may be outside the box
    high[JERK_ROW] = (box.jerk_m_s3 / limits.jerk_max_m_s3) ** 2
    low[PATH_ROWS:first_gate] = -box.yaw_rate_rad_s
    high[PATH_ROWS:first_gate] = box.yaw_rate_rad_s
    low[first_shape:] = box.keep_out_m
    for gate in gates:
        node = grid.waypoints[gate.waypoint]
        _bound_by(gate, low[first_gate:first_shape, node], high[first_gate:first_shape, node])
    return low, high


def _bound_by(gate: Gate, low: Array, high: Array) -> None:
    """Set the bounds (4,) of a gate's rows where it is passed."""
    if gate.is_sphere:
        high[3] = 1.0
    else:
        low[:3], high[:3] = (0.0, -1.0, -1.0), (0.0, 1.0, 1.0)


def _frames(gates: Sequence[Gate], waypoints_ned: Array, grid: Grid) -> Array:
    """Return frame and centre (12, N) of the gate at each node; zeros where there is none."""
    out = np.zeros((12, len(grid.leg_of)))
    for gate in gates:
        frame = gate.frame().ravel()
        out[:, grid.waypoints[gate.waypoint]] = [*frame, *waypoints_ned[gate.waypoint]]
    return out


def yaw_profile(
    yaws: Sequence[YawNode], times_s: Annotated[np.ndarray, "times"]
) -> Annotated[np.ndarray, "times"]:
    """Return the requested heading at these times."""
    return yaw_at(yaws, times_s * 1e6)[0]


def smooth(
    engine: Engine,
    problem: Problem,
    solution: Solution,
    grid: Grid,
    waypoints_ned: Annotated[np.ndarray, "waypoints 3"],
) -> Table:
    """Return the node table that fits a solution, sampled about as densely as the table's nodes."""
    parts = math.ceil(float(np.diff(solution.t_s).max()) / _DATA_S)
    times_s, x = _within(engine, problem, solution, tuple(k / parts for k in range(parts)))
    ends = problem.x_bounds[0][V][:, [0, -1]].T  # the bounds fix them
    return fit(times_s, x[P], x[V], parts * grid.waypoints, waypoints_ned, ends)


def deviation_m(engine: Engine, problem: Problem, solution: Solution, table: Table) -> float:
    """Return the largest distance of the table from the solution, at eight points in each interval."""
    times_s, x = _within(engine, problem, solution, tuple(k / 8 for k in range(8)))
    return float(np.linalg.norm(along(table, times_s) - x[P], axis=0).max())


def _within(
    engine: Engine, problem: Problem, solution: Solution, shares: tuple[float, ...]
) -> tuple[Array, Array]:
    """Return times and states at these shares of every interval, and at the end: (m,), (states, m)."""
    intervals = engine.over(problem.h0_s, problem.parameters)
    h = solution.h[problem.leg_of]
    rows = []
    for share in shares:
        intervals.set(solution.x[:, :-1].T, solution.u.T, share * h)
        intervals.values()
        rows.append(intervals.x_next.dense(engine.model.nx)[:, :, 0])
    states = np.stack(rows, axis=1).reshape(-1, engine.model.nx).T
    times = (solution.t_s[:-1, None] + np.array(shares) * np.diff(solution.t_s)[:, None]).ravel()
    return np.append(times, solution.t_s[-1]), np.hstack([states, solution.x[:, -1:]])
