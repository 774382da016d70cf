"""The assembled problem against CasADi's own derivatives, and solves with known optima."""

from __future__ import annotations

import signal
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from trimtab.host.route import Gate
from trimtab.host.route.shapes import Sphere
from trimtab.host.shooting.intervals import Engine
from trimtab.host.shooting.places import Places
from trimtab.host.shooting.problem import Problem, SolveStatus
from trimtab.host.shooting.solver import Solver, solve
from trimtab.host.shooting.stage import StageModel
from trimtab.host.shooting.transcription import Assembly

INF = np.inf


def _cart() -> StageModel:
    """A point mass: x = (p, v), u = force; cost u^2; bounded row: v."""
    return StageModel(
        nx=2,
        nu=1,
        np=1,
        derivative=lambda x, u, p: ca.vertcat(x[1], u[0]),
        residual=None,
        effort=lambda x, u, p: p[0] * u[0] * u[0],
        path=lambda x, u, p: x[1],
        network=None,
        network_rows=None,
    )


def _problem(
    *,
    legs: tuple[int, ...] = (20, 20),
    total: tuple[float, float] = (1.0, 1.0),
    steps: tuple[float, float] = (0.5, 2.0),
) -> Problem:
    """Rest to rest over one metre in a second."""
    count = sum(legs)
    low, high = np.full((2, count + 1), -INF), np.full((2, count + 1), INF)
    low[:, 0] = high[:, 0] = 0.0
    low[:, -1] = high[:, -1] = (1.0, 0.0)
    leg_of = np.repeat(np.arange(len(legs)), legs)
    return Problem(
        leg_of=leg_of,
        h0_s=np.full(count, 1.0 / count),
        parameters=np.ones((1, count)),
        x_bounds=(low, high),
        u_bounds=(np.full((1, count), -INF), np.full((1, count), INF)),
        path_bounds=(np.full((1, count), -INF), np.full((1, count), INF)),
        h_bounds=steps,
        total_bounds_s=total,
        x_start=np.zeros((2, count + 1)),
        u_start=np.zeros((1, count)),
        h_start=np.ones(len(legs)),
    )


def _solve(model: StageModel, problem: Problem, iterations: int = 200, solver: Solver | None = None):
    return solve(Engine(model), problem, tolerance=1e-6, max_iterations=iterations, solver=solver)


def _point() -> StageModel:
    """A point that is moved: x = p, u = v; cost u'u."""
    return StageModel(
        nx=3,
        nu=3,
        np=1,
        derivative=lambda x, u, p: u,
        residual=None,
        effort=lambda x, u, p: ca.dot(u, u),
        path=lambda x, u, p: ca.dot(u, u),
        network=None,
        network_rows=None,
    )


_SPHERE = Sphere(kind="sphere", centre_m=(0.5, 0.05, 0.0), radius_m=0.2)


def _around(count: int = 30) -> Problem:
    """From the origin to (1, 0, 0) in a second, outside a sphere on the way."""
    low, high = np.full((3, count + 1), -INF), np.full((3, count + 1), INF)
    low[:, 0] = high[:, 0] = 0.0
    low[:, -1] = high[:, -1] = (1.0, 0.0, 0.0)
    free = np.full((3, count), INF)
    start = np.zeros((3, count + 1))
    start[0] = np.linspace(0.0, 1.0, count + 1)
    return Problem(
        leg_of=np.zeros(count, dtype=int),
        h0_s=np.full(count, 1.0 / count),
        parameters=np.ones((1, count)),
        x_bounds=(low, high),
        u_bounds=(-free, free),
        path_bounds=(np.full((2, count), -INF), np.full((2, count), INF)),
        h_bounds=(1.0, 1.0),
        total_bounds_s=(-INF, INF),
        x_start=start,
        u_start=np.zeros((3, count)),
        h_start=np.ones(1),
    )


_CASES = {
    "two legs": {},
    "free total time": {"total": (-INF, INF)},
    "bounded total time": {"total": (0.9, 1.1)},
    "fixed steps": {"steps": (1.0, 1.0)},
}


@pytest.mark.parametrize("engine", ["vm", "c"])
@pytest.mark.parametrize("case", sorted(_CASES))
def test_assembled_derivatives_equal_differences(case: str, engine: str, require) -> None:
    if engine == "c":
        require("compiler")
    whole = Assembly(Engine(_cart(), engine), _problem(legs=(3, 2), **_CASES[case]))
    _check_derivatives(whole, 1.0)


def test_assembled_derivatives_with_keep_out_equal_differences() -> None:
    count = 5
    problem = _around(count)
    low = np.full((2, count), -INF)
    low[1] = 0.0
    problem = replace(problem, path_bounds=(low, problem.path_bounds[1]))
    _check_derivatives(Assembly(Engine(_point()), problem, [_SPHERE]), 1.0)


