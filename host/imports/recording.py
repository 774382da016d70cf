"""What every foreign log is turned into before it is written as a flight log."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np


class ImportFormatError(ValueError):
    """A foreign log that is not what its reader expects; the message names the file, the field and the
    remedy.
    """

    exit_code = 5


@dataclass(frozen=True, kw_only=True)
class Recording:
    """A foreign flight in this project's frames and units: world NED, body FRD, SI; times in us since its
    first row.

    pose_us (n,), p_ned (n, 3), q_ned_frd (n, 4) w first. Inputs at input_us (m,): motor_command (m, 4) in
    0..1 in the vehicle file's rotor order, or thrust_n (m,) with torque_n_m (m, 3). gyro (k, 3),
    specific_force (k, 3) at imu_us. battery_v at battery_us. p_ref_ned (m, 3) and v_ref_ned (m, 3) at
    reference_us. mass_kg: the mass its controller was given. `unknown`: what the recording does not
    determine and tracing estimates as nuisance.
    """

    source: str
    pose_us: np.ndarray
    p_ned: np.ndarray
    q_ned_frd: np.ndarray
    unknown: tuple[str, ...]
    input_us: np.ndarray | None = None
    motor_command: np.ndarray | None = None
    thrust_n: np.ndarray | None = None
    torque_n_m: np.ndarray | None = None
    imu_us: np.ndarray | None = None
    gyro: np.ndarray | None = None
    specific_force: np.ndarray | None = None
    battery_us: np.ndarray | None = None
    battery_v: np.ndarray | None = None
    reference_us: np.ndarray | None = None
    p_ref_ned: np.ndarray | None = None
    v_ref_ned: np.ndarray | None = None
    mass_kg: float | None = None

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray) and not np.isfinite(value).all():
                row = int(np.argwhere(~np.isfinite(np.atleast_2d(value.T).T))[0][0])
                raise ImportFormatError(
                    f"{self.source}: {field.name} is not finite at row {row}; cut or mend that row"
                )
        for name in ("pose_us", "input_us", "imu_us", "battery_us", "reference_us"):
            t = getattr(self, name)
            if t is not None and (len(t) < 2 or (np.diff(t) <= 0).any()):
                raise ImportFormatError(
                    f"{self.source}: {name} must hold two or more strictly increasing times"
                )
        if len(self.p_ned) != len(self.pose_us) or len(self.q_ned_frd) != len(self.pose_us):
            raise ImportFormatError(
                f"{self.source}: positions and attitudes differ in length from their times"
            )


def vector_from_flu(v: np.ndarray) -> np.ndarray:
    """Vectors (n, 3) with y and z negated: body FLU to FRD, and a z-up world to the NED it shares north
    with.
    """
    return v * np.array([1.0, -1.0, -1.0])


def quaternion_from_flu(q_wxyz: np.ndarray) -> np.ndarray:
    """Unit q_ned_frd (n, 4), w first and w >= 0, from q (n, 4) that turns FLU body vectors into a z-up
    world.
    """
    q = q_wxyz * np.array([1.0, 1.0, -1.0, -1.0])
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    return np.where(q[:, :1] < 0, -q, q)
