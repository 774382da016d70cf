"""Planning on seeded random courses with a network in the dynamics: the paper's Min-Residual*, on one core.

The network is fitted to a known drag: the plan is as hard as with a learned one, and the same every time. A
course is a random route in the time that its stretched min-snap plan takes: a way within the limits exists.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
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
"""A second more costs what the residual along the min-snap path costs in a second."""
DRAG = np.array([0.5, 0.5, 0.1])
"""What the network is fitted to: 1/s, along the body's axes."""
_SPEED_MAX_M_S, _TILT_MAX_DEG, _THRUST_G = 6.0, 45.0, (0.4, 1.9)
_HIDDEN = (32, 32)
_SAMPLES, _FIT_ITERATIONS = 4000, 1500
_MISS_M = 0.01
_DRAWS = 20
"""Routes drawn for every course wanted."""


@dataclass(frozen=True, kw_only=True)
class Size:
    """How much is measured. plans, free_time, scaling, success: courses; nodes: of plans and free_time;
    naive_nodes, rockit_nodes: of the problem set beside them; most_s: processor time that each may take.
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

    @property
    def courses(self) -> int:
        """How many are drawn."""
        return max(self.plans, self.free_time, self.scaling, self.success, 1)

    @property
    def steps(self) -> int:
        """How often `measure` tells of a step."""
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
    hear: Callable[[str], None] = lambda step: None,
    *,
    size: Size | None = None,
    fit_iterations: int = _FIT_ITERATIONS,
) -> dict[str, Any]:
    """Processor times, convergence and success, each over the first of the same courses.

    first_solve_s and what is called a median of it: the solver on all grids of the first round. hear: told
    `size.steps` times what begins.
    """
    size = size or Size()
    hear("courses")
    courses = draw_courses(vehicle, seed, size.courses)
    hear("network")
    model, rmse = drag_model(vehicle, seed, iterations=fit_iterations)

    def planned(what: str, count: int, **options: Any) -> list[Plan | str]:
        """Return a course each: its plan, or why there is none."""
        found: list[Plan | str] = []
        for number, course in enumerate(courses[:count], 1):
            hear(f"{what} {number} of {count}")
            try:
                found.append(plan(course, vehicle, kind=KIND, model=model, **options))
            except (PlanRefused, PlanUnsolved) as error:
                found.append(f"{course.name}: {error}")
        return found

    plans = _plans(planned("plan", size.plans, nodes=size.nodes))
    free = _plans(planned("free time", size.free_time, nodes=size.nodes, settings=FREE_TIME))
    scaling = [
        _scaling_row(nodes, planned(f"{nodes} intervals,", size.scaling, nodes=nodes))
        for nodes in size.scaling_nodes
    ]
    failures = [
        why
        for course, found in zip(courses, planned("success", size.success), strict=False)
        if (why := _failure(course, found)) is not None
    ]
    hear("CasADi and Ipopt")
    plain = beside(naive.solve, vehicle, model, courses[0], nodes=size.naive_nodes, most_s=size.most_s)
    hear("rockit and minsnap-trajectories")
    rockit = None
    if rockit_ocp.installed():
        rockit = beside(
            rockit_ocp.solve, vehicle, model, courses[0], nodes=size.rockit_nodes, most_s=size.most_s
        )
    waypoints_ned = np.array(courses[0].waypoints_m)
    each_s = [row["first_solve_s"] / row["nodes"] for row in scaling if row["first_solve_s"] is not None]
    return {
        "network_rmse": rmse,
        "nodes": size.nodes,
        "min_residual_star_median_s": _median([found.first_solve_s for found in plans]),
        "plan_median_s": _median([found.solve_s for found in plans]),
        "iterations_median": _median([found.iterations for found in plans]),
        "planned": len(plans),
        "courses": size.plans,
        "free_time_s": _median([found.first_solve_s for found in free]),
        "free_time_planned": len(free),
        "free_time_courses": size.free_time,
        "scaling": scaling,
        "seconds_per_interval_spread": max(each_s) / min(each_s) if each_s else None,
        "success_rate": 1.0 - len(failures) / size.success if size.success else None,
        "success_courses": size.success,
        "failures": failures,
        "speedup_over_naive": None if plain["ours_s"] is None else plain["seconds"] / plain["ours_s"],
        "naive": plain,
        "rockit": rockit,
        "minsnap_trajectories": snap_peer.measure(
            waypoints_ned, optimise_durations(waypoints_ned, courses[0].duration_s)
        ),
    }


def draw_courses(vehicle: Vehicle, seed: int, count: int) -> list[Route]:
    """Random routes, each in the time of its min-snap plan within what the network is trusted for.

    Raises ConfigurationError for a vehicle that few routes can be planned for.
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
            made = plan(route, vehicle, kind="min-snap", headroom=inside, stretch=True)
        except (ConfigurationError, PlanRefused):
            continue
        courses.append(route.model_copy(update={"total_time_s": made.duration_s}))
        if len(courses) == count:
            return courses
    raise ConfigurationError([f"{vehicle.name}: too few random routes can be planned within its limits"])


