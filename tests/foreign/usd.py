"""Crazyflie uSD logs, packed record by record."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence

import numpy as np

from tests.foreign.flight import MadeUp, in_axes

USD_VARIABLES = (
    ("stateEstimateZ.x", "h"), ("stateEstimateZ.y", "h"), ("stateEstimateZ.z", "h"),
    ("ctrltargetZ.x", "h"), ("ctrltargetZ.y", "h"), ("ctrltargetZ.z", "h"),
    ("ctrltargetZ.vx", "h"), ("ctrltargetZ.vy", "h"), ("ctrltargetZ.vz", "h"),
    ("ctrlLee.rpyx", "f"), ("ctrlLee.rpyy", "f"), ("ctrlLee.rpyz", "f"),
    ("ctrlLee.omegax", "f"), ("ctrlLee.omegay", "f"), ("ctrlLee.omegaz", "f"),
    ("ctrlLee.thrustSI", "f"),
    ("ctrlLee.torquex", "f"), ("ctrlLee.torquey", "f"), ("ctrlLee.torquez", "f"),
    ("pm.vbatMV", "H"), ("radio.rssi", "B"),
)  # fmt: skip


def usd_rows(flight: MadeUp) -> list[list[float]]:
    """The values of USD_VARIABLES, a row each sample; the torque counts up, so that its axes can be told."""
    f = in_axes(flight, "nwu", "flu")
    mm = np.round(1000.0 * f.p).astype(int).tolist()
    rpy = f.turn.as_euler("ZYX")[:, ::-1].tolist()
    return [
        [*mm[k], *mm[k], 1, 2, 3, *rpy[k], *f.gyro[k].tolist(), float(f.thrust[k]), k, 2 * k, 3 * k, 4000, 9]
        for k in range(len(f.t))
    ]


def with_sum(body: bytes) -> bytes:
    """The bytes with their CRC-32 behind them."""
    return body + struct.pack("<I", zlib.crc32(body))


def usd_bytes(
    events: Sequence[tuple[int, str, Sequence[tuple[str, str]]]],
    records: Sequence[tuple[int, int, Sequence[float]]],
    *,
    version: int,
) -> bytes:
    """A uSD log: events as id, name, variables with format letters; records as id, time, values."""
    body = struct.pack("<BHH", 0xBC, version, len(events))
    layouts = {}
    for kind, name, variables in events:
        body += struct.pack("<H", kind) + name.encode() + b"\0" + struct.pack("<H", len(variables))
        body += b"".join(f"{variable}({letter})".encode() + b"\0" for variable, letter in variables)
        layouts[kind] = "<H" + ("I" if version == 1 else "Q") + "".join(letter for _, letter in variables)
    body += b"".join(struct.pack(layouts[kind], kind, time, *values) for kind, time, values in records)
    return with_sum(body)


def usd_flight(
    flight: MadeUp, *, version: int, variables: Sequence[tuple[str, str]] = USD_VARIABLES
) -> bytes:
    """The flight as a uSD log with a second event type between its records."""
    events = [(1, "estPosition", (("source", "B"),)), (7, "fixedFrequency", variables)]
    records: list[tuple[int, int, Sequence[float]]] = []
    for t, row in zip(flight.t, usd_rows(flight), strict=True):
        ticks = round(4321.0 + 1e3 * t) if version == 1 else round(4321000.0 + 1e6 * t)
        records += [(7, ticks, row), (1, ticks, [1])]
    return usd_bytes(events, records, version=version)
