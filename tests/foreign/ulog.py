"""ULog files, packed message by message."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

MAGIC = b"ULog\x01\x12\x35"
START_US = 5_000_000

Topics = dict[str, tuple[Sequence[str], np.ndarray, np.ndarray]]
"""Fields, times in us and values, by topic."""


def message(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


def ulog_bytes(
    topics: Mapping[str, tuple[Sequence[str], np.ndarray, np.ndarray]], parameters: Mapping[str, float]
) -> bytes:
    """Topics as fields, times in us and values; parameters as floats."""
    data = MAGIC + b"\x01" + struct.pack("<Q", START_US)
    data += message("B", b"\0" * 40)
    for name, (fields, _, _) in topics.items():
        arrays = [field for field in fields if "[" not in field]
        arrays += [f for f in dict.fromkeys(field.partition("[")[0] for field in fields if "[" in field)]
        counts = {a: sum(field.startswith(a + "[") for field in fields) for a in arrays}
        layout = ";".join(f"float[{counts[a]}] {a}" if counts[a] else f"float {a}" for a in arrays)
        data += message("F", f"{name}:uint64_t timestamp;{layout};".encode())
    for key, value in parameters.items():
        text = f"float {key}".encode()
        data += message("P", bytes([len(text)]) + text + struct.pack("<f", value))
    records = []
    for k, (name, (_, t_us, values)) in enumerate(topics.items()):
        data += message("A", struct.pack("<BH", 0, k) + name.encode())
        for t, row in zip(t_us.tolist(), values.tolist(), strict=True):
            records.append((t, struct.pack(f"<HQ{len(row)}f", k, t, *row)))
    return data + b"".join(message("D", body) for _, body in sorted(records, key=lambda r: r[0]))


def array(name: str, count: int) -> list[str]:
    """The fields of an array."""
    return [f"{name}[{k}]" for k in range(count)]


def topics_of(flight: Any) -> Topics:
    """The topics that PX4 logs of a flight in NED and FRD, at several rates."""
    t_us = START_US + np.round(1e6 * flight.t).astype(int)
    q = flight.turn.as_quat(scalar_first=True)
    sensors = np.column_stack([flight.gyro, flight.force])
    # PX4 counts front right, rear left, front left, rear right; the flight clockwise from the first.
    motors = flight.motor[:, [0, 2, 3, 1]]
    return {
        "vehicle_local_position": (["x", "y", "z"], t_us[::4], flight.p[::4]),
        "vehicle_attitude": (array("q", 4), t_us[1::2], q[1::2]),
        "sensor_combined": ([*array("gyro_rad", 3), *array("accelerometer_m_s2", 3)], t_us, sensors),
        "actuator_motors": (array("control", 4), t_us, motors),
        "battery_status": (["voltage_v"], t_us[::50], flight.volt[::50, None]),
    }
