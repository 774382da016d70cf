"""Planning on seeded random courses with a network in the dynamics: the paper's Min-Residual*, on one core.

The network is fitted to a known drag, so plans are as hard as with a learned one and the same in every run. A
course is a random route with the duration of its stretched min-snap plan, so a path within the limits exists.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.rotations import euler_to_matrix
from trimtab.host.apps.bench import naive, rockit_ocp, snap_peer
from trimtab.host.codegen import NUMPY
from trimtab.host.models.network import Layout, Network
from trimtab.host.models.region import Region
from trimtab.host.plan import Plan, PlanRefused, PlanUnsolved, ResidualModel, Settings, Weights, plan
from trimtab.host.plan.box import within_region
from trimtab.host.plan.dynamics import Dynamics
from trimtab.host.plan.planner import make_job
from trimtab.host.plan.rounds import first_round
from trimtab.host.plan.snap import optimise_durations
from trimtab.host.plan.table import evaluate, from_reference
from trimtab.host.route import LimitsOverride, Route, random_route
from trimtab.host.vehicle import ConfigurationError, Vehicle

Array = NDArray[np.float64]

KIND = "min-residual*"
FREE_TIME = Settings(weights=Weights(time=1.0), total_time_box=(0.7, 1.4))
"""One more second costs as much as the residual along the min-snap path does in one second."""
DRAG = np.array([0.5, 0.5, 0.1])
"""Drag that the network is fitted to: 1/s, along the body axes."""
_SPEED_MAX_M_S, _TILT_MAX_DEG, _THRUST_G = 6.0, 45.0, (0.4, 1.9)
_HIDDEN = (32, 32)
_SAMPLES, _FIT_ITERATIONS = 4000, 1500
_MISS_M = 0.01
_DRAWS = 20
"""Greatest number of routes drawn for each course."""


@dataclass(frozen=True, kw_only=True)
class Size:
    """Size of the measurement.

    plans, free_time, scaling, success: number of courses. nodes: of plans and free_time. naive_nodes,
    rockit_nodes: of the problem that the peers solve. most_s: processor time that each peer may take.
    """

    plans: int = 20
    nodes: int = 400
    free_time: int = 5
    scaling: int = 3
    scaling_nodes: tuple[int, ...] = (100, 200, 400, 800, 1600)
    success: int = 40
    naive_nodes: int = 400
    rockit_nodes: int = 100
    most_s: float = 300.0

    def peers_alone(self) -> Size:
        """Return the same problems for the peers, and no others."""
        return replace(self, plans=0, free_time=0, scaling=0, scaling_nodes=(), success=0)

    @property
    def courses(self) -> int:
        """Number of courses to draw."""
        return max(self.plans, self.free_time, self.scaling, self.success, 1)

    @property
    def steps(self) -> int:
        """Number of calls of `on_progress`."""
        return 4 + self.plans + self.free_time + self.scaling * len(self.scaling_nodes) + self.success


QUICK = Size(
    plans=5,
    free_time=2,
    scaling=1,
    scaling_nodes=(100, 200, 400, 800),
    success=10,
    naive_nodes=100,
    most_s=60.0,
)


def measure(
    vehicle: Vehicle,
    seed: int,
    on_progress: Callable[[str], None] = lambda step: None,
    *,
    size: Size | None = None,
    fit_iterations: int = _FIT_ITERATIONS,
) -> dict[str, Any]:
    """Return processor times, convergence and success, each over the first of the same courses.

    first_solve_s, and its median: the solver on all grids of the first round. on_progress: called
    `size.steps` times, as each step begins.
    """
    size = size or Size()
    on_progress("courses")
    courses = draw_courses(vehicle, seed, size.courses)
    on_progress("network")
    model, rmse = drag_model(vehicle, seed, iterations=fit_iterations)
    outcomes = partial(_outcomes, vehicle, model, on_progress)
    plans = _plans(outcomes("plan", courses[: size.plans], nodes=size.nodes))
    free = _plans(outcomes("free time", courses[: size.free_time], nodes=size.nodes, settings=FREE_TIME))
    scaling = [
        _scaling_row(nodes, outcomes(f"{nodes} intervals,", courses[: size.scaling], nodes=nodes))
        for nodes in size.scaling_nodes
    ]
    tried = courses[: size.success]
    failures = [
        reason
        for course, outcome in zip(tried, outcomes("success", tried), strict=True)
        if (reason := _failure(course, outcome)) is not None
    ]
    per_interval_s = [
        row["first_solve_s"] / row["nodes"] for row in scaling if row["first_solve_s"] is not None
    ]
    return {
        "network_rmse": rmse,
        "nodes": size.nodes,
        "min_residual_star_median_s": _median([plan.first_solve_s for plan in plans]),
        "plan_median_s": _median([plan.solve_s for plan in plans]),
        "iterations_median": _median([plan.iterations for plan in plans]),
        "planned": len(plans),
        "courses": size.plans,
        "free_time_s": _median([plan.first_solve_s for plan in free]),
        "free_time_planned": len(free),
        "free_time_courses": size.free_time,
        "scaling": scaling,
        "seconds_per_interval_spread": max(per_interval_s) / min(per_interval_s) if per_interval_s else None,
        "success_rate": 1.0 - len(failures) / size.success if size.success else None,
        "success_courses": size.success,
        "failures": failures,
        **_peers(vehicle, model, courses[0], size, on_progress),
    }


def _outcomes(
    vehicle: Vehicle,
    model: ResidualModel,
    on_progress: Callable[[str], None],
    title: str,
    courses: Sequence[Route],
    **options: Any,
) -> list[Plan | str]:
    """Return for each course its plan, or why there is none."""
    outcomes: list[Plan | str] = []
    for number, course in enumerate(courses, 1):
        on_progress(f"{title} {number} of {len(courses)}")
        try:
            outcomes.append(plan(course, vehicle, kind=KIND, model=model, **options))
        except (PlanRefused, PlanUnsolved) as error:
            outcomes.append(f"{course.name}: {error}")
    return outcomes


def _peers(
    vehicle: Vehicle, model: ResidualModel, course: Route, size: Size, on_progress: Callable[[str], None]
) -> dict[str, Any]:
    """Return the figures of the same course planned by CasADi with Ipopt, rockit and minsnap-trajectories."""
    on_progress("CasADi and Ipopt")
    plain = beside(naive.solve, vehicle, model, course, nodes=size.naive_nodes, most_s=size.most_s)
    on_progress("rockit and minsnap-trajectories")
    rockit = None
    if rockit_ocp.installed():
        rockit = beside(rockit_ocp.solve, vehicle, model, course, nodes=size.rockit_nodes, most_s=size.most_s)
    durations = optimise_durations(np.array(course.waypoints_m), course.duration_s)
    return {
        "speedup_over_naive": None if plain["ours_s"] is None else plain["seconds"] / plain["ours_s"],
        "naive": plain,
        "rockit": rockit,
        "minsnap_trajectories": snap_peer.measure(np.array(course.waypoints_m), durations),
    }


def draw_courses(vehicle: Vehicle, seed: int, count: int) -> list[Route]:
    """Draw random routes, each with the duration of its min-snap plan inside the network's region.

    Raises ConfigurationError if too few routes can be planned for the vehicle.
    """
    limits = within_region(vehicle.limits, region_of(vehicle), Dynamics(vehicle=vehicle))
    inside = LimitsOverride(
        speed_max_m_s=limits.speed_max_m_s,
        tilt_max_deg=limits.tilt_max_deg,
        thrust_headroom=limits.thrust_headroom,
    )
    courses: list[Route] = []
    for number in np.random.default_rng(seed).integers(2**31, size=_DRAWS * count):
        route = random_route(int(number))
        try:
            snap = plan(route, vehicle, kind="min-snap", headroom=inside, stretch=True)
        except (ConfigurationError, PlanRefused):
            continue
        courses.append(route.model_copy(update={"total_time_s": snap.duration_s}))
        if len(courses) == count:
            return courses
    raise ConfigurationError([f"{vehicle.name}: too few random routes can be planned within its limits"])


def region_of(vehicle: Vehicle) -> Region:
    """Return the region in which the network is fitted."""
    weight_n = vehicle.mass_kg * GRAVITY
    least, most = _THRUST_G
    return Region(
        speed_max_m_s=_SPEED_MAX_M_S,
        tilt_max_deg=_TILT_MAX_DEG,
        thrust_min_n=least * weight_n,
        thrust_max_n=most * weight_n,
    )


def drag_model(
    vehicle: Vehicle, seed: int, *, hidden: tuple[int, ...] = _HIDDEN, iterations: int = _FIT_ITERATIONS
) -> tuple[ResidualModel, float]:
    """Return a network fitted to the drag, 2 x 32 by default, and its RMSE (m/s^2) on the fit's samples."""
    rng = np.random.default_rng(seed)
    most = np.array([*[_SPEED_MAX_M_S] * 3, 0.8, 0.8, 0.3])[:, None]
    state = rng.uniform(-most, most, (6, _SAMPLES))
    R = np.array(euler_to_matrix(NUMPY, list(state[3:]))).reshape(3, 3, -1)  # of R_ned_frd
    wanted = -np.einsum("ijn,j,kjn,kn->in", R, DRAG, R, state[:3])
    layout = Layout(hidden=hidden)

    def loss(xi: Array) -> tuple[float, Array]:
        value, vjp = layout.with_vjp(xi, state)
        error = value - wanted
        return float((error**2).sum()) / _SAMPLES, vjp(2.0 / _SAMPLES * error)

    options = {"maxiter": iterations, "maxfun": 2 * iterations}
    end = minimize(loss, layout.initial(rng), jac=True, method="L-BFGS-B", options=options)
    network = Network(layout=layout, xi=end.x)
    return ResidualModel(network=network, region=region_of(vehicle)), float(end.fun) ** 0.5


