"""Reader of Crazyflie uSD binary logs of the Lee controller: on-board estimate, commanded thrust and torque.

Layout: byte 0xBC; u16 version; u16 number of event types; per type u16 id, name, u16 number of variables,
each "name(format)" with a letter of Python's struct; then records of u16 id, time (u32 ms in version 1, u64
us in version 2) and the packed variables; the last four bytes are the CRC-32 of all before them. Strings end
with NUL, numbers are little-endian.

The world is z-up (nwu here), the body FLU, and positions are in mm. Positions and angles come from the
on-board filter, which is slower than the log, so rows that repeat a pose are dropped.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from trimtab.host.imports.frames import q_ned_frd, to_frd, to_ned, turn_from_euler
from trimtab.host.imports.recording import (
    READABLE,
    ImportFormatError,
    Recording,
    Unknown,
    first_of_equal,
    fresh,
    since_first_us,
)

UNKNOWN: tuple[Unknown, ...] = (
    "motor-lag", "mounting-tilt", "frame-tilt", "inertia", "torque", "pose-latency",
)  # fmt: skip
MARK = 0xBC
FORMATS = frozenset("bBhHiIqQefd")
_SHORTEST = 9

_POSITION = ("stateEstimateZ.x", "stateEstimateZ.y", "stateEstimateZ.z")
_ANGLES = ("ctrlLee.rpyx", "ctrlLee.rpyy", "ctrlLee.rpyz")
_RATE = ("ctrlLee.omegax", "ctrlLee.omegay", "ctrlLee.omegaz")
_THRUST = ("ctrlLee.thrustSI",)
_TORQUE = ("ctrlLee.torquex", "ctrlLee.torquey", "ctrlLee.torquez")
_TARGET = ("ctrltargetZ.x", "ctrltargetZ.y", "ctrltargetZ.z")
_TARGET_RATE = ("ctrltargetZ.vx", "ctrltargetZ.vy", "ctrltargetZ.vz")
VARIABLES = (*_POSITION, *_ANGLES, *_RATE, *_THRUST, *_TORQUE, *_TARGET, *_TARGET_RATE)


@dataclass(frozen=True, kw_only=True, eq=False)
class Event:
    """Records of one event type: times in units of `unit_us`, and variables by name."""

    name: str
    times: Annotated[np.ndarray, "records"]
    unit_us: float
    columns: Mapping[str, Annotated[np.ndarray, "records"]]


def read(path: Path | str) -> Recording:
    """Return the flight of a uSD log. Raises ImportFormatError with the file, the problem and the remedy."""
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ImportFormatError(f"{path}: cannot be read ({error.strerror}); check the path") from None
    event = _with_all(decode(data, path.name), path.name)
    t_us = since_first_us(event.times, event.unit_us, path.name)
    keep = first_of_equal(t_us)
    t_us = t_us[keep]
    named = {name.lower(): values for name, values in event.columns.items()}

    def stack(names: tuple[str, ...], scale: float = 1.0) -> np.ndarray:
        values = np.column_stack([named[name.lower()][keep] for name in names])
        if not (np.abs(values) < READABLE).all():
            raise ImportFormatError(
                f"{path.name}: {', '.join(names)} contain values that are not numbers; fly again"
            )
        return scale * values

    position, angles = stack(_POSITION, 1e-3), stack(_ANGLES)
    new = fresh(position, angles)
    if new.sum() < 2:
        raise ImportFormatError(f"{path.name}: the pose never changes; is a position estimate running?")
    return Recording(
        source=path.name,
        pose_us=t_us[new],
        p_ned=to_ned(position, "nwu")[new],
        q_ned_frd=q_ned_frd(turn_from_euler(angles), "nwu", "flu")[new],
        input_us=t_us,
        thrust_n=stack(_THRUST)[:, 0],
        torque_n_m=to_frd(stack(_TORQUE), "flu"),
        imu_us=t_us,
        gyro=to_frd(stack(_RATE), "flu"),
        reference_us=t_us,
        p_ref_ned=to_ned(stack(_TARGET, 1e-3), "nwu"),
        v_ref_ned=to_ned(stack(_TARGET_RATE, 1e-3), "nwu"),
        mass_kg=_declared_mass(path),
        unknown=UNKNOWN,
        epoch_us=round(event.unit_us * float(event.times[0])),
    )


def _with_all(events: tuple[Event, ...], name: str) -> Event:
    """Return the event type with every required variable, ignoring case, which differs between firmwares."""

    def missing_in(event: Event) -> list[str]:
        present = {column.lower() for column in event.columns}
        return [variable for variable in VARIABLES if variable.lower() not in present]

    best = min(events, key=lambda event: len(missing_in(event)))
    missing = missing_in(best)
    if missing:
        raise ImportFormatError(
            f"{name}: no variable {', '.join(missing)}; log it on the vehicle and fly again"
        )
    if len(best.times) < 2:
        raise ImportFormatError(f"{name}: fewer than two records; nothing to import")
    return best


def decode(data: bytes, name: str) -> tuple[Event, ...]:
    """Return the records of a uSD log by event type, one or more.

    Raises ImportFormatError if the data is not a complete log: wrong mark, truncated, wrong checksum.
    """
    if data[:1] != bytes([MARK]):
        raise ImportFormatError(f"{name}: does not begin with 0xBC; not a Crazyflie uSD log")
    if len(data) < _SHORTEST or zlib.crc32(data[:-4]) != struct.unpack("<I", data[-4:])[0]:
        raise ImportFormatError(
            f"{name}: the checksum is wrong, the file is truncated or damaged; copy it from the card again"
        )
    try:
        return _decode(data[:-4], name)
    except (struct.error, IndexError, UnicodeDecodeError) as error:
        raise ImportFormatError(
            f"{name}: header or records do not fit ({error}); not a log of this format"
        ) from None


def _decode(data: bytes, name: str) -> tuple[Event, ...]:
    version, count = struct.unpack_from("<HH", data, 1)
    if version not in (1, 2):
        raise ImportFormatError(f"{name}: format version {version} is not supported, only versions 1 and 2")
    stamp, unit_us = ("I", 1000.0) if version == 1 else ("Q", 1.0)
    offset = 5
    types: dict[int, tuple[str, list[str], struct.Struct]] = {}
    for _ in range(count):
        (kind,) = struct.unpack_from("<H", data, offset)
        title, offset = _string(data, offset + 2)
        (variables,) = struct.unpack_from("<H", data, offset)
        offset += 2
        names, layout = [], f"<{stamp}"
        for _ in range(variables):
            text, offset = _string(data, offset)
            variable, letter = text[:-3], text[-2:-1]
            if text[-3:] != f"({letter})" or letter not in FORMATS:
                raise ImportFormatError(
                    f"{name}: variable {text!r} has no format letter of {' '.join(sorted(FORMATS))}; "
                    "not a log of this format"
                )
            names.append(variable)
            layout += letter
        if kind in types:
            raise ImportFormatError(f"{name}: event type {kind} is declared twice; not a log of this format")
        types[kind] = (title, names, struct.Struct(layout))
    if not types:
        raise ImportFormatError(f"{name}: no event type; nothing was logged")
    rows: dict[int, list[tuple]] = {kind: [] for kind in types}
    while offset < len(data):
        (kind,) = struct.unpack_from("<H", data, offset)
        if kind not in types:
            raise ImportFormatError(
                f"{name}: record of unknown type {kind} at byte {offset}; not a log of this format"
            )
        packer = types[kind][2]
        rows[kind].append(packer.unpack_from(data, offset + 2))
        offset += 2 + packer.size
    return tuple(
        Event(
            name=title,
            times=np.array([row[0] for row in rows[kind]], dtype=float),
            unit_us=unit_us,
            columns={
                column: np.array([row[1 + i] for row in rows[kind]], dtype=float)
                for i, column in enumerate(names)
            },
        )
        for kind, (title, names, _) in types.items()
    )


def _string(data: bytes, offset: int) -> tuple[str, int]:
    """Return the NUL-terminated text at `offset` and the offset after it."""
    end = data.find(b"\0", offset)
    if end < 0:
        raise IndexError("a text without an end")
    return data[offset:end].decode("ascii"), end + 1


def _declared_mass(path: Path) -> float | None:
    """Return the mass, kg, from the log's info file, info/infoNN.yaml for logs/logNN; None without one."""
    info = path.resolve().parent.parent / "info" / f"info{path.name.removeprefix('log')}.yaml"
    if not info.is_file():
        return None
    for line in info.read_text(encoding="utf-8", errors="replace").splitlines():
        key, _, value = line.partition(":")
        if key.strip() == "mass":
            try:
                return float(value.partition("#")[0])
            except ValueError:
                raise ImportFormatError(
                    f"{info.name}: mass {value.strip()!r} is not a number; correct it"
                ) from None
    return None
