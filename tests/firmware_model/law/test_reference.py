"""Septic and cubic pieces: exact on polynomials, smooth where they join."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial

from trimtab.firmware_model.law.reference import cubic_acceleration, cubic_coefficients, hermite_yaw, septic

number = st.floats(-5.0, 5.0)


def _node(polynomials, t):
    return [p.deriv(k)(t) if k else p(t) for k in range(4) for p in polynomials]


@settings(max_examples=50)
@given(
    st.lists(st.lists(number, min_size=8, max_size=8), min_size=3, max_size=3),
    st.floats(0.05, 2.0),
    st.floats(0.0, 1.0),
)
def test_septic_through_a_polynomial_of_degree_seven_is_that_polynomial(coefficients, dt, x):
    polynomials = [Polynomial(row) for row in coefficients]
    result = septic(dt, x * dt, _node(polynomials, 0.0), _node(polynomials, dt))
    for k, value in enumerate(result):
        expected = [p.deriv(k)(x * dt) if k else p(x * dt) for p in polynomials]
        # The piece's coefficients are differences of the nodes' numbers: rounding is of their size, per dt^k.
        size = max(1.0, *(abs(c) * dt**power for row in coefficients for power, c in enumerate(row)))
        assert value == pytest.approx(expected, abs=1e-10 * size * max(1.0, dt**-k))


def test_septic_at_its_ends_meets_both_nodes():
    rng = np.random.default_rng(2)
    node0, node1 = tuple(rng.normal(size=12)), tuple(rng.normal(size=12))
    for s, node in ((0.0, node0), (0.3, node1)):
        p, v, a, j, _ = septic(0.3, s, node0, node1)
        assert np.allclose([*p, *v, *a, *j], node, atol=1e-10)


def test_septic_pieces_that_share_a_node_join_with_continuous_jerk():
    rng = np.random.default_rng(3)
    nodes = rng.normal(size=(3, 12))
    end, start = septic(0.2, 0.2, nodes[0], nodes[1]), septic(0.5, 0.0, nodes[1], nodes[2])
    for before, after in zip(end[:4], start[:4], strict=True):
        assert np.allclose(before, after, atol=1e-9)
    assert not np.allclose(end[4], start[4], atol=1.0)  # snap jumps: the pieces are C3 and no more


@given(st.lists(number, min_size=4, max_size=4), st.floats(0.05, 2.0), st.floats(0.0, 1.0))
def test_hermite_yaw_through_a_cubic_is_that_cubic(coefficients, dt, x):
    cubic = Polynomial(coefficients)
    rate = cubic.deriv()
    yaw, yaw_rate = hermite_yaw(dt, x * dt, cubic(0.0), rate(0.0), cubic(dt), rate(dt))
    assert yaw == pytest.approx(cubic(x * dt), abs=1e-12)
    assert yaw_rate == pytest.approx(rate(x * dt), abs=1e-11)
    own = cubic_coefficients(dt, cubic(0.0), rate(0.0), cubic(dt), rate(dt))
    assert cubic_acceleration(own, x * dt) == pytest.approx(rate.deriv()(x * dt), abs=1e-9)


def test_hermite_yaw_between_equal_nodes_at_rest_is_held():
    assert hermite_yaw(1.0, 0.37, 2.5, 0.0, 2.5, 0.0) == (2.5, 0.0)
