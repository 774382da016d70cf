"""Minima of quadratics within bounds, against a bounded search."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from trimtab.host.trace.bounds import exact_minimum, minimise_sums


def random_quadratics(count: int, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return square roots of Hessians (count, size, size) with similar components, and minima."""
    rng = np.random.default_rng(4)
    root = rng.standard_normal((count, size, size)) + 3.0 * rng.standard_normal((count, size, 1))
    return root, 2.0 * rng.standard_normal((count, size))


def test_minimum_in_a_box_is_that_of_a_bounded_search() -> None:
    """In most of these quadratics a component must be freed again after it was fixed at its bound."""
    root, minimum = random_quadratics(200, 8)
    lower, upper = -np.linspace(0.0, 1.0, 8), np.linspace(1.0, 0.0, 8)
    found = exact_minimum(root.swapaxes(1, 2) @ root, minimum, lower, upper)
    for A, free, at in zip(root, minimum, found, strict=True):
        best = lsq_linear(A, A @ free, (lower - 1e-12, upper + 1e-12), tol=1e-14, method="bvls").x
        np.testing.assert_allclose(at, best, atol=1e-6)


def test_minimum_inside_the_box_is_unchanged() -> None:
    root, minimum = random_quadratics(3, 4)
    bound = np.full(4, 99.0)
    np.testing.assert_array_equal(exact_minimum(root.swapaxes(1, 2) @ root, minimum, -bound, bound), minimum)
    np.testing.assert_array_equal(
        exact_minimum(np.eye(2), np.ones(2), -np.ones(2), 2.0 * np.ones(2)), np.ones(2)
    )


def test_limits_of_a_parameter_that_adds_to_another_are_those_of_the_sum() -> None:
    """The second parameter adds to the first: 1 and 1 - 3 would be best, but the sum must not be negative."""
    at, added = np.array([0.5, 0.5]), np.array([-1, 0])
    limits = np.zeros(2), np.full(2, 9.0)
    step = minimise_sums(np.eye(2), np.array([1.0, -3.0]) - at, at, limits, added)
    assert at + step == pytest.approx([2.0, -2.0])
    free = minimise_sums(np.eye(2), np.array([1.0, 3.0]) - at, at, limits, added)
    assert at + free == pytest.approx([1.0, 3.0])
