"""Rounds of solving and judging.

Coarser grids are solved first, for a start and for the first tightening of the box. A reference that breaks
limits between nodes is solved again from its solution, in a box tightened by the excess. A large excess, or a
solver that does not settle, means that the path ripples as fast as its nodes allow: then the weight of the
thrust rates doubles too. A solve that fails starts anew: on the straight lines, then along the min-snap path.
A refinement has one start, the path of the plan that it tracks.
"""

from __future__ import annotations

import time
from dataclasses import replace
from enum import IntEnum

import numpy as np

from trimtab.host.base.parallel import one_thread_of_algebra
from trimtab.host.models.airframe import P
from trimtab.host.plan.box import SolverBox
from trimtab.host.plan.dynamics import YAW
from trimtab.host.plan.heading import yaw_nodes
from trimtab.host.plan.job import Effort, Job
from trimtab.host.plan.judge import Judged, measure
from trimtab.host.plan.profile import profile
from trimtab.host.plan.residual import ResidualModel
from trimtab.host.plan.result import MINIMISED, Plan, PlanRefused, PlanUnsolved
from trimtab.host.plan.shooting import (
    NODE_S,
    Grid,
    along,
    coarser,
    deviation_m,
    linear_start,
    make_grid,
    make_problem,
    multipliers_on_grid,
    on_grid,
    smooth,
    table_start,
    yaw_profile,
)
from trimtab.host.plan.table import from_reference
from trimtab.host.plan.tracking_error import with_error
from trimtab.host.shooting.intervals import Engine
from trimtab.host.shooting.problem import Problem, Solution, SolveStatus
from trimtab.host.shooting.solver import solve
from trimtab.protocol.blobs import YawNode

_YAW_SETTLED = np.radians(2.0)
"""Change of the heading at the nodes, due to changed node times, up to which no further round is needed."""
_LEAST_RESIDUAL = 0.5
"""m/s^2: a smaller residual does not justify a more aggressive path."""
_RIPPLE = 0.1
"""Excess, as a share of the limit, above which the path is made smoother in addition to a tighter box."""
_PATIENCE = 4
"""Rounds after which a path that exceeds a limit is made smoother, and one that does not is accepted even if
its heading still changes."""
_COARSE_TRIES = 3
"""Greatest number of times that a coarse grid's box is tightened."""
_NEARLY_FEASIBLE = 0.05
"""Constraint violation up to which the next round starts from an unfinished iterate."""
_TRACKABLE = 0.95
"""Share of the limits of tilt and jerk for a path to track; the tracking plan needs the rest."""
_REMEDY = "give it more time, headroom or nodes"
_NO_WAY = (SolveStatus.INFEASIBLE, SolveStatus.RESTORATION)


@one_thread_of_algebra()  # again, with the library of scipy, which this module has loaded
def plan_shooting(job: Job, *, nodes: int | None) -> Plan:
    """Return the plan of a kind other than min-snap.

    Raises PlanRefused where the limits allow no plan, with node and reason of the nearest reference, and
    PlanUnsolved where the solver gave up for another reason.
    """
    started = time.process_time()
    run = _begin(job, nodes)
    while run.rounds < job.settings.rounds:
        solution = run.solve()
        if not solution.status.usable:
            run.recover(solution)
            continue
        judged = run.judged(solution, run.grid)
        if run.settled(solution, judged):
            effort = Effort(
                status=solution.status.name.lower(),
                solve_s=time.process_time() - started,
                first_solve_s=run.first_solve_s,
                rounds=run.rounds + run.rounds_before,
                iterations=run.iterations,
                intervals=len(solution.t_s) - 1,
                deviation_m=deviation_m(run.engine, run.problem, solution, judged.table),
                lambda_r=run.lambda_r,
            )
            return job.finish(judged, solution.t_s[run.grid.waypoints], effort)
    raise run.failure()


def first_round(job: Job, *, nodes: int | None) -> tuple[Engine, Problem, Solution]:
    """Return the engine, problem and solution of the first round.

    The problem starts on the straight lines, in the box as tightened on coarser grids. The solution's time is
    that of the solver on all grids.
    """
    run = _begin(job, nodes)
    solution = run.solve()
    problem = run.make_problem(run.grid)
    return run.engine, problem, replace(solution, solve_s=run.first_solve_s)


def _begin(job: Job, nodes: int | None) -> _Run:
    """Return the run before its first round; min-control-r first makes the plan that it refines."""
    grid = make_grid(job.durations(), nodes, times_fixed=job.route.times_s is not None)
    if job.kind != "min-control-r":
        return _Run(job, grid)
    nominal = replace(job.dynamics, augmented=False)
    within = job.limits.model_copy(
        update={name: _TRACKABLE * getattr(job.limits, name) for name in ("tilt_max_deg", "jerk_max_m_s3")}
    )
    first = plan_shooting(replace(job, kind="min-control", dynamics=nominal, limits=within), nodes=nodes)
    # The same nodes, at the times of that plan.
    h0_s = np.diff(first.waypoint_times_s) / grid.counts
    return _Run(job, replace(grid, h0_s=h0_s, times_fixed=True), first)


