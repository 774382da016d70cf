"""The assembled problem against CasADi's own derivatives, and solves with known optima."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from host.plan.stage import StageModel, build_stage
from host.plan.transcription import Assembly, Problem, SolveStatus, solve

INF = np.inf


def _cart(weigh_time: bool = True) -> StageModel:
    """A point mass: x = (p, v), u = force; cost u^2; bounded row: v."""
    return StageModel(
        nx=2,
        nu=1,
        np=1,
        derivative=lambda x, u: ca.vertcat(x[1], u[0]),
        residual=None,
        effort=lambda x, u, p: p[0] * u[0] * u[0],
        path=lambda x, u, p: x[1],
        network=None,
        augmented=False,
        weigh_time=weigh_time,
    )


def _problem(
    *, legs: tuple[int, ...] = (20, 20), shared: bool = True, total: tuple[float, float] = (1.0, 1.0)
) -> Problem:
    """Rest to rest over one metre in a second."""
    count = sum(legs)
    low, high = np.full((2, count + 1), -INF), np.full((2, count + 1), INF)
    low[:, 0] = high[:, 0] = 0.0
    low[:, -1] = high[:, -1] = (1.0, 0.0)
    leg_of = np.repeat(np.arange(len(legs)), legs)
    return Problem(
        leg_of=leg_of,
        shared_steps=shared,
        h0_s=np.full(count, 1.0 / count),
        parameters=np.ones((1, count)),
        x_bounds=(low, high),
        u_bounds=(np.full((1, count), -INF), np.full((1, count), INF)),
        path_bounds=(np.full((1, count), -INF), np.full((1, count), INF)),
        h_bounds=(0.5, 2.0),
        total_bounds_s=total,
        x_start=np.zeros((2, count + 1)),
        u_start=np.zeros((1, count)),
        h_start=np.ones(len(legs) if shared else count),
        step_penalty=0.3,
    )


def _solve(model: StageModel, problem: Problem, iterations: int = 200):
    return solve(model, build_stage(model), problem, tolerance=1e-9, max_iterations=iterations)


@pytest.mark.parametrize("shared", [True, False])
def test_assembled_derivatives_equal_automatic_ones(shared: bool) -> None:
    model, problem = _cart(), _problem(legs=(3, 2), shared=shared)
    whole = Assembly(model, build_stage(model), problem)
    w, f, g = whole.nlp["x"], whole.nlp["f"], whole.nlp["g"]
    sigma, lam = ca.MX.sym("sigma"), ca.MX.sym("lam", g.shape[0])
    oracle = ca.Function(
        "oracle",
        [w, sigma, lam],
        [ca.gradient(f, w), ca.jacobian(g, w), ca.triu(ca.hessian(sigma * f + ca.dot(lam, g), w)[0])],
    )
    rng = np.random.default_rng(0)
    point, weights = rng.uniform(0.5, 1.5, w.shape[0]), rng.standard_normal(g.shape[0])
    gradient, jacobian, hessian = oracle(point, 1.7, weights)
    found_f = whole.derivatives["nlp_grad_f"](point, [])[1]
    found_g = whole.derivatives["nlp_jac_g"](point, [])[1]
    found_h = whole.derivatives["nlp_hess_l"](point, [], 1.7, weights)
    assert found_f.sparsity().is_dense()
    for found, expected in ((found_f, gradient), (found_g, jacobian), (found_h, hessian)):
        np.testing.assert_allclose(np.array(ca.DM(found)), np.array(ca.DM(expected)), atol=1e-12)


def test_solve_of_the_rest_to_rest_cart_reaches_the_known_optimum() -> None:
    solution = _solve(_cart(), _problem())
    # The least integral of u^2 is 12 m^2/s^3; a force held over 40 intervals costs 1 + 1/N^2 as much.
    assert solution.status is SolveStatus.SOLVED
    assert solution.cost == pytest.approx(12.0 * (1.0 + 1.0 / 40**2), rel=2e-4)
    np.testing.assert_allclose(solution.h, 1.0, atol=1e-2)
    times = solution.t_s
    np.testing.assert_allclose(solution.x[0], 3.0 * times**2 - 2.0 * times**3, atol=2e-3)


def test_solve_with_total_time_free_takes_all_it_may() -> None:
    problem = replace(_problem(total=(0.8, 1.25)), step_penalty=0.0)
    solution = _solve(_cart(), problem)
    assert solution.t_s[-1] == pytest.approx(1.25, abs=1e-6)
    assert solution.cost == pytest.approx(12.0 / 1.25**3, rel=2e-3)


def test_solve_keeps_path_and_step_bounds() -> None:
    problem = _problem()
    low, high = problem.path_bounds
    solution = _solve(_cart(), replace(problem, path_bounds=(low, np.minimum(high, 1.2))))
    assert solution.x[1].max() <= 1.2 + 1e-7
    assert (solution.h >= 0.5 - 1e-7).all()
    assert solution.t_s[-1] == pytest.approx(1.0, abs=1e-9)


def test_solve_per_interval_may_use_uneven_steps_at_no_higher_cost() -> None:
    shared = _solve(_cart(), replace(_problem(), step_penalty=0.0))
    single = _solve(_cart(), replace(_problem(shared=False), step_penalty=0.0))
    assert single.cost <= shared.cost + 1e-9


def test_unweighted_sum_rewards_long_steps_where_force_is_needed() -> None:
    # The paper's sum without h_k: a force held for longer costs no more, so steps crowd where none is needed.
    problem = replace(_problem(legs=(10, 10, 10, 10)), step_penalty=0.0)
    weighted, plain = _solve(_cart(), problem), _solve(_cart(weigh_time=False), problem)
    assert plain.h[0] > weighted.h[0] + 0.05


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


def test_solve_from_its_own_solution_takes_fewer_iterations() -> None:
    problem = _problem()
    low, high = problem.path_bounds
    problem = replace(problem, path_bounds=(low, np.minimum(high, 1.2)))
    first = _solve(_cart(), problem)
    again = _solve(
        _cart(),
        replace(problem, x_start=first.x, u_start=first.u, h_start=first.h, warm=first.multipliers),
    )
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
