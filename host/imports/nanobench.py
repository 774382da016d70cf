"""Reader of NanoBench CSV flights: a Crazyflie 2.1 in a Vicon room, one row each 10 ms, world z up, scalar
last.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from host.imports.recording import ImportFormatError, Recording, quaternion_from_flu, vector_from_flu

_POSE = ("px", "py", "pz", "qw", "qx", "qy", "qz")
_MOTORS = ("motor_motor_m1", "motor_motor_m2", "motor_motor_m3", "motor_motor_m4")
_GYRO = ("imu_gyro_x", "imu_gyro_y", "imu_gyro_z")
_ACCELEROMETER = ("imu_acc_x", "imu_acc_y", "imu_acc_z")
_BATTERY = "pwr_pm_vbat"
_PWM_MAX = 65535.0
_STANDARD_GRAVITY = 9.80665
UNKNOWN = ("thrust-curve", "motor-lag", "mounting-tilt", "frame-tilt", "inertia", "torque", "pose-latency")


def read(path: Path | str) -> Recording:
    """The flight of a NanoBench CSV file. Raises ImportFormatError naming the file, column and row."""
    path = Path(path)
    needed = ("t", *_POSE, *_MOTORS, *_GYRO, *_ACCELEROMETER, _BATTERY)
    rows = table(path, needed)
    t = rows["t"]
    t_us = np.round((t - t[0]) * 1e6).astype(np.int64)
    keep = np.r_[True, np.diff(t_us) > 0]
    column = {name: values[keep] for name, values in rows.items()}
    t_us = t_us[keep]

    def stack(names: tuple[str, ...]) -> np.ndarray:
        return np.column_stack([column[name] for name in names])

    pose = stack(_POSE)
    return Recording(
        source=path.name,
        pose_us=t_us,
        p_ned=vector_from_flu(pose[:, :3]),
        q_ned_frd=quaternion_from_flu(pose[:, 3:]),
        input_us=t_us,
        motor_command=stack(_MOTORS) / _PWM_MAX,
        imu_us=t_us,
        gyro=vector_from_flu(stack(_GYRO)),
        specific_force=vector_from_flu(stack(_ACCELEROMETER)) * _STANDARD_GRAVITY,
        battery_us=t_us,
        battery_v=column[_BATTERY],
        unknown=UNKNOWN,
    )


def table(path: Path, needed: tuple[str, ...]) -> dict[str, np.ndarray]:
    """The needed columns of a CSV file by name. Raises ImportFormatError naming the file, column and row."""
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            reader = csv.reader(stream)
            header = next(reader, [])
            missing = [name for name in needed if name not in header]
            if missing:
                raise ImportFormatError(f"{path.name}: no column {', '.join(missing)}; is it another format?")
            at = [header.index(name) for name in needed]
            values = []
            for number, row in enumerate(reader, start=2):
                try:
                    values.append([float(row[i]) for i in at])
                except (ValueError, IndexError):
                    bad = next((n for n, i in zip(needed, at, strict=True) if not _is_number(row, i)), "?")
                    raise ImportFormatError(
                        f"{path.name}: line {number}: {bad} is not a number; mend it"
                    ) from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise ImportFormatError(f"{path.name}: not a CSV text file ({error})") from None
    except OSError as error:
        raise ImportFormatError(f"{path}: cannot be read ({error.strerror})") from None
    if len(values) < 2:
        raise ImportFormatError(f"{path.name}: fewer than two rows; nothing to import")
    return dict(zip(needed, np.array(values).T, strict=True))


def _is_number(row: list[str], index: int) -> bool:
    try:
        float(row[index])
    except (ValueError, IndexError):
        return False
    return True
