"""Reader of any CSV flight log by a TOML file that says which column is what, in which unit and frame."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from host.imports.nanobench import table
from host.imports.recording import ImportFormatError, Recording
from host.vehicle.strict_toml import Strict, read_strict

Three = tuple[str, str, str]
Four = tuple[str, str, str, str]

_TO_NED = {
    "ned": np.eye(3),
    "nwu": np.diag([1.0, -1.0, -1.0]),
    "enu": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
}
_TO_FRD = {"frd": np.eye(3), "flu": np.diag([1.0, -1.0, -1.0])}
_TIME_US = {"s": 1e6, "ms": 1e3, "us": 1.0}
Unknown = Literal[
    "thrust-curve", "motor-lag", "mounting-tilt", "frame-tilt", "inertia", "torque", "pose-latency"
]


class ColumnMap(Strict):
    """Columns of a CSV flight log. Angles, rates and torques are SI unless their unit key says otherwise."""

    world: Literal["ned", "nwu", "enu"]
    """Axes of positions: north-east-down, north-west-up or east-north-up."""
    body: Literal["frd", "flu"]
    """Axes of rates, forces and torques, and the frame the attitude turns from."""
    time: str
    time_unit: Literal["s", "ms", "us"] = "s"
    position_m: Three
    quaternion: Four | None = None
    quaternion_order: Literal["wxyz", "xyzw"] = "wxyz"
    euler: Three | None = None
    """Roll, pitch and yaw columns, ZYX, of the body axes in the world axes named above."""
    euler_unit: Literal["rad", "deg"] = "rad"
    motor_command: Four | None = None
    """In the order of the vehicle file's rotors."""
    motor_command_full: Annotated[float, Field(gt=0.0)] = 1.0
    """The value that means full command."""
    thrust_n: str | None = None
    torque_n_m: Three | None = None
    gyro: Three | None = None
    gyro_unit: Literal["rad/s", "deg/s"] = "rad/s"
    specific_force: Three | None = None
    specific_force_unit: Literal["m/s2", "g"] = "m/s2"
    battery_v: str | None = None
    unknown: tuple[Unknown, ...] = ()
    """What the log does not determine; tracing estimates it as nuisance."""

    @model_validator(mode="after")
    def _one_attitude_and_one_input(self) -> Self:
        if (self.quaternion is None) == (self.euler is None):
            raise ValueError("attitude: give either quaternion or euler")
        if self.motor_command is not None and self.thrust_n is not None:
            raise ValueError("inputs: give either motor_command or thrust_n, not both")
        if self.torque_n_m is not None and self.thrust_n is None:
            raise ValueError("torque_n_m: needs thrust_n beside it, add it")
        if self.specific_force is not None and self.gyro is None:
            raise ValueError("specific_force: needs gyro beside it, add it")
        return self


def read(path: Path | str, columns: Path | str) -> Recording:
    """The flight of a CSV file as the column map reads it.

    Raises ConfigurationError for the map (exit code 2) and ImportFormatError for the log.
    """
    path, columns = Path(path), Path(columns)
    try:
        text = columns.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ImportFormatError(
            f"{columns}: cannot be read as text ({error}); give a TOML column map"
        ) from None
    chosen = read_strict(text, columns.name, ColumnMap)
    groups = (
        (chosen.time,), chosen.position_m, chosen.quaternion, chosen.euler, chosen.motor_command,
        chosen.torque_n_m, chosen.gyro, chosen.specific_force, (chosen.thrust_n,), (chosen.battery_v,),
    )  # fmt: skip
    rows = table(
        path, tuple(dict.fromkeys(name for group in groups for name in group or () if name is not None))
    )
    t_us = np.round((rows[chosen.time] - rows[chosen.time][0]) * _TIME_US[chosen.time_unit]).astype(np.int64)
    if (np.diff(t_us) <= 0).any():
        line = int(np.flatnonzero(np.diff(t_us) <= 0)[0]) + 3
        raise ImportFormatError(
            f"{path.name}: line {line}: {chosen.time} does not increase; sort or mend the rows"
        )

    def stack(names: tuple[str, ...] | None) -> np.ndarray | None:
        return None if names is None else np.column_stack([rows[name] for name in names])

    to_ned, to_frd = _TO_NED[chosen.world], _TO_FRD[chosen.body]
    gyro, force, torque = stack(chosen.gyro), stack(chosen.specific_force), stack(chosen.torque_n_m)
    motors = stack(chosen.motor_command)
    position = stack(chosen.position_m)
    assert position is not None
    return Recording(
        source=path.name,
        pose_us=t_us,
        p_ned=position @ to_ned.T,
        q_ned_frd=_attitude(chosen, rows, to_ned, to_frd),
        input_us=t_us if motors is not None or chosen.thrust_n is not None else None,
        motor_command=None if motors is None else motors / chosen.motor_command_full,
        thrust_n=None if chosen.thrust_n is None else rows[chosen.thrust_n],
        torque_n_m=None if torque is None else torque @ to_frd.T,
        imu_us=None if gyro is None else t_us,
        gyro=None if gyro is None else (np.deg2rad(gyro) if chosen.gyro_unit == "deg/s" else gyro) @ to_frd.T,
        specific_force=None
        if force is None
        else force @ to_frd.T * (9.80665 if chosen.specific_force_unit == "g" else 1.0),
        battery_us=None if chosen.battery_v is None else t_us,
        battery_v=None if chosen.battery_v is None else rows[chosen.battery_v],
        unknown=chosen.unknown,
    )


def _attitude(
    chosen: ColumnMap, rows: dict[str, np.ndarray], to_ned: np.ndarray, to_frd: np.ndarray
) -> np.ndarray:
    """q_ned_frd (n, 4), w first and w >= 0, from the map's quaternion or Euler angles."""
    if chosen.quaternion is not None:
        q = np.column_stack([rows[name] for name in chosen.quaternion])
        turn = Rotation.from_quat(q, scalar_first=chosen.quaternion_order == "wxyz")
    else:
        assert chosen.euler is not None
        angles = np.column_stack([rows[name] for name in reversed(chosen.euler)])
        turn = Rotation.from_euler("ZYX", angles, degrees=chosen.euler_unit == "deg")
    matrix = to_ned @ turn.as_matrix() @ to_frd.T
    q = Rotation.from_matrix(matrix).as_quat(scalar_first=True)
    return np.where(q[:, :1] < 0, -q, q)
