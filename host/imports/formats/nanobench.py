"""Reader of NanoBench CSV flights: a Crazyflie 2.1 in a Vicon room, one row every 10 ms.

The world is z-up (nwu here: the room's x counts as north), the body FLU. Quaternions are body to world with
the scalar last. The accelerometer is in g. Motor commands are 16-bit PWM, clockwise from m1 front right.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from trimtab.host.imports.contents import Contents
from trimtab.host.imports.formats.table import header, table, table_contents
from trimtab.host.imports.frames import q_ned_frd, to_frd, to_ned, turn_from_quaternion
from trimtab.host.imports.recording import (
    Corner,
    ImportFormatError,
    Recording,
    Unknown,
    first_of_equal,
    fresh,
    since_first_us,
)

UNKNOWN: tuple[Unknown, ...] = (
    "thrust-curve", "motor-lag", "mounting-tilt", "frame-tilt", "inertia", "torque", "pose-latency",
)  # fmt: skip
CORNERS: tuple[Corner, Corner, Corner, Corner] = ("front-right", "rear-right", "rear-left", "front-left")
PWM_MAX = 65535.0
STANDARD_GRAVITY = 9.80665
"""m/s^2 in one g of an accelerometer; differs from gravity in the dynamics."""

_POSITION = ("px", "py", "pz")
_QUATERNION = ("qx", "qy", "qz", "qw")
_MOTORS = ("motor_motor_m1", "motor_motor_m2", "motor_motor_m3", "motor_motor_m4")
_GYRO = ("imu_gyro_x", "imu_gyro_y", "imu_gyro_z")
_ACCELEROMETER = ("imu_acc_x", "imu_acc_y", "imu_acc_z")
_BATTERY = "pwr_pm_vbat"
COLUMNS = ("t", *_POSITION, *_QUATERNION, *_MOTORS, *_GYRO, *_ACCELEROMETER, _BATTERY)


def recognises(path: Path, head: bytes) -> bool:
    """Return whether the first line names all columns of NanoBench."""
    return set(COLUMNS) <= set(header(head))


def contents(path: Path) -> Contents:
    """Return the columns of the file, with their rate. Raises ImportFormatError."""
    return table_contents(path, COLUMNS[0])


def read(path: Path | str) -> Recording:
    """Return the flight of a NanoBench CSV file. Raises ImportFormatError with file, column and line."""
    path = Path(path)
    held = table(path, COLUMNS)
    rows = held.columns
    t_us = since_first_us(rows["t"], 1e6, path.name)
    keep = first_of_equal(t_us)
    t_us = t_us[keep]

    def stack(names: tuple[str, ...]) -> np.ndarray:
        return np.column_stack([rows[name][keep] for name in names])

    position, quaternion = stack(_POSITION), stack(_QUATERNION)
    new = fresh(position, quaternion)
    try:
        turn = turn_from_quaternion(quaternion, scalar_first=False)
    except ValueError as error:
        raise ImportFormatError(f"{path.name}: {error}; remove or correct that row") from None
    return Recording(
        source=path.name,
        pose_us=t_us[new],
        p_ned=to_ned(position, "nwu")[new],
        q_ned_frd=q_ned_frd(turn, "nwu", "flu")[new],
        input_us=t_us,
        motor_command=stack(_MOTORS) / PWM_MAX,
        motor_corners=CORNERS,
        imu_us=t_us,
        gyro=to_frd(stack(_GYRO), "flu"),
        specific_force=to_frd(stack(_ACCELEROMETER), "flu") * STANDARD_GRAVITY,
        battery_us=t_us,
        battery_v=rows[_BATTERY][keep],
        unknown=UNKNOWN,
        skipped_rows=held.skipped,
        epoch_us=round(1e6 * float(rows["t"][0])),
    )
