"""Minimum-snap splines against a dense solve in monomials, and against what must hold of any optimum."""

from __future__ import annotations

from math import factorial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from trimtab.host.plan.snap import (
    SnapSpline,
    cost_gradient,
    heuristic_durations,
    optimise_durations,
    solve_snap,
)

Array = NDArray[np.float64]
_REST, _MOVING = np.zeros((2, 3)), np.array([[1.0, -2.0, 0.3], [-0.5, 0.0, 1.5]])


def _walk(count: int, seed: int = 0) -> Array:
    return np.cumsum(np.random.default_rng(seed).uniform(-2.0, 2.0, (count, 3)), axis=0)


def _derivative_row(t: float, order: int) -> Array:
    """Of 1, t .. t^7."""
    return np.array(
        [factorial(i) / factorial(i - order) * t ** (i - order) if i >= order else 0.0 for i in range(8)]
    )


def _dense(waypoints: Array, durations: Array, velocities: Array) -> tuple[Array, float]:
    """Monomial coefficients (legs, 8, 3) and cost by one dense KKT system with C4 at the waypoints."""
    legs = len(durations)
    hessian = np.zeros((8 * legs, 8 * legs))
    rows: list[Array] = []
    right: list[Array] = []

    def constrain(entries: dict[int, Array], value: Array) -> None:
        row = np.zeros(8 * legs)
        for leg, coefficients in entries.items():
            row[8 * leg : 8 * leg + 8] = coefficients
        rows.append(row)
        right.append(value)

    for leg, duration in enumerate(durations):
        for i in range(4, 8):
            for j in range(4, 8):
                scale = factorial(i) // factorial(i - 4) * (factorial(j) // factorial(j - 4))
                hessian[8 * leg + i, 8 * leg + j] = scale * duration ** (i + j - 7) / (i + j - 7)
        constrain({leg: _derivative_row(0.0, 0)}, waypoints[leg])
        constrain({leg: _derivative_row(duration, 0)}, waypoints[leg + 1])
        if leg + 1 < legs:
            for order in range(1, 5):
                jump = {leg: _derivative_row(duration, order), leg + 1: -_derivative_row(0.0, order)}
                constrain(jump, np.zeros(3))
    for order in (1, 2, 3):
        start, end = velocities if order == 1 else np.zeros((2, 3))
        constrain({0: _derivative_row(0.0, order)}, start)
        constrain({legs - 1: _derivative_row(durations[-1], order)}, end)
    equal = np.array(rows)
    system = np.block([[hessian, equal.T], [equal, np.zeros((len(equal), len(equal)))]])
    solution = np.linalg.solve(system, np.concatenate([np.zeros((8 * legs, 3)), np.array(right)]))
    found = np.asarray(solution, dtype=np.float64)[: 8 * legs]
    return found.reshape(legs, 8, 3), float(np.einsum("ic,ij,jc->", found, hessian, found))


def _sides(spline: SnapSpline, order: int) -> tuple[Array, Array]:
    """A derivative at each inner waypoint from the left and from the right, each leg interpolated alone."""
    ends: list[list[Array]] = [[], []]
    for leg, duration in enumerate(np.diff(spline.times_s)):
        system = np.array([_derivative_row(t, k) for t in (0.0, duration) for k in range(4)])
        coefficients = np.linalg.solve(system, spline.ends_ned[leg : leg + 2].reshape(8, 3))
        ends[0].append(_derivative_row(0.0, order) @ coefficients)
        ends[1].append(_derivative_row(float(duration), order) @ coefficients)
    return np.array(ends[1][:-1]), np.array(ends[0][1:])


@pytest.mark.parametrize("velocities", [_REST, _MOVING], ids=["at rest", "moving"])
@pytest.mark.parametrize("count", [2, 3, 4, 9])
def test_spline_any_route_equals_dense_solve(count: int, velocities: Array) -> None:
    waypoints = _walk(count)
    durations = np.random.default_rng(1).uniform(0.5, 1.8, count - 1)
    spline = solve_snap(waypoints, durations, velocities)
    coefficients, cost = _dense(waypoints, durations, velocities)
    for order in range(4):
        expected = np.array([_derivative_row(0.0, order) @ leg for leg in coefficients])
        np.testing.assert_allclose(spline.ends_ned[:-1, order], expected, rtol=1e-6, atol=1e-6)
    assert spline.cost == pytest.approx(cost, rel=1e-6)