def _scale(job: Job, grid: Grid) -> float:
    """Return the unit of the weights: the mean squared residual along the min-snap path, or 1."""
    if job.kind not in MINIMISED or not job.settings.relative_weights:
        return 1.0
    path = job.snap(grid.counts * grid.h0_s)
    rms = measure(job.dynamics.vehicle, job.dynamics.model, path, job.yaws()).residual_rms_m_s2
    return max(_LEAST_RESIDUAL, rms or 0.0) ** 2


class _Start(IntEnum):
    """The start of a solve without a predecessor, in the order of the attempts."""

    LINEAR = 0
    PATH = 1


class _Run:
    """The state that rounds share. first: the plan whose path is tracked, in a refinement."""

    def __init__(self, job: Job, grid: Grid, first: Plan | None = None) -> None:
        self.job, self.grid = job, grid
        self.free_yaw = job.yaw_rate_max_rad_s is not None
        self._tracked = None if first is None else from_reference(first.reference)
        self.box = SolverBox.inside(job.limits, job.yaw_rate_max_rad_s)
        self.engine = Engine(
            job.dynamics.stage_model(
                minimise=MINIMISED.get(job.kind),
                free_yaw=self.free_yaw,
                track_path=first is not None,
            )
        )
        self._yaws = self._path_yaws = job.yaws() if first is None else first.reference.yaw_nodes()
        self._weights = job.settings.weights.scaled(_scale(job, grid))
        self._rest = np.zeros(6)
        if job.kind in MINIMISED:
            heading = 0.0 if self.free_yaw else self._yaws[0].yaw
            self._rest = job.dynamics.model.at_rest(job.dynamics.vehicle, heading)
        self.problem: Problem
        self.rounds = 0
        self.rounds_before = 0 if first is None else first.rounds
        self.iterations = 0 if first is None else first.iterations
        self.first_solve_s = 0.0 if first is None else first.first_solve_s or 0.0
        self._smoothing = 1.0
        self._start = _Start.LINEAR if first is None else _Start.PATH
        self._last: Solution | None = None
        self._near: Judged | None = None

    @property
    def lambda_r(self) -> float | None:
        """The paper's weight of control effort, as of `Plan`."""
        if self.job.kind not in MINIMISED:
            return None
        return self._weights.control / self.job.dynamics.hover_n**2

    def solve(self) -> Solution:
        """Return the round's last iterate.

        Without an earlier solution or a path to track, coarser grids are solved first.
        """
        grids = [self.grid]
        while self._last is None and self._tracked is None and (half := coarser(grids[-1])) is not None:
            grids.append(half)
        before: tuple[Problem, Solution, Grid] | None = None
        for grid in reversed(grids[1:]):
            solution = self._solve_on(grid, before)
            for _ in range(_COARSE_TRIES):
                if not (solution.status.usable and grid.step_s <= NODE_S):
                    break
                judged = self.judged(solution, grid)
                if judged.ok:
                    break
                # Finer grids would fail too, and take longer.
                self.box = self.box.tightened(judged.margins)
                solution = self._solve_on(grid, (self.problem, solution, grid))
            before = (self.problem, solution, grid) if solution.status.usable else None
        solution = self._solve_on(self.grid, before)
        self.rounds += 1
        return solution

    def judged(self, solution: Solution, grid: Grid) -> Judged:
        """Return the verdict on the spline through the last problem's solution."""
        job = self.job
        passed, passed_s = job.passed(solution.x[P, grid.waypoints].T), solution.t_s[grid.waypoints]
        table = smooth(self.engine, self.problem, solution, grid, passed)
        return job.judge(table, self.heading(solution), passed_s)

    def _solve_on(self, grid: Grid, before: tuple[Problem, Solution, Grid] | None) -> Solution:
        """Return the last iterate on a grid, from a coarser one's solution where there is one."""
        self.problem = self.make_problem(grid, before)
        settings = self.job.settings
        solution = solve(
            self.engine,
            self.problem,
            keep_out=self.job.route.keep_out,
            tolerance=settings.tolerance,
            max_iterations=settings.iterations_max,
        )
        self.iterations += solution.iterations
        if self.rounds == 0:
            self.first_solve_s += solution.solve_s
        return solution

    def heading(self, solution: Solution) -> tuple[YawNode, ...]:
        """Return the yaw nodes of a solution: its heading where free, else the route's in its time."""
        if self.free_yaw:
            return yaw_nodes(solution)
        return self.job.yaws(solution.t_s[-1] / self.job.route.duration_s)

    def settled(self, solution: Solution, judged: Judged) -> bool:
        """Return whether the plan is finished; if not, set what the next round changes."""
        asked = self.problem.parameters[YAW]
        self._last, self._near = solution, judged
        moved = 0.0
        if not self.free_yaw:
            self._yaws = judged.reference.yaw_nodes()
            moved = np.abs(yaw_profile(self._yaws, solution.t_s)[:-1] - asked).max()
        if judged.ok and (moved <= _YAW_SETTLED or self.rounds >= _PATIENCE):
            return True
        if not judged.ok:
            worst = self.box.excess(judged.margins)
            self.box = self.box.tightened(judged.margins)
            if worst > _RIPPLE or self.rounds >= _PATIENCE:
                self._smoothing *= 2.0
        return False

    def recover(self, solution: Solution) -> None:
        """Set the start of the next round after a failed solve. Raises PlanRefused or PlanUnsolved."""
        if solution.status is SolveStatus.ITERATIONS and solution.violation <= _NEARLY_FEASIBLE:
            self._last = solution
            self._smoothing *= 2.0
        elif self._last is not None:  # a box tightened for ripples may be infeasible: restore it, smoother
            self._last = None
            self.box = SolverBox.inside(self.job.limits, self.job.yaw_rate_max_rad_s)
            self._smoothing *= 2.0
        elif self._start is _Start.LINEAR:
            self._start = _Start.PATH
        else:
            raise self.failure(solution)

    def failure(self, solution: Solution | None = None) -> PlanRefused | PlanUnsolved:
        """Return the error for a run that cannot continue; solution: None after the last round."""
        label = self.job.label
        if self._near is not None and not self._near.ok:
            return PlanRefused(
                f"the {label} plan is refused after {self.rounds} rounds: {self._near.message}; {_REMEDY}",
                self._near.verdict,
            )
        tries = f"{self.iterations} iterations in {self.rounds} rounds"
        status = SolveStatus.ITERATIONS if solution is None else solution.status
        if status in _NO_WAY or (solution is not None and solution.violation > _NEARLY_FEASIBLE):
            return PlanRefused(
                f"no {label} plan: no way within the limits was found ({tries}){self._broken()}; {_REMEDY}"
            )
        return PlanUnsolved(f"no {label} plan: {status.value} ({tries}); {_REMEDY}", status)

    def _broken(self) -> str:
        """Return a hint at the binding limit: the one that the min-snap path breaks most, and where."""
        job = self.job
        path = job.snap(self.grid.counts * self.grid.h0_s)
        path_profile = profile(job.dynamics.vehicle, ResidualModel(), path, self._path_yaws)
        margins = path_profile.margins(job.limits, job.route.keep_out)
        name = max(margins, key=lambda each: self.box.excess({each: float(margins[each].min())}))
        k = int(margins[name].argmin())
        by, node, t_s = -margins[name][k], path_profile.node[k], path_profile.t_s[k]
        return (
            f", the min-snap path breaks {name} by {by:.3g} at node {node}, {t_s:.2f} s" if by > 0.0 else ""
        )

    def make_problem(self, grid: Grid, before: tuple[Problem, Solution, Grid] | None = None) -> Problem:
        """Return the next round's problem on a grid, from the last round's or a coarser grid's solution."""
        job, settings = self.job, self.job.settings
        yaw = yaw_profile(self._yaws, grid.times_s if self._last is None else self._last.t_s)
        last = self._last or (before[1] if before is not None else None)
        if self._last is not None:
            start = self._last.x, self._last.u
        elif before is not None:
            start = on_grid(self.engine, *before, grid)
        elif self._start is _Start.PATH:
            path = self._tracked or job.snap(grid.counts * grid.h0_s)
            start = table_start(job.dynamics, path, grid, self._path_yaws)
        else:
            start = linear_start(job.dynamics, job.waypoints_ned, grid, yaw)
        low, high = settings.total_time_box
        total_s = job.route.duration_s
        problem = make_problem(
            job.dynamics,
            job.waypoints_ned,
            grid,
            job.limits,
            self.box,
            yaw=yaw,
            # The spline of a coarse grid can ripple faster between its knots.
            smoothing=self._smoothing * max(1.0, grid.step_s / NODE_S) ** 2,
            weights=self._weights,
            unavoidable=self._rest,
            start=start,
            h_bounds=settings.step_box,
            total_bounds_s=(-np.inf, np.inf) if grid.times_fixed else (low * total_s, high * total_s),
            end_velocities_ned=job.route.end_velocities_ned,
            gates=job.route.gates or (),
            shapes=len(job.route.keep_out),
            free_yaw=self.free_yaw,
            tracked_ned=None if self._tracked is None else along(self._tracked, grid.times_s),
        )
        if MINIMISED.get(job.kind) == "error":
            problem = with_error(problem)
        if last is None:
            return problem
        multipliers = last.multipliers
        if self._last is None and before is not None and multipliers is not None:
            multipliers = multipliers_on_grid(multipliers, before[2], grid)
        return replace(problem, h_start=last.h, near=last.status.usable, multipliers=multipliers)
