"""Flat outputs to state and back, with finite differences along a flight as independent check."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial import Polynomial

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.flatness import Body, flat_attitude, flat_full, flat_rates
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.firmware_model.law.rotations import matrix_to_euler

BODY = Body(0.752, (2.5e-3, 2.1e-3, 4.3e-3))
small = st.floats(-3.0, 3.0)
flight = st.tuples(*(st.lists(small, min_size=5, max_size=5) for _ in range(4)))


def _flat(coefficients, t):
    """a, j, snap, yaw, yaw rate, yaw acceleration of polynomial accelerations and yaw."""
    *accelerations, yaw = (Polynomial(row) for row in coefficients)
    a = [p(t) for p in accelerations]
    j = [p.deriv(1)(t) for p in accelerations]
    snap = [p.deriv(2)(t) for p in accelerations]
    return a, j, snap, yaw(t), yaw.deriv(1)(t), yaw.deriv(2)(t)


def _full(coefficients, t):
    a, j, snap, yaw, yaw_rate, yaw_accel = _flat(coefficients, t)
    R, rate, rate_dot, thrust, torque = flat_full(FLOAT, a, j, snap, yaw, yaw_rate, BODY, yaw_accel)
    return np.array(R).reshape(3, 3), np.array(rate), np.array(rate_dot), thrust, np.array(torque)


@given(flight)
def test_flat_full_to_state_and_back_returns_the_flat_outputs(coefficients):
    a, j, _, yaw, yaw_rate, _ = _flat(coefficients, 0.0)
    R, rate, _, thrust, _ = _full(coefficients, 0.0)
    assert np.allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-12)
    e3 = np.array([0.0, 0.0, 1.0])
    assert np.allclose(GRAVITY * e3 - R @ e3 * thrust / BODY.mass_kg, a, atol=1e-11)
    thrust_dot = -BODY.mass_kg * np.dot(j, R @ e3)
    back = -(R @ e3) * thrust_dot / BODY.mass_kg - R @ np.cross(rate, e3) * thrust / BODY.mass_kg
    assert np.allclose(back, j, atol=1e-11)
    roll, pitch, heading = matrix_to_euler(FLOAT, tuple(R.ravel()))
    assert np.angle(np.exp(1j * (heading - yaw))) == pytest.approx(0.0, abs=1e-11)
    heading_rate = (np.sin(roll) * rate[1] + np.cos(roll) * rate[2]) / np.cos(pitch)
    assert heading_rate == pytest.approx(yaw_rate, abs=1e-10)


@given(flight)
def test_flat_full_along_a_flight_matches_finite_differences(coefficients):
    h = 1e-5
    R, rate, rate_dot, _, _ = _full(coefficients, 0.0)
    before, after = _full(coefficients, -h), _full(coefficients, h)
    spin = R.T @ (after[0] - before[0]) / (2 * h)
    scale = 1.0 + np.abs(rate_dot).max() ** 2
    assert np.allclose((spin[2, 1], spin[0, 2], spin[1, 0]), rate, atol=1e-7 * scale)
    assert np.allclose((after[1] - before[1]) / (2 * h), rate_dot, atol=1e-6 * scale)


@given(flight)
def test_flat_full_torque_does_the_work_of_the_rotation_alone(coefficients):
    """omega . tau is the change of kinetic energy omega . J omega': the gyroscopic torque does no work."""
    _, rate, rate_dot, _, torque = _full(coefficients, 0.0)
    J = np.array(BODY.inertia)
    scale = 1e-12 * (1.0 + np.abs(rate_dot).max() + np.abs(rate).max() ** 3)
    assert np.dot(rate, torque) == pytest.approx(np.dot(rate, J * rate_dot), abs=scale)


@given(flight, st.floats(-7.0, 7.0))
def test_flat_full_of_a_turned_flight_differs_only_by_that_turn(coefficients, turn):
    c, s = np.cos(turn), np.sin(turn)
    x, y, z, (yaw, *rest) = coefficients
    turned = (
        [c * a - s * b for a, b in zip(x, y, strict=True)],
        [s * a + c * b for a, b in zip(x, y, strict=True)],
    )
    R, *body = _full(coefficients, 0.0)
    R_turned, *body_turned = _full((*turned, z, (yaw + turn, *rest)), 0.0)
    assert np.allclose(R_turned, np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ R, atol=1e-12)
    for one, other in zip(body, body_turned, strict=True):
        assert np.allclose(one, other, rtol=1e-9, atol=1e-9)


def test_flat_attitude_and_rates_are_those_of_flat_full():
    coefficients = ([1.0, 9.0, 3.0], [-2.0, 4.0, 1.0], [3.0, -5.0, 2.0], [0.7, 1.1, 0.3])
    a, j, _, yaw, yaw_rate, _ = _flat(coefficients, 0.0)
    R, rate, _, thrust, _ = _full(coefficients, 0.0)
    R_flat, specific_thrust = flat_attitude(FLOAT, a, yaw)
    assert np.allclose(R_flat, R.ravel())
    assert specific_thrust * BODY.mass_kg == pytest.approx(thrust)
    assert np.allclose(flat_rates(FLOAT, a, j, yaw, yaw_rate), rate)


def test_flat_attitude_in_free_fall_stays_finite():
    R, thrust = flat_attitude(FLOAT, (0.0, 0.0, GRAVITY), 0.3)
    assert np.isfinite(R).all()
    assert thrust < 1e-4


def test_flat_full_at_hover_carries_the_weight_without_torque():
    _, rate, rate_dot, thrust, torque = flat_full(FLOAT, (0.0,) * 3, (0.0,) * 3, (0.0,) * 3, 1.2, 0.0, BODY)
    assert thrust == pytest.approx(BODY.mass_kg * GRAVITY)
    assert not any((*rate, *rate_dot, *torque))