def test_assembled_derivatives_with_gates_beside_keep_out_equal_differences() -> None:
    _check_derivatives(Assembly(Engine(_point()), _gated(5), [_SPHERE]), 1.0)


def _gated(count: int) -> Problem:
    """As `_around`, a third of the way on a plane across it and at two thirds in a sphere."""
    first, second = count // 3, 2 * count // 3
    problem = _around(count)
    low, high = np.full((6, count), -INF), np.full((6, count), INF)
    low[5] = 0.0
    low[1, first], high[1, first] = 0.0, 0.0
    low[2, first], high[2, first] = 0.5, 1.0
    high[4, second] = 1.0
    gates = np.zeros((12, count))
    gates[:, first] = [
        *Gate(waypoint=1, width_m=2.0, height_m=2.0, heading_deg=30.0).frame().ravel(),
        0.4,
        0,
        0,
    ]
    gates[:, second] = [*Gate(waypoint=1, radius_m=0.5).frame().ravel(), 0.6, 0.3, 0.0]
    return replace(problem, path_bounds=(low, high), gates=gates)


def _gates_alone(count: int) -> Problem:
    problem = _gated(count)
    low, high = problem.path_bounds
    return replace(problem, path_bounds=(low[:5], high[:5]))


@pytest.mark.parametrize("solver", ["interior point", "ipopt"])
def test_solve_passes_gates_where_their_rows_say(solver: Solver, require) -> None:
    require("compiler")
    solution = solve(Engine(_point()), _gates_alone(30), tolerance=1e-6, max_iterations=200, solver=solver)
    assert solution.status.usable
    frame = Gate(waypoint=1, width_m=2.0, height_m=2.0, heading_deg=30.0).frame()
    along, right, _ = frame @ (solution.x[:, 10] - [0.4, 0.0, 0.0])
    assert along == pytest.approx(0.0, abs=1e-6)
    assert 0.5 - 1e-6 <= right <= 1.0 + 1e-6
    assert np.linalg.norm(solution.x[:, 20] - [0.6, 0.3, 0.0]) <= 0.49 + 1e-6


def test_optimum_has_the_same_bits_for_any_number_of_lanes(compiler_of_width, monkeypatch) -> None:
    found = []
    for lanes in (2, 4, 8):
        monkeypatch.setattr(
            "trimtab.host.codegen.compiler.find_compiler", lambda lanes=lanes: compiler_of_width(lanes)
        )
        found.append(_solve(_point(), _gates_alone(30), solver="interior point"))
    for other in found[1:]:
        assert other.iterations == found[0].iterations
        np.testing.assert_array_equal(other.x, found[0].x)


def _check_derivatives(whole: Assembly, size: float) -> None:
    rng = np.random.default_rng(0)
    w, lam = rng.uniform(0.5, 1.5, whole.width), rng.standard_normal(whole.height)
    step = 1e-6

    def slope(function) -> np.ndarray:
        """d function/dw by central differences, one column an unknown."""
        ends = [[function(w + sign * step * e) for sign in (1, -1)] for e in np.eye(whole.width)]
        return np.array([(after - before) / (2 * step) for after, before in ends]).T

    jacobian = np.array(ca.DM(whole.slopes.sparsity(), whole.jacobian(w)))
    np.testing.assert_allclose(jacobian, slope(whole.rows), atol=1e-7 * size)
    np.testing.assert_allclose(whole.gradient(w), slope(whole.objective), atol=1e-7 * size)
    upper = np.array(ca.DM(whole.upper.sparsity(), whole.hessian(w, 1.7, lam)))

    def of_lagrangian(at: np.ndarray) -> np.ndarray:
        rows = np.array(ca.DM(whole.slopes.sparsity(), whole.jacobian(at)))
        return 1.7 * whole.gradient(at) + rows.T @ lam

    np.testing.assert_allclose(upper, np.triu(slope(of_lagrangian)), atol=1e-6 * size)


@pytest.mark.parametrize("case", sorted(_CASES))
def test_both_solvers_find_the_same_optimum(case: str, require) -> None:
    require("compiler")
    problem = _problem(**_CASES[case])
    bounded = replace(problem, path_bounds=(problem.path_bounds[0], np.full((1, 40), 1.3)))
    first, second = (_solve(_cart(), bounded, solver=solver) for solver in ("interior point", "ipopt"))
    assert (first.solver, second.solver) == ("interior point", "ipopt")
    assert first.status is second.status is SolveStatus.SOLVED
    assert first.cost == pytest.approx(second.cost, rel=1e-4)
    # Free step sizes may share the time differently on the same path.
    times_s = np.linspace(0.0, first.t_s[-1], 50)
    paths = [np.interp(times_s, each.t_s, each.x[0]) for each in (first, second)]
    np.testing.assert_allclose(*paths, atol=1e-3)