def test_spline_between_two_points_is_the_known_septic() -> None:
    spline = solve_snap(np.array([[0.0, 0.0, 0.0], [1.0, -2.0, 0.0]]), np.array([1.0]))
    # Snap of 35 s^4 - 84 s^5 + 70 s^6 - 20 s^7, squared and integrated: 100800 a squared metre in a second.
    assert spline.cost == pytest.approx(100_800.0 * 5.0)
    assert not spline.ends_ned[:, 1:].any()


@pytest.mark.parametrize("count", [3, 12, 60])
def test_spline_at_inner_waypoints_is_continuous_to_the_sixth_derivative(count: int) -> None:
    waypoints = _walk(count)
    durations = np.random.default_rng(2).uniform(0.6, 1.5, count - 1)
    spline = solve_snap(waypoints, durations)
    for order in range(7):
        left, right = _sides(spline, order)
        np.testing.assert_allclose(left, right, atol=1e-7 * max(1.0, np.abs(left).max()))


def test_spline_with_uneven_legs_stays_well_conditioned() -> None:
    waypoints = _walk(200)
    durations = 10.0 ** np.random.default_rng(3).uniform(-1.0, 0.7, 199)
    spline = solve_snap(waypoints, durations)
    left, right = _sides(spline, 4)
    assert np.abs(left - right).max() <= 1e-8 * np.abs(left).max()


@given(
    st.integers(0, 1000),
    st.floats(0.2, 5.0),
    st.tuples(*[st.floats(-100.0, 100.0)] * 3),
    st.floats(0.1, 10.0),
)
def test_spline_moved_scaled_and_slowed_keeps_its_shape(
    seed: int, slower: float, offset: tuple[float, float, float], scale: float
) -> None:
    waypoints = _walk(6, seed)
    durations = np.random.default_rng(seed).uniform(0.5, 2.0, 5)
    spline = solve_snap(waypoints, durations)
    moved = solve_snap(scale * waypoints + np.array(offset), slower * durations)
    assert moved.cost == pytest.approx(scale**2 / slower**7 * spline.cost, rel=1e-6)
    for order in range(1, 4):
        expected = scale / slower**order * spline.ends_ned[:, order]
        size = max(1e-3, np.abs(expected).max())
        np.testing.assert_allclose(moved.ends_ned[:, order], expected, atol=1e-7 * size)


@pytest.mark.parametrize("velocities", [_REST, _MOVING], ids=["at rest", "moving"])
def test_cost_gradient_equals_finite_differences(velocities: Array) -> None:
    waypoints = _walk(7)
    durations = np.random.default_rng(4).uniform(0.8, 1.6, 6)
    gradient = cost_gradient(solve_snap(waypoints, durations, velocities))
    for leg in range(6):
        step = np.zeros(6)
        step[leg] = 1e-5
        after, before = (solve_snap(waypoints, durations + sign * step, velocities).cost for sign in (1, -1))
        rise = after - before
        assert gradient[leg] == pytest.approx(rise / 2e-5, rel=1e-6, abs=1e-3)


@pytest.mark.parametrize("count", [2, 3, 9, 60])
def test_optimised_durations_keep_the_total_and_cost_less(count: int) -> None:
    waypoints = _walk(count)
    start = heuristic_durations(waypoints, 1.5 * count)
    durations = optimise_durations(waypoints, 1.5 * count)
    assert durations.sum() == pytest.approx(1.5 * count)
    assert (durations > 0.0).all()
    assert solve_snap(waypoints, durations).cost <= solve_snap(waypoints, start).cost * (1.0 + 1e-12)
    np.testing.assert_array_equal(durations, optimise_durations(waypoints, 1.5 * count))


def test_optimised_durations_of_a_symmetric_route_are_symmetric() -> None:
    waypoints = np.array([[0.0, 0, -1], [2.0, 1, -1], [4.0, -1, -1], [6.0, 1, -1], [8.0, 0, -1]])
    waypoints[:, 1] = [0.0, 1.0, 0.0, -1.0, 0.0]
    durations = optimise_durations(waypoints, 8.0)
    np.testing.assert_allclose(durations, durations[::-1], rtol=1e-4)


@pytest.mark.parametrize(
    ("waypoints", "durations"),
    [
        (np.zeros((1, 3)), np.zeros(0)),
        (np.zeros((3, 2)), np.ones(2)),
        (_walk(3), np.ones(3)),
        (_walk(3), np.array([1.0, 0.0])),
        (_walk(3), np.array([1.0, np.nan])),
        (np.full((3, 3), np.nan), np.ones(2)),
    ],
)
def test_spline_of_bad_arguments_raises(waypoints: Array, durations: Array) -> None:
    with pytest.raises(ValueError, match=r"waypoints|durations"):
        solve_snap(waypoints, durations)
