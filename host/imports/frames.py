"""Conversion of other tools' axes to world NED, body FRD and Hamilton quaternions with w first."""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

World = Literal["ned", "nwu", "enu"]
Body = Literal["frd", "flu"]

TO_NED: dict[str, np.ndarray] = {
    "ned": np.eye(3),
    "nwu": np.diag([1.0, -1.0, -1.0]),
    "enu": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
}
"""Matrices from named world axes to NED. All are proper rotations, so they also hold for axial vectors.

In a z-up room without a north, x counts as north (nwu).
"""

TO_FRD: dict[str, np.ndarray] = {"frd": np.eye(3), "flu": np.diag([1.0, -1.0, -1.0])}
"""Matrices from named body axes to FRD."""


def to_ned(vectors: np.ndarray, world: World) -> np.ndarray:
    """Return vectors (n, 3), given in the named world axes, in NED."""
    return vectors @ TO_NED[world].T


def to_frd(vectors: np.ndarray, body: Body) -> np.ndarray:
    """Return vectors (n, 3), given in the named body axes, in FRD: rates, forces or torques."""
    return vectors @ TO_FRD[body].T


def q_ned_frd(turn: Rotation, world: World, body: Body) -> np.ndarray:
    """Return quaternions (n, 4) q_ned_frd, w >= 0, of rotations from named body axes to named world axes."""
    matrix = TO_NED[world] @ turn.as_matrix() @ TO_FRD[body].T
    q = Rotation.from_matrix(matrix).as_quat(scalar_first=True)
    return np.where(q[:, :1] < 0.0, -q, q)


def turn_from_quaternion(q: np.ndarray, *, scalar_first: bool) -> Rotation:
    """Return the rotations of quaternions (n, 4). Raises ValueError with the row of a norm that is not 1."""
    with np.errstate(over="ignore"):
        norm = np.sqrt((q * q).sum(axis=1))
    wrong = np.flatnonzero(~(np.abs(norm - 1.0) < 0.02))
    if len(wrong):
        raise ValueError(f"quaternion of norm {norm[wrong[0]]:.4g} at row {wrong[0]}")
    return Rotation.from_quat(q, scalar_first=scalar_first)


def turn_from_euler(rpy: np.ndarray, *, degrees: bool = False) -> Rotation:
    """Return the rotations Rz(yaw) Ry(pitch) Rx(roll) of angles (n, 3) in the order roll, pitch, yaw."""
    return Rotation.from_euler("ZYX", rpy[:, ::-1], degrees=degrees)