def test_an_interrupt_while_places_are_evaluated_is_raised(require, monkeypatch) -> None:
    require("compiler")
    first = Places.first

    def interrupted(self: Places, p: np.ndarray) -> None:
        signal.raise_signal(signal.SIGINT)
        first(self, p)

    monkeypatch.setattr(Places, "first", interrupted)
    with pytest.raises(KeyboardInterrupt):
        _solve(_point(), _gates_alone(30), solver="interior point")


def test_a_model_that_gives_no_numbers_ends_the_solve(require) -> None:
    require("compiler")
    broken = replace(_cart(), effort=lambda x, u, p: p[0] * ca.log(x[0] - 100.0))
    assert not _solve(broken, _problem()).status.usable


def test_solve_goes_around_what_is_to_be_kept_out_of() -> None:
    problem = _around()
    low = np.full((2, 30), -INF)
    low[1] = 0.0
    solution = solve(
        Engine(_point()),
        replace(problem, path_bounds=(low, problem.path_bounds[1])),
        keep_out=[_SPHERE],
        tolerance=1e-8,
        max_iterations=200,
    )
    assert solution.status.usable
    distance = np.linalg.norm(solution.x - np.array([[0.5], [0.05], [0.0]]), axis=0) - 0.2
    assert distance.min() > -1e-6
    assert solution.x[1].min() < -0.1


def test_solve_of_the_rest_to_rest_cart_reaches_the_known_optimum() -> None:
    solution = _solve(_cart(), _problem())
    # The least integral of u^2 is 12 m^2/s^3; a force held over 40 intervals costs 1 + 1/N^2 as much.
    assert solution.status is SolveStatus.SOLVED
    assert solution.cost == pytest.approx(12.0 * (1.0 + 1.0 / 40**2), rel=2e-4)
    np.testing.assert_allclose(solution.h, 1.0, atol=1e-2)
    times = solution.t_s
    np.testing.assert_allclose(solution.x[0], 3.0 * times**2 - 2.0 * times**3, atol=2e-3)


def test_solve_with_total_time_free_takes_all_it_may() -> None:
    solution = _solve(_cart(), _problem(total=(0.8, 1.25)))
    assert solution.t_s[-1] == pytest.approx(1.25, abs=1e-6)
    assert solution.cost == pytest.approx(12.0 / 1.25**3, rel=2e-3)


def test_solve_keeps_path_and_step_bounds() -> None:
    problem = _problem()
    low, high = problem.path_bounds
    solution = _solve(_cart(), replace(problem, path_bounds=(low, np.minimum(high, 1.2))))
    assert solution.x[1].max() <= 1.2 + 1e-7
    assert (solution.h >= 0.5 - 1e-7).all()
    assert solution.t_s[-1] == pytest.approx(1.0, abs=1e-7)


def test_solve_without_a_way_says_infeasible() -> None:
    problem = _problem()
    low, high = problem.path_bounds
    solution = _solve(_cart(), replace(problem, path_bounds=(low, np.minimum(high, 0.5))))
    assert not solution.status.usable
    assert solution.status in (SolveStatus.INFEASIBLE, SolveStatus.RESTORATION)


def test_solve_out_of_iterations_says_so() -> None:
    problem = _problem()
    low, high = problem.path_bounds
    bounded = replace(problem, path_bounds=(low, np.minimum(high, 1.2)))
    assert _solve(_cart(), bounded, iterations=2).status is SolveStatus.ITERATIONS


@pytest.mark.parametrize("solver", ["interior point", "ipopt"])
def test_solve_from_its_own_solution_takes_fewer_iterations(solver: Solver, require) -> None:
    if solver == "interior point":
        require("compiler")
    problem = _problem()
    low, high = problem.path_bounds
    problem = replace(problem, path_bounds=(low, np.minimum(high, 1.2)))
    first = _solve(_cart(), problem, solver=solver)
    start = {"x_start": first.x, "u_start": first.u, "h_start": first.h, "near": True}
    again = _solve(_cart(), replace(problem, **start, multipliers=first.multipliers), solver=solver)
    assert again.iterations < first.iterations
    assert again.cost == pytest.approx(first.cost, rel=1e-6)


def test_problem_of_uneven_parts_raises() -> None:
    with pytest.raises(ValueError, match="h_start"):
        replace(_problem(), h_start=np.ones(3))
    with pytest.raises(ValueError, match="step box"):
        replace(_problem(), h_bounds=(1.1, 2.0))
    with pytest.raises(ValueError, match="columns"):
        replace(_problem(), u_start=np.zeros((1, 3)))
    with pytest.raises(ValueError, match="positive"):
        replace(_problem(), h0_s=np.zeros(40))
