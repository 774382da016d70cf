"""Conversion of other tools' axes to world NED, body FRD and Hamilton quaternions with w first."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from scipy.spatial.transform import Rotation

World = Literal["ned", "nwu", "enu"]
Body = Literal["frd", "flu"]

TO_NED: dict[str, Annotated[np.ndarray, "3 3"]] = {
    "ned": np.eye(3),
    "nwu": np.diag([1.0, -1.0, -1.0]),
    "enu": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
}
"""Matrices from named world axes to NED. All are proper rotations, so they also hold for axial vectors.

In a z-up room without a north, x counts as north (nwu).
"""

TO_FRD: dict[str, Annotated[np.ndarray, "3 3"]] = {"frd": np.eye(3), "flu": np.diag([1.0, -1.0, -1.0])}
"""Matrices from named body axes to FRD."""


def to_ned(vectors: Annotated[np.ndarray, "vectors 3"], world: World) -> Annotated[np.ndarray, "vectors 3"]:
    """Return vectors, given in the named world axes, in NED."""
    return vectors @ TO_NED[world].T


def to_frd(vectors: Annotated[np.ndarray, "vectors 3"], body: Body) -> Annotated[np.ndarray, "vectors 3"]:
    """Return vectors, given in the named body axes, in FRD: rates, forces or torques."""
    return vectors @ TO_FRD[body].T


def q_ned_frd(turn: Rotation, world: World, body: Body) -> Annotated[np.ndarray, "rotations 4"]:
    """Return quaternions q_ned_frd, w >= 0, of rotations from named body axes to named world axes."""
    matrix = TO_NED[world] @ turn.as_matrix() @ TO_FRD[body].T
    q = Rotation.from_matrix(matrix).as_quat(scalar_first=True)
    return np.where(q[:, :1] < 0.0, -q, q)


def turn_from_quaternion(q: Annotated[np.ndarray, "rotations 4"], *, scalar_first: bool) -> Rotation:
    """Return the rotations of quaternions. Raises ValueError with the row of a norm that is not 1."""
    with np.errstate(over="ignore"):
        norm = np.sqrt((q * q).sum(axis=1))
    wrong = np.flatnonzero(~(np.abs(norm - 1.0) < 0.02))
    if len(wrong):
        raise ValueError(f"quaternion of norm {norm[wrong[0]]:.4g} at row {wrong[0]}")
    return Rotation.from_quat(q, scalar_first=scalar_first)


def turn_from_euler(rpy: Annotated[np.ndarray, "rotations 3"], *, degrees: bool = False) -> Rotation:
    """Return the rotations Rz(yaw) Ry(pitch) Rx(roll) of angles in the order roll, pitch, yaw."""
    return Rotation.from_euler("ZYX", rpy[:, ::-1], degrees=degrees)
