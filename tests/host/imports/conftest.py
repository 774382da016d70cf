"""A made-up flight, consistent by construction, and the foreign files that would hold it.

The conversions here are not those of trimtab.host.imports: rotations are composed from half turns by scipy,
numbers written as text or packed by struct.
"""

from __future__ import annotations

import csv
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

G = 9.80665
RATE_HZ = 100
HALF_TURN_ABOUT_X = Rotation.from_rotvec([np.pi, 0.0, 0.0])
HALF_TURN_ABOUT_NORTH_EAST = Rotation.from_rotvec(np.pi * np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0))
"""What swaps north with east and up with down: ENU to NED and back."""

WORLDS = {"ned": Rotation.identity(), "nwu": HALF_TURN_ABOUT_X, "enu": HALF_TURN_ABOUT_NORTH_EAST}
BODIES = {"frd": Rotation.identity(), "flu": HALF_TURN_ABOUT_X}


@dataclass(frozen=True, kw_only=True)
class MadeUp:
    """Take-off, eight seconds of moves, landing. t (n,) s; p (n, 3) NED m; turn R_ned_frd; gyro and force
    (n, 3) FRD; motor (n, 4) 0..1, each motor its own; thrust (n,) N; volt (n,).
    """

    t: np.ndarray
    p: np.ndarray
    turn: Rotation
    gyro: np.ndarray
    force: np.ndarray
    motor: np.ndarray
    thrust: np.ndarray
    volt: np.ndarray

    def cut(self, rows: slice) -> MadeUp:
        """The same flight, some of its rows."""
        return MadeUp(**{name: value[rows] for name, value in vars(self).items()})


def _smooth(x: np.ndarray) -> np.ndarray:
    """0 to 1 with three derivatives zero at both ends."""
    x = np.clip(x, 0.0, 1.0)
    return x**4 * (35.0 - 84.0 * x + 70.0 * x**2 - 20.0 * x**3)


@pytest.fixture(scope="session")
def made_up() -> MadeUp:
    fine = 10
    t = np.arange(0.0, 13.0, 1.0 / (RATE_HZ * fine))
    up = _smooth((t - 1.0) / 1.5) - _smooth((t - 10.5) / 1.5)
    away = _smooth((t - 2.5) / 1.0) - _smooth((t - 9.5) / 1.0)
    north, east = 0.8 * away * np.sin(2.1 * t), 0.6 * away * np.sin(1.3 * t + 0.4)
    p = np.column_stack([north, east, -1.2 * up])
    yaw = 0.5 * away * np.sin(0.9 * t)
    dt = t[1] - t[0]
    a = np.gradient(np.gradient(p, dt, axis=0), dt, axis=0)
    push = a - [0.0, 0.0, G]
    down = -push / np.linalg.norm(push, axis=1)[:, None]
    ahead = np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(len(t))])
    right = np.cross(down, ahead)
    right /= np.linalg.norm(right, axis=1)[:, None]
    R = np.stack([np.cross(right, down), right, down], axis=2)
    turn = Rotation.from_matrix(R)
    rate = np.zeros((len(t), 3))
    rate[1:-1] = (turn[:-2].inv() * turn[2:]).as_rotvec() / (2.0 * dt)
    flying = (t > 0.9) & (t < 12.1)
    share = np.linalg.norm(push, axis=1) / G
    motor = np.where(flying[:, None], 0.5 * share[:, None] + 0.02 * rate[:, [0, 1, 2, 0]], 0.0)
    motor += np.where(flying[:, None], np.array([0.0, 0.01, 0.02, 0.03]), 0.0)
    every = slice(0, len(t), fine)
    jitter = np.random.default_rng(5).normal(0.0, 1e-5, (len(t), 3))
    return MadeUp(
        t=t[every],
        p=(p + jitter)[every],
        turn=turn[every],
        gyro=rate[every],
        force=np.einsum("nji,nj->ni", R, push)[every],
        motor=motor[every],
        thrust=np.where(flying, 0.033 * G * share, 0.0)[every],
        volt=(4.1 - 0.03 * t)[every],
    )


def in_axes(flight: MadeUp, world: str, body: str) -> MadeUp:
    """The same flight told in other axes."""
    to_world, to_body = WORLDS[world], BODIES[body]
    return MadeUp(
        t=flight.t,
        p=to_world.apply(flight.p),
        turn=to_world * flight.turn * to_body.inv(),
        gyro=to_body.apply(flight.gyro),
        force=to_body.apply(flight.force),
        motor=flight.motor,
        thrust=flight.thrust,
        volt=flight.volt,
    )


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


@pytest.fixture(scope="session")
def foreign() -> SimpleNamespace:
    """The functions above, for tests to write files with."""
    return SimpleNamespace(
        G=G,
        WORLDS=WORLDS,
        BODIES=BODIES,
        USD_VARIABLES=USD_VARIABLES,
        in_axes=in_axes,
        write_csv=write_csv,
        nanobench_columns=nanobench_columns,
        usd_rows=usd_rows,
        usd_bytes=usd_bytes,
        usd_flight=usd_flight,
        with_sum=with_sum,
    )


@pytest.fixture
def nanobench_file(tmp_path: Path, made_up: MadeUp) -> Callable[..., Path]:
    """Writes a NanoBench file; keywords replace columns, None removes one."""

    def write(**changes: Sequence[object] | np.ndarray | None) -> Path:
        columns: dict[str, Sequence[object] | np.ndarray] = dict(nanobench_columns(made_up))
        for name, values in changes.items():
            if values is None:
                del columns[name]
            else:
                columns[name] = values
        return write_csv(tmp_path / "flight.csv", columns)

    return write