def region_of(vehicle: Vehicle) -> Region:
    """Where the network is fitted."""
    weight_n = vehicle.mass_kg * GRAVITY
    least, most = _THRUST_G
    return Region(
        speed_max_m_s=_SPEED_MAX_M_S,
        tilt_max_deg=_TILT_MAX_DEG,
        thrust_min_n=least * weight_n,
        thrust_max_n=most * weight_n,
    )


def drag_model(
    vehicle: Vehicle, seed: int, *, iterations: int = _FIT_ITERATIONS
) -> tuple[ResidualModel, float]:
    """Return a network 2 x 32 fitted to the drag, and its RMSE (m/s^2) where it was."""
    rng = np.random.default_rng(seed)
    most = np.array([*[_SPEED_MAX_M_S] * 3, 0.8, 0.8, 0.3])[:, None]
    state = rng.uniform(-most, most, (6, _SAMPLES))
    R = np.array(euler_to_matrix(NUMPY, list(state[3:]))).reshape(3, 3, -1)  # of R_ned_frd
    wanted = -np.einsum("ijn,j,kjn,kn->in", R, DRAG, R, state[:3])
    layout = Layout(hidden=_HIDDEN)

    def loss(xi: Array) -> tuple[float, Array]:
        error = layout.arrays(xi, state) - wanted
        return float((error**2).sum()) / _SAMPLES, layout.vjp(xi, state, 2.0 / _SAMPLES * error)

    options = {"maxiter": iterations, "maxfun": 2 * iterations}
    end = minimize(loss, layout.initial(rng), jac=True, method="L-BFGS-B", options=options)
    network = Network(layout=layout, xi=end.x)
    return ResidualModel(network=network, region=region_of(vehicle)), float(end.fun) ** 0.5


def miss_m(made: Plan, course: Route) -> float:
    """Greatest distance of the reference from a waypoint when it is passed."""
    table = from_reference(made.reference)
    times_us = np.minimum(1e6 * np.array(made.waypoint_times_s), float(table.times_us[-1]))
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
    """Return the first round's problem by `solve` and by ours, both from the straight lines.

    Ours goes by way of coarser grids, and their time counts. at_least: the other did not arrive,
    `seconds` is when it ended. ours_s: None where ours did not. cost_differs: of its optimum from ours, over
    ours.
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


def _failure(course: Route, found: Plan | str) -> str | None:
    """Why this is no success, None where it is one."""
    if isinstance(found, str):
        return found
    missed = miss_m(found, course)
    return None if missed <= _MISS_M else f"{course.name}: a waypoint is missed by {missed:.3g} m"


def _scaling_row(nodes: int, found: list[Plan | str]) -> dict[str, Any]:
    plans = _plans(found)
    return {
        "nodes": nodes,
        "first_solve_s": _median([made.first_solve_s for made in plans]),
        "iterations": _median([made.iterations for made in plans]),
        "planned": len(plans),
        "courses": len(found),
    }


def _plans(found: list[Plan | str]) -> list[Plan]:
    return [made for made in found if isinstance(made, Plan)]


def _median(values: list[Any]) -> float | None:
    return float(median(values)) if values else None