def miss_m(plan: Plan, course: Route) -> float:
    """Return the greatest distance of the reference from a waypoint at the waypoint's time."""
    table = from_reference(plan.reference)
    times_us = np.minimum(1e6 * np.array(plan.waypoint_times_s), float(table.times_us[-1]))
    passed = evaluate(table, times_us)[0].T
    return float(np.linalg.norm(passed - np.array(course.waypoints_m), axis=1).max())


def beside(
    solve: Callable[..., naive.Ended],
    vehicle: Vehicle,
    model: ResidualModel,
    course: Route,
    *,
    nodes: int,
    most_s: float,
) -> dict[str, Any]:
    """Solve the first round's problem with `solve` and with our planner, both from straight lines.

    Our time includes the coarser grids. at_least: the peer did not converge, and `seconds` is the time at
    which it ended. ours_s: None if our planner did not converge. cost_differs: relative difference of the
    peer's optimum from ours.
    """
    job = make_job(course, vehicle, kind=KIND, model=model)
    engine, problem, ours = first_round(job, nodes=nodes)
    other = solve(engine.model, problem, tolerance=job.settings.tolerance, most_s=most_s)
    both = other.solved and ours.status.usable
    return {
        "nodes": len(problem.leg_of),
        "seconds": other.solve_s,
        "at_least": not other.solved,
        "build_s": other.build_s,
        "iterations": other.iterations,
        "ours_s": ours.solve_s if ours.status.usable else None,
        "cost_differs": (other.cost - ours.cost) / ours.cost if both else None,
    }


def _failure(course: Route, outcome: Plan | str) -> str | None:
    """Return why a course counts as a failure, or None for a success."""
    if isinstance(outcome, str):
        return outcome
    missed_m = miss_m(outcome, course)
    return None if missed_m <= _MISS_M else f"{course.name}: a waypoint is missed by {missed_m:.3g} m"


def _scaling_row(nodes: int, outcomes: list[Plan | str]) -> dict[str, Any]:
    plans = _plans(outcomes)
    return {
        "nodes": nodes,
        "first_solve_s": _median([plan.first_solve_s for plan in plans]),
        "iterations": _median([plan.iterations for plan in plans]),
        "planned": len(plans),
        "courses": len(outcomes),
    }


def _plans(outcomes: list[Plan | str]) -> list[Plan]:
    return [outcome for outcome in outcomes if isinstance(outcome, Plan)]


def _median(values: list[Any]) -> float | None:
    return float(median(values)) if values else None
