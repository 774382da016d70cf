"""From other tools' axes to this project's: world NED, body FRD, quaternions Hamilton, w first."""

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
"""World axes by name: the matrix that takes their components to NED. A proper rotation each, so that it
holds for axial vectors too. A z-up room without a north counts as nwu: its x is north.
"""

TO_FRD: dict[str, np.ndarray] = {"frd": np.eye(3), "flu": np.diag([1.0, -1.0, -1.0])}
"""Body axes by name: the matrix that takes their components to FRD."""


def to_ned(vectors: np.ndarray, world: World) -> np.ndarray:
    """Vectors (n, 3) of the named world axes in NED."""
    return vectors @ TO_NED[world].T


def to_frd(vectors: np.ndarray, body: Body) -> np.ndarray:
    """Vectors (n, 3) of the named body axes in FRD: rates, forces and torques alike."""
    return vectors @ TO_FRD[body].T


def q_ned_frd(turn: Rotation, world: World, body: Body) -> np.ndarray:
    """Quaternions (n, 4), w first and w >= 0, of turns that take named body axes to named world axes."""
    matrix = TO_NED[world] @ turn.as_matrix() @ TO_FRD[body].T
    q = Rotation.from_matrix(matrix).as_quat(scalar_first=True)
    return np.where(q[:, :1] < 0.0, -q, q)


def turn_from_quaternion(q: np.ndarray, *, scalar_first: bool) -> Rotation:
    """Return the turns of quaternions (n, 4). Raises ValueError naming the row of one whose norm is not 1."""
    with np.errstate(over="ignore"):
        norm = np.sqrt((q * q).sum(axis=1))
    wrong = np.flatnonzero(~(np.abs(norm - 1.0) < 0.02))
    if len(wrong):
        raise ValueError(f"quaternion of norm {norm[wrong[0]]:.4g} at row {wrong[0]}")
    return Rotation.from_quat(q, scalar_first=scalar_first)


def turn_from_euler(rpy: np.ndarray, *, degrees: bool = False) -> Rotation:
    """Return the turns Rz(yaw) Ry(pitch) Rx(roll) of angles (n, 3) in the order roll, pitch, yaw."""
    return Rotation.from_euler("ZYX", rpy[:, ::-1], degrees=degrees)
