"""Courses and network come from the seed, the peer finds our optimum, failures are counted and told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from trimtab.host.apps.bench import naive, planning, rockit_ocp, snap_peer
from trimtab.host.plan import Plan, PlanRefused, ResidualModel, Weights, plan
from trimtab.host.plan.dynamics import Dynamics
from trimtab.host.plan.job import Job
from trimtab.host.plan.planner import make_job
from trimtab.host.plan.rounds import first_round
from trimtab.host.plan.snap import optimise_durations, solve_snap
from trimtab.host.route import Route
from trimtab.host.shooting.solver import solve
from trimtab.host.vehicle import ConfigurationError, load_vehicle

VEHICLE = load_vehicle("research")
SIZE = planning.Size(
    plans=2,
    nodes=60,
    free_time=1,
    scaling=1,
    scaling_nodes=(60, 80),
    success=2,
    naive_nodes=20,
    rockit_nodes=20,
)
FIT = 100


@pytest.fixture(scope="module")
def model() -> ResidualModel:
    return planning.drag_model(VEHICLE, 1, iterations=FIT)[0]


@pytest.fixture(scope="module")
def courses() -> list[Route]:
    return planning.draw_courses(VEHICLE, 1, 2)


def test_courses_of_a_seed_are_the_same_and_can_be_flown(courses: list[Route]) -> None:
    assert courses == planning.draw_courses(VEHICLE, 1, 2)
    assert courses[0].waypoints_m != courses[1].waypoints_m
    assert not {course.name for course in courses} & {c.name for c in planning.draw_courses(VEHICLE, 2, 2)}
    for course in courses:
        assert plan(course, VEHICLE, kind="min-snap").margins["speed_m_s"] > 0.0


def test_vehicle_that_no_route_fits_is_refused() -> None:
    fence = ((-1.0, 1.0), (-1.0, 1.0), (-6.0, 0.3))
    small = VEHICLE.replace(limits=VEHICLE.limits.model_copy(update={"geofence_m": fence}))
    with pytest.raises(ConfigurationError, match="too few random routes"):
        planning.draw_courses(small, 1, 1)


def test_network_of_a_seed_is_the_same_and_near_the_drag() -> None:
    (model, rmse), (again, _) = (planning.drag_model(VEHICLE, 1, iterations=80) for _ in range(2))
    assert model.network is not None
    assert again.network is not None
    assert np.array_equal(model.network.xi, again.network.xi)
    assert rmse < 0.5
    level = model.network.acceleration_ned(np.array([[3.0], [-3.0], [0.0]]), np.zeros((3, 1)))[:, 0]
    np.testing.assert_allclose(level, [-1.5, 1.5, 0.0], atol=0.5)


def _assert_same_optimum(solve_too: Callable[..., naive.Ended], job: Job, *, rel: float) -> None:
    engine, problem, _ = first_round(job, nodes=20)
    ours = solve(engine, problem, tolerance=1e-7, max_iterations=300)
    other = solve_too(engine.model, problem, tolerance=1e-7, most_s=60.0)
    assert ours.status.usable
    assert other.solved
    assert other.cost == pytest.approx(ours.cost, rel=rel)


def test_naive_problem_has_our_optimum(model: ResidualModel, courses: list[Route]) -> None:
    job = make_job(courses[0], VEHICLE, kind=planning.KIND, model=model)
    _assert_same_optimum(naive.solve, job, rel=1e-5)


def test_naive_problem_with_free_steps_and_time_has_our_optimum(
    model: ResidualModel, courses: list[Route]
) -> None:
    weights = Weights(control=0.04, thrust_rate=0.004, time=1.0)
    settings = replace(planning.FREE_TIME, weights=weights)
    job = make_job(courses[0], VEHICLE, kind="min-residual", model=model, settings=settings)
    _assert_same_optimum(naive.solve, job, rel=1e-5)


def test_naive_solve_without_time_says_it_did_not_arrive(model: ResidualModel, courses: list[Route]) -> None:
    found = planning.beside(naive.solve, VEHICLE, model, courses[0], nodes=20, most_s=1e-3)
    assert found["at_least"]
    assert found["cost_differs"] is None
    assert found["ours_s"] > 0.0


def test_rockit_problem_has_our_optimum(
    require: Callable[[str], None], model: ResidualModel, courses: list[Route]
) -> None:
    require("rockit")
    for kind, settings in ((planning.KIND, planning.Settings()), ("min-residual", planning.FREE_TIME)):
        job = make_job(courses[0], VEHICLE, kind=kind, model=model, settings=settings)
        _assert_same_optimum(rockit_ocp.solve, job, rel=1e-6)


def test_rockit_solve_without_time_says_it_did_not_arrive(
    require: Callable[[str], None], model: ResidualModel, courses: list[Route]
) -> None:
    require("rockit")
    found = planning.beside(rockit_ocp.solve, VEHICLE, model, courses[0], nodes=20, most_s=1e-3)
    assert found["at_least"]
    assert found["cost_differs"] is None


def test_rockit_problem_that_is_not_written_is_refused(
    require: Callable[[str], None], model: ResidualModel, courses: list[Route]
) -> None:
    require("rockit")
    job = make_job(courses[0], VEHICLE, kind=planning.KIND, model=model)
    engine, problem, _ = first_round(job, nodes=20)
    wider = tuple(np.vstack([bound, bound[:1]]) for bound in problem.path_bounds)
    cases = (({"path_bounds": wider}, "keep-out"), ({"h_bounds": (1.0, 1.0)}, "free step size"))
    for change, told in cases:
        with pytest.raises(ValueError, match=told):
            rockit_ocp.solve(engine.model, replace(problem, **change), tolerance=1e-3, most_s=1.0)


def test_peers_that_are_not_installed_are_not_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rockit_ocp, "installed", lambda: False)
    monkeypatch.setattr(snap_peer, "installed", lambda: False)
    found = planning.measure(
        VEHICLE, 1, size=replace(SIZE, plans=0, free_time=0, scaling=0, success=0), fit_iterations=10
    )
    assert (found["rockit"], found["minsnap_trajectories"]) == (None, None)


def test_minsnap_trajectories_has_our_spline(require: Callable[[str], None], courses: list[Route]) -> None:
    require("minsnap")
    for course in courses:
        waypoints = np.array(course.waypoints_m)
        durations = optimise_durations(waypoints, course.duration_s)
        found = snap_peer.measure(waypoints, durations, repeats=1)
        assert found is not None
        assert found["differs"] < 1e-8
        assert found["waypoints"] == len(waypoints)


def test_minsnap_trajectories_with_another_spline_is_refused(
    require: Callable[[str], None], courses: list[Route], monkeypatch: pytest.MonkeyPatch
) -> None:
    require("minsnap")
    waypoints = np.array(courses[0].waypoints_m)
    durations = optimise_durations(waypoints, courses[0].duration_s)
    moving = ((0.1, 0.0, 0.0), (0.0, 0.0, 0.0))
    monkeypatch.setattr(snap_peer, "solve_snap", lambda p, t: solve_snap(p, t, moving))
    with pytest.raises(ValueError, match="spline differs"):
        snap_peer.measure(waypoints, durations, repeats=1)


def test_naive_problem_with_keep_out_shapes_is_refused(model: ResidualModel, courses: list[Route]) -> None:
    job = make_job(courses[0], VEHICLE, kind=planning.KIND, model=model)
    engine, problem, _ = first_round(job, nodes=20)
    wider = tuple(np.vstack([bound, bound[:1]]) for bound in problem.path_bounds)
    with pytest.raises(ValueError, match="keep-out"):
        naive.solve(
            engine.model, replace(problem, path_bounds=(wider[0], wider[1])), tolerance=1e-3, most_s=1
        )


def test_bench_counts_what_it_plans_and_tells_every_step() -> None:
    heard: list[str] = []
    size = replace(SIZE, success=1)
    found = planning.measure(VEHICLE, 1, heard.append, size=size, fit_iterations=FIT)
    assert len(heard) == size.steps
    assert found["planned"] == found["courses"] == 2
    assert found["min_residual_star_median_s"] < found["plan_median_s"]
    assert [row["nodes"] for row in found["scaling"]] == [60, 80]
    assert found["seconds_per_interval_spread"] >= 1.0
    assert (found["success_rate"], found["failures"]) == (1.0, [])
    assert found["free_time_s"] > 0.0
    assert found["speedup_over_naive"] > 0.0
    assert abs(found["naive"]["cost_differs"]) < 0.02


def test_bench_tells_what_could_not_be_planned(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = planning.plan

    def refusing(course: Route, *of: Any, **options: Any) -> Plan:
        if options["kind"] == planning.KIND:
            raise PlanRefused("no way")
        return kept(course, *of, **options)

    monkeypatch.setattr(planning, "plan", refusing)
    found = planning.measure(VEHICLE, 1, size=SIZE, fit_iterations=FIT)
    assert found["success_rate"] == 0.0
    assert [line.split(": ")[1] for line in found["failures"]] == ["no way", "no way"]
    nothing = ("min_residual_star_median_s", "plan_median_s", "free_time_s", "seconds_per_interval_spread")
    assert all(found[name] is None for name in nothing)


def test_waypoint_that_is_missed_is_measured(courses: list[Route]) -> None:
    course = courses[0]
    made = plan(course, VEHICLE, kind="min-snap")
    assert planning.miss_m(made, course) < 1e-3
    moved = [(n + 0.03, e, d) if k == 2 else (n, e, d) for k, (n, e, d) in enumerate(course.waypoints_m)]
    other = course.model_copy(update={"waypoints_m": tuple(moved)})
    assert planning.miss_m(made, other) == pytest.approx(0.03, abs=1e-3)


def test_quick_measures_less() -> None:
    assert planning.QUICK.steps < planning.Size().steps
    assert all(a < b for a, b in pairwise(planning.QUICK.scaling_nodes))
    region = planning.region_of(VEHICLE)
    hover = 4.0 * Dynamics(vehicle=VEHICLE).hover_n
    assert region.thrust_min_n < hover < region.thrust_max_n
