"""CSV files, numbers written as text."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from tests.foreign.flight import G, MadeUp, in_axes

Columns = Mapping[str, Sequence[object] | np.ndarray]


def write_csv(path: Path, columns: Columns) -> Path:
    """A CSV file of these columns, numbers to 12 digits."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        for row in zip(*columns.values(), strict=True):
            writer.writerow([cell if isinstance(cell, str) else f"{cell:.12g}" for cell in row])
    return path


def nanobench_columns(flight: MadeUp) -> dict[str, np.ndarray]:
    """The columns that NanoBench has and we read, with one that we do not."""
    f = in_axes(flight, "nwu", "flu")
    q = f.turn.as_quat()
    named = {"t": 1772660536.0 + f.t, "note": np.zeros(len(f.t))}
    named |= {f"p{axis}": f.p[:, i] for i, axis in enumerate("xyz")}
    named |= {f"q{axis}": q[:, i] for i, axis in enumerate("xyzw")}
    named |= {f"imu_gyro_{axis}": f.gyro[:, i] for i, axis in enumerate("xyz")}
    named |= {f"imu_acc_{axis}": f.force[:, i] / G for i, axis in enumerate("xyz")}
    named |= {f"motor_motor_m{i + 1}": 65535.0 * f.motor[:, i] for i in range(4)}
    return named | {"pwr_pm_vbat": f.volt}
