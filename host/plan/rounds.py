"""Rounds of solving and judging: each in a box tightened by what the reference before it exceeded."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from host.plan.box import SolverBox
from host.plan.job import Effort, Job
from host.plan.judge import Judged, measure
from host.plan.result import Plan, PlanRefused, PlanUnsolved
from host.plan.shooting import (
    Grid,
    deviation_m,
    linear_start,
    make_grid,
    make_problem,
    smooth,
    table_start,
    yaw_profile,
)
from host.plan.stage import build_stage
from host.plan.table import snap_table
from host.plan.transcription import Problem, Solution, SolveStatus, solve

Array = NDArray[np.float64]

_YAW_SETTLED = np.radians(2.0)
"""How far the heading at the nodes may move because their times did, without another round to use it."""
_LEAST_RESIDUAL = 0.6
"""m/s^2: below, a residual is not worth a wilder path."""
_PATIENCE = 4
"""Rounds after which a path that sticks out is made smoother, twice as much each round, and one that does not
is taken although its heading moved."""
_REMEDY = "give it more time, headroom or nodes"
_SEARCH = (SolveStatus.INFEASIBLE, SolveStatus.RESTORATION)


def plan_shooting(job: Job, *, nodes: int | None) -> Plan:
    """The min-control or min-residual plan.

    Raises PlanRefused where the limits leave no way, with node and reason where a reference came close, and
    PlanUnsolved where the solver gave up otherwise.
    """
    started = time.process_time()
    durations = job.durations()
    grid = make_grid(durations, nodes, times_fixed=job.route.times_s is not None)
    run = _Run(job, grid)
    judged: Judged | None = None
    for _ in range(job.settings.rounds):
        solution = run.solve(judged)
        table = smooth(solution, grid, job.waypoints_ned)
        yaws = job.yaws(solution.t_s[-1] / job.route.duration_s)
        judged = job.judge(table, yaws)
        moved = np.abs(yaw_profile(yaws, solution.t_s) - run.yaw).max()
        if judged.ok and (moved <= _YAW_SETTLED or run.rounds >= _PATIENCE):
            effort = Effort(
                status=solution.status.name.lower(),
                solve_s=time.process_time() - started,
                rounds=run.rounds,
                iterations=run.iterations,
                intervals=len(solution.t_s) - 1,
                deviation_m=deviation_m(run.stage, run.problem, solution, judged.table),
            )
            return job.finish(judged, solution.t_s[grid.waypoints], effort)
        run.box = run.box.tightened(judged.margins)
        run.yaw = yaw_profile(yaws, solution.t_s)
    assert judged is not None
    raise PlanRefused(
        f"the {job.label} plan is refused after {run.rounds} rounds: {judged.message}; {_REMEDY}",
        judged.verdict,
    )


def _scale(job: Job, grid: Grid) -> float:
    """Unit of the weights: the mean squared residual along the min-snap path at nominal times, or 1."""
    if job.kind != "min-residual" or not job.settings.relative_weights:
        return 1.0
    path = snap_table(job.waypoints_ned, grid.counts * grid.h0_s)
    rms = measure(job.dynamics.vehicle, job.dynamics.model, path, job.yaws()).residual_rms_m_s2
    return max(_LEAST_RESIDUAL, rms or 0.0) ** 2


class _Run:
    """What lasts from round to round."""

    def __init__(self, job: Job, grid: Grid) -> None:
        self.job, self.grid = job, grid
        self.box = SolverBox.inside(job.limits)
        self.model = job.dynamics.stage_model(
            minimise_residual=job.kind == "min-residual",
            weights=job.settings.weights.scaled(_scale(job, grid)),
            limits=job.limits,
            keep_out=job.route.keep_out,
            weigh_time=job.settings.weigh_time,
        )
        self.stage = build_stage(self.model)
        self.yaw = yaw_profile(job.yaws(), grid.times_s)
        self.problem: Problem
        self.rounds = self.iterations = 0
        self._from_snap = False
        self._last: Solution | None = None

    def solve(self, near: Judged | None) -> Solution:
        """The round's solution; `near` is the reference of the round before, for the message of a refusal."""
        while True:
            self.problem = self._make_problem()
            solution = solve(
                self.model,
                self.stage,
                self.problem,
                tolerance=self.job.settings.tolerance,
                max_iterations=self.job.settings.iterations_max,
            )
            self.rounds += 1
            self.iterations += solution.iterations
            if solution.status.usable:
                self._last = solution
                return solution
            if self._last is not None:
                self._last = None
            elif not self._from_snap:
                self._from_snap = True
            else:
                self._fail(solution, near)

    def _fail(self, solution: Solution, near: Judged | None) -> None:
        label = self.job.label
        if near is not None and not near.ok:
            raise PlanRefused(
                f"the {label} plan is refused: {near.message}, and tighter bounds leave no way; {_REMEDY}",
                near.verdict,
            )
        if solution.status in _SEARCH:
            raise PlanRefused(f"no {label} plan: {solution.status.value}; {_REMEDY}")
        raise PlanUnsolved(
            f"no {label} plan: {solution.status.value} ({solution.iterations} iterations); {_REMEDY}",
            solution.status,
        )

    def _make_problem(self) -> Problem:
        job, grid, settings = self.job, self.grid, self.job.settings
        if self._from_snap:
            start = table_start(
                job.dynamics, snap_table(job.waypoints_ned, grid.counts * grid.h0_s), grid, job.yaws()
            )
        else:
            start = linear_start(job.dynamics, job.waypoints_ned, grid, self.yaw)
        low, high = settings.total_time_box
        total_s = job.route.duration_s
        problem = make_problem(
            job.dynamics,
            job.waypoints_ned,
            grid,
            job.limits,
            self.box,
            yaw=self.yaw,
            smoothing=2.0 ** max(0, self.rounds - _PATIENCE),
            start=start,
            h_bounds=settings.step_box,
            total_bounds_s=(-np.inf, np.inf) if grid.times_fixed else (low * total_s, high * total_s),
            shared_steps=settings.shared_steps,
            step_penalty=settings.step_penalty,
            shapes=len(job.route.keep_out),
        )
        if self._last is None:
            return problem
        last = self._last
        return replace(problem, x_start=last.x, u_start=last.u, h_start=last.h, warm=last.multipliers)
