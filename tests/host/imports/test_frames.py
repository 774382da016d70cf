"""Frame conversions against rotations composed by hand, and against what a person standing there sees."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trimtab.host.imports.frames import (
    TO_FRD,
    TO_NED,
    Body,
    World,
    q_ned_frd,
    to_frd,
    to_ned,
    turn_from_euler,
    turn_from_quaternion,
)

PAIRS = [(world, body) for world in TO_NED for body in TO_FRD]


@pytest.mark.parametrize("world", TO_NED)
def test_vectors_of_world_axes_become_ned(world: World, foreign: SimpleNamespace) -> None:
    v = np.random.default_rng(1).normal(size=(50, 3))
    np.testing.assert_allclose(to_ned(v, world), foreign.WORLDS[world].inv().apply(v), atol=1e-14)


@pytest.mark.parametrize("body", TO_FRD)
def test_vectors_of_body_axes_become_frd(body: Body, foreign: SimpleNamespace) -> None:
    v = np.random.default_rng(2).normal(size=(50, 3))
    np.testing.assert_allclose(to_frd(v, body), foreign.BODIES[body].inv().apply(v), atol=1e-14)


@pytest.mark.parametrize(("world", "body"), PAIRS)
def test_attitudes_become_q_ned_frd(world: World, body: Body, foreign: SimpleNamespace) -> None:
    turn = Rotation.random(200, rng=np.random.default_rng(3))
    q = q_ned_frd(turn, world, body)
    expected = foreign.WORLDS[world].inv() * turn * foreign.BODIES[body]
    assert (q[:, 0] >= 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-12)
    apart = (Rotation.from_quat(q, scalar_first=True).inv() * expected).magnitude()
    assert apart.max() < 1e-12


@pytest.mark.parametrize("matrix", [*TO_NED.values(), *TO_FRD.values()])
def test_change_of_axes_is_a_proper_rotation(matrix: np.ndarray) -> None:
    # Axial vectors (rates, torques) may take the same matrix only then.
    np.testing.assert_array_equal(matrix @ matrix.T, np.eye(3))
    assert round(np.linalg.det(matrix)) == 1


def test_east_and_up_are_what_they_are_called() -> None:
    assert to_ned(np.array([[1.0, 2.0, 3.0]]), "enu").tolist() == [[2.0, 1.0, -3.0]]
    assert to_ned(np.array([[1.0, 2.0, 3.0]]), "nwu").tolist() == [[1.0, -2.0, -3.0]]
    assert to_frd(np.array([[1.0, 2.0, 3.0]]), "flu").tolist() == [[1.0, -2.0, -3.0]]


@pytest.mark.parametrize(("world", "body"), PAIRS)
def test_specific_force_at_rest_upright_points_up(world: World, body: Body, foreign: SimpleNamespace) -> None:
    # An accelerometer that stands level shows +g along its own upward axis, whatever that is called.
    up_in_body = foreign.BODIES[body].apply([[0.0, 0.0, -foreign.G]])
    up_in_world = foreign.WORLDS[world].apply([0.0, 0.0, -1.0])
    heading = Rotation.from_rotvec(np.outer(np.linspace(-3.0, 3.0, 9), up_in_world))
    level = heading * foreign.WORLDS[world] * foreign.BODIES[body].inv()
    R = Rotation.from_quat(q_ned_frd(level, world, body), scalar_first=True)
    felt = R.apply(np.repeat(to_frd(up_in_body, body), 9, axis=0))
    np.testing.assert_allclose(felt, np.tile([0.0, 0.0, -foreign.G], (9, 1)), atol=1e-12)
    np.testing.assert_allclose(R.as_matrix()[:, 2, 2], 1.0, atol=1e-12)


def test_angles_of_a_z_up_vehicle_change_sign_in_pitch_and_yaw() -> None:
    # Nose down is positive pitch in FLU, a turn to the left positive yaw; both are negative in FRD and NED.
    turn = turn_from_euler(np.array([[0.1, 0.2, 0.3]]))
    q = q_ned_frd(turn, "nwu", "flu")
    yaw, pitch, roll = Rotation.from_quat(q, scalar_first=True).as_euler("ZYX")[0]
    np.testing.assert_allclose([roll, pitch, yaw], [0.1, -0.2, -0.3], atol=1e-14)


def test_facing_east_in_enu_is_ninety_degrees_of_yaw() -> None:
    q = q_ned_frd(turn_from_euler(np.zeros((1, 3))), "enu", "flu")
    yaw, pitch, roll = Rotation.from_quat(q, scalar_first=True).as_euler("ZYX", degrees=True)[0]
    np.testing.assert_allclose([roll, pitch, yaw], [0.0, 0.0, 90.0], atol=1e-12)


def test_euler_angles_are_yaw_then_pitch_then_roll() -> None:
    roll, pitch, yaw = 0.4, -0.7, 2.1
    about = {
        "x": [[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]],
        "y": [[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]],
        "z": [[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]],
    }
    expected = np.array(about["z"]) @ about["y"] @ about["x"]
    found = turn_from_euler(np.array([[roll, pitch, yaw]])).as_matrix()[0]
    np.testing.assert_allclose(found, expected, atol=1e-14)
    degrees = turn_from_euler(np.rad2deg([[roll, pitch, yaw]]), degrees=True).as_matrix()[0]
    np.testing.assert_allclose(degrees, expected, atol=1e-14)


def test_quaternion_order_is_told() -> None:
    quarter_about_z = [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]
    first = turn_from_quaternion(np.array([quarter_about_z]), scalar_first=True).as_rotvec()[0]
    last = turn_from_quaternion(np.array([quarter_about_z]), scalar_first=False).as_rotvec()[0]
    np.testing.assert_allclose(first, [0.0, 0.0, np.pi / 2], atol=1e-12)
    np.testing.assert_allclose(last, [np.pi / 2, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("row", [[0.0] * 4, [1.0, 1.0, 0.0, 0.0], [1e200] * 4, [np.nan, 1.0, 0.0, 0.0]])
def test_quaternion_without_unit_norm_is_refused_with_its_row(row: list[float]) -> None:
    with pytest.raises(ValueError, match="at row 1"):
        turn_from_quaternion(np.array([[1.0, 0.0, 0.0, 0.0], row]), scalar_first=True)
