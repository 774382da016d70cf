"""DataFlash logs, packed message by message."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

import numpy as np

START_US = 7_000_000
LAYOUTS = {"Q": "Q", "f": "f", "B": "B", "H": "H", "N": "16s"}
FORMATS = {
    "FMT": (0x80, "BBnNZ", "Type,Length,Name,Format,Columns"),
    "PARM": (64, "QNf", "TimeUS,Name,Value"),
    "ATT": (65, "Qfff", "TimeUS,Roll,Pitch,Yaw"),
    "XKF1": (66, "QBfff", "TimeUS,C,PN,PE,PD"),
    "IMU": (67, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "RCOU": (68, "QHHHH", "TimeUS,C1,C2,C3,C4"),
    "BAT": (69, "QBf", "TimeUS,Instance,Volt"),
}
HEAD = b"\xa3\x95"


def packed(name: str, *values: Any) -> bytes:
    number, letters, _ = FORMATS[name]
    layout = "".join(LAYOUTS[letter] for letter in letters)
    return HEAD + bytes([number]) + struct.pack(f"<{layout}", *values)


def definitions() -> bytes:
    data = b""
    for name, (number, letters, columns) in FORMATS.items():
        size = (
            89 if name == "FMT" else 3 + struct.calcsize("<" + "".join(LAYOUTS[letter] for letter in letters))
        )
        body = struct.pack("<BB4s16s64s", number, size, name.encode(), letters.encode(), columns.encode())
        data += HEAD + bytes([0x80]) + body
    return data


def log_bytes(flight: Any, parameters: Mapping[str, float], rows: int | None = None) -> bytes:
    """The flight with two estimators and two IMUs, of which the second ones are wrong."""
    data = definitions()
    data += b"".join(packed("PARM", START_US, key.encode(), value) for key, value in parameters.items())
    yaw, pitch, roll = np.degrees(flight.turn.as_euler("ZYX")).T
    pulses = np.round(1000 + 1000 * flight.motor).astype(int)[:, [0, 2, 3, 1]]
    for k, t in enumerate((START_US + np.round(1e6 * flight.t).astype(int))[:rows].tolist()):
        data += packed("IMU", t, 0, *flight.gyro[k], *flight.force[k]) + packed("IMU", t, 1, *[9.0] * 6)
        data += packed("RCOU", t, *pulses[k].tolist()) + packed("ATT", t, roll[k], pitch[k], yaw[k])
        if k % 4 == 0:
            data += packed("XKF1", t, 0, *flight.p[k]) + packed("XKF1", t, 1, 1.0, 2.0, 3.0)
            data += packed("BAT", t, 0, flight.volt[k])
    return data
