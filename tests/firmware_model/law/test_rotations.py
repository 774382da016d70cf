"""Rotations: groups laws, and scipy's independent implementation as oracle."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from trimtab.firmware_model.law import rotations as rot
from trimtab.firmware_model.law.ops import FLOAT

angle = st.floats(-3.0, 3.0)
vector = st.tuples(angle, angle, angle)
pitch = st.floats(-1.5, 1.5)


def _matrix(R):
    return np.array(R).reshape(3, 3)


def _quaternion(rotvec):
    return rot.quat_exp(FLOAT, rotvec)


@given(vector)
def test_quat_to_matrix_of_a_unit_quaternion_is_a_rotation(rotvec):
    R = _matrix(rot.quat_to_matrix(FLOAT, _quaternion(rotvec)))
    assert np.allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-14)
    assert np.allclose(R, Rotation.from_rotvec(rotvec).as_matrix(), atol=1e-14)


@given(vector, vector)
def test_quat_multiply_composes_rotations(a, b):
    q, r = _quaternion(a), _quaternion(b)
    product = _matrix(rot.quat_to_matrix(FLOAT, rot.quat_multiply(q, r)))
    parts = _matrix(rot.quat_to_matrix(FLOAT, q)) @ _matrix(rot.quat_to_matrix(FLOAT, r))
    assert np.allclose(product, parts, atol=1e-14)
    identity = rot.quat_multiply(rot.quat_conjugate(q), q)
    assert np.allclose(identity, (1.0, 0.0, 0.0, 0.0), atol=1e-14)


@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-9, 0.999e-4, 1.001e-4, 1e-3, 1.0, math.pi])
def test_quat_exp_near_and_far_from_zero_is_exact(size):
    axis = np.array([2.0, -3.0, 6.0]) / 7.0
    expected = (math.cos(0.5 * size), *(axis * math.sin(0.5 * size)))
    assert _quaternion(tuple(size * axis)) == pytest.approx(expected, rel=1e-14, abs=1e-300)


def test_quat_normalize_of_zero_stays_finite():
    assert rot.quat_normalize(FLOAT, (0.0, 0.0, 0.0, 0.0)) == (0.0, 0.0, 0.0, 0.0)


@given(angle, pitch, angle)
def test_euler_angles_pass_through_matrix_and_quaternion(roll, tilt, yaw):
    R = rot.euler_to_matrix(FLOAT, (roll, tilt, yaw))
    assert np.allclose(_matrix(R), Rotation.from_euler("ZYX", (yaw, tilt, roll)).as_matrix(), atol=1e-14)
    assert rot.matrix_to_euler(FLOAT, R) == pytest.approx((roll, tilt, yaw), abs=1e-12)
    from_quaternion = rot.quat_to_matrix(FLOAT, rot.quat_from_euler(FLOAT, roll, tilt, yaw))
    assert np.allclose(from_quaternion, R, atol=1e-14)


@given(angle, st.floats(-1.3, 1.3), angle, vector)
def test_euler_rates_integrate_to_the_body_rate(roll, tilt, yaw, rate):
    """A small step along W(Theta) omega turns the matrix by exp(omega dt): second order in dt."""
    dt = 1e-6
    theta = (roll, tilt, yaw)
    step = dt * np.array(rot.euler_rates(FLOAT, theta, rate))
    before, after = (rot.euler_to_matrix(FLOAT, tuple(theta + sign * step)) for sign in (-1.0, 1.0))
    change = _matrix(before).T @ _matrix(after)
    assert np.allclose(Rotation.from_matrix(change).as_rotvec() / (2 * dt), rate, atol=1e-6)


@given(vector, vector)
def test_mat_t_vec_undoes_mat_vec(rotvec, v):
    R = rot.quat_to_matrix(FLOAT, _quaternion(rotvec))
    assert rot.mat_t_vec(R, rot.mat_vec(R, v)) == pytest.approx(v, abs=1e-13)
    assert rot.dot(rot.mat_vec(R, v), rot.mat_vec(R, v)) == pytest.approx(rot.dot(v, v), abs=1e-12)


@given(vector, vector)
def test_cross_agrees_with_numpy(a, b):
    assert np.allclose(rot.cross(a, b), np.cross(a, b), atol=1e-14)


@given(vector, vector)
def test_attitude_error_is_sine_times_axis_of_the_turn(desired, turn):
    """From R_des to R = R_des exp(turn): sin(|turn|) turn / |turn|."""
    R_des = rot.quat_to_matrix(FLOAT, _quaternion(desired))
    q = rot.quat_multiply(_quaternion(desired), _quaternion(turn))
    error = rot.attitude_error(R_des, rot.quat_to_matrix(FLOAT, q))
    size = math.sqrt(sum(x * x for x in turn))
    expected = np.array(turn) * np.sinc(size / math.pi)
    assert np.allclose(error, expected, atol=1e-13)
