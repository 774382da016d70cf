"""The minimiser of the leg times, against scipy's L-BFGS-B."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from trimtab.host.plan.descent import minimise_in_box


def _function(matrix, centre):
    """A convex function with curvatures that differ by 1e4, and its gradient."""

    def of(x):
        away = matrix @ (x - centre)
        return float(np.log(np.cosh(away)).sum()), matrix.T @ np.tanh(away)

    return of


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("half_width", [0.3, 10.0], ids=["with bounds active", "free"])
def test_minimum_equals_scipys(seed, half_width):
    rng = np.random.default_rng(seed)
    size = 12
    matrix = rng.normal(size=(size, size)) * np.logspace(-1, 1, size)
    function = _function(matrix, rng.normal(size=size))
    low, high = np.full(size, -half_width), np.full(size, half_width)
    found = minimise_in_box(function, np.zeros(size), low, high, iterations=500, decrease=0.0, slope=1e-6)
    expected = minimize(
        function,
        np.zeros(size),
        jac=True,
        method="L-BFGS-B",
        bounds=list(zip(low, high, strict=True)),
        options={"ftol": 0.0, "gtol": 1e-6, "maxiter": 5000},
    )
    assert ((found >= low) & (found <= high)).all()
    assert function(found)[0] <= expected.fun + 1e-7
    assert (np.abs(found) >= half_width).any() == (half_width < 1.0)


def test_start_at_the_minimum_is_returned():
    x = np.array([1.0, -2.0])
    bound = np.full(2, 5.0)
    found = minimise_in_box(
        _function(np.eye(2), x), x, -bound, bound, iterations=10, decrease=1e-9, slope=1e-7
    )
    np.testing.assert_array_equal(found, x)


def test_function_that_is_not_finite_beside_the_start_ends_there():
    def wall(x):
        return (float(x[0]) if x[0] == 0.0 else np.nan), np.ones(1)

    found = minimise_in_box(
        wall, np.zeros(1), -np.ones(1), np.ones(1), iterations=10, decrease=1e-9, slope=1e-7
    )
    np.testing.assert_array_equal(found, [0.0])
