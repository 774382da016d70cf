"""Reader of Crazyflie uSD binary logs made under the Lee controller: commanded thrust and torque, on-board
estimate.

Layout: byte 0xBC; u16 version; u16 number of event types; per type u16 id, name, u16 number of variables,
each "name(format)"; then records of u16 id, time (u32 ms in version 1, u64 us in version 2) and the packed
variables; the last four bytes are the CRC-32 of all before them. Strings end with NUL, numbers are
little-endian.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from host.imports.recording import ImportFormatError, Recording, quaternion_from_flu, vector_from_flu

UNKNOWN = ("motor-lag", "mounting-tilt", "frame-tilt", "inertia", "torque", "pose-latency")
_FORMATS = frozenset("bBhHiIfqQd")


def read(path: Path | str) -> Recording:
    """The flight of a uSD log. Raises ImportFormatError naming the file, what is wrong and what to do."""
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ImportFormatError(f"{path}: cannot be read ({error.strerror})") from None
    t_us, column = decode(data, path.name)
    keep = np.r_[True, np.diff(t_us) > 0]
    t_us = t_us[keep] - t_us[0]

    def stack(*names: str) -> np.ndarray:
        found = []
        for name in names:
            key = next((k for k in column if k.lower() == name.lower()), None)
            if key is None:
                raise ImportFormatError(
                    f"{path.name}: no variable {name}; log it on the vehicle and fly again"
                )
            found.append(column[key][keep])
        return np.column_stack(found)

    rpy = stack("ctrlLee.rpyx", "ctrlLee.rpyy", "ctrlLee.rpyz")
    q = Rotation.from_euler("ZYX", rpy[:, ::-1]).as_quat()[:, [3, 0, 1, 2]]
    return Recording(
        source=path.name,
        pose_us=t_us,
        p_ned=vector_from_flu(stack("stateEstimateZ.x", "stateEstimateZ.y", "stateEstimateZ.z") * 1e-3),
        q_ned_frd=quaternion_from_flu(q),
        input_us=t_us,
        thrust_n=stack("ctrlLee.thrustSI")[:, 0],
        torque_n_m=vector_from_flu(stack("ctrlLee.torquex", "ctrlLee.torquey", "ctrlLee.torquez")),
        imu_us=t_us,
        gyro=vector_from_flu(stack("ctrlLee.omegax", "ctrlLee.omegay", "ctrlLee.omegaz")),
        reference_us=t_us,
        p_ref_ned=vector_from_flu(stack("ctrltargetZ.x", "ctrltargetZ.y", "ctrltargetZ.z") * 1e-3),
        v_ref_ned=vector_from_flu(stack("ctrltargetZ.vx", "ctrltargetZ.vy", "ctrltargetZ.vz") * 1e-3),
        mass_kg=_declared_mass(path),
        unknown=UNKNOWN,
    )


def decode(data: bytes, name: str) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times (n,) in us and the variables (n,) of a uSD log's first event type.

    Raises ImportFormatError for anything that is not a whole log: wrong mark, cut short, wrong check sum.
    """
    if len(data) < 9 or data[0] != 0xBC:
        raise ImportFormatError(f"{name}: does not begin with 0xBC; not a Crazyflie uSD log")
    if zlib.crc32(data[:-4]) != struct.unpack("<I", data[-4:])[0]:
        raise ImportFormatError(
            f"{name}: check sum is wrong, the file is cut or damaged; copy it from the card again"
        )
    try:
        return _decode(data[:-4], name)
    except (struct.error, IndexError, UnicodeDecodeError, ValueError) as error:
        if isinstance(error, ImportFormatError):
            raise
        raise ImportFormatError(
            f"{name}: header or records do not fit ({error}); not a log of this format"
        ) from None


def _decode(data: bytes, name: str) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    version, count = struct.unpack_from("<HH", data, 1)
    if version not in (1, 2):
        raise ImportFormatError(f"{name}: format version {version}; versions 1 and 2 are read")
    offset, types = 5, {}
    for _ in range(count):
        (kind,) = struct.unpack_from("<H", data, offset)
        _, offset = _string(data, offset + 2)
        (variables,) = struct.unpack_from("<H", data, offset)
        offset += 2
        names, layout = [], ""
        for _ in range(variables):
            text, offset = _string(data, offset)
            if not text.endswith(")") or text[-2:-1] not in _FORMATS or text[-3:-2] != "(":
                raise ImportFormatError(f"{name}: variable {text!r} has no known format letter")
            names.append(text[:-3])
            layout += text[-2]
        types[kind] = (names, layout)
    if not types:
        raise ImportFormatError(f"{name}: no event type; nothing was logged")
    stamp, to_us = ("I", 1000) if version == 1 else ("Q", 1)
    packers = {kind: struct.Struct(f"<{stamp}{layout}") for kind, (_, layout) in types.items()}
    first = next(iter(types))
    rows = []
    while offset < len(data):
        (kind,) = struct.unpack_from("<H", data, offset)
        if kind not in packers:
            raise ImportFormatError(f"{name}: record of unknown type {kind} at byte {offset}")
        row = packers[kind].unpack_from(data, offset + 2)
        offset += 2 + packers[kind].size
        if kind == first:
            rows.append(row)
    if len(rows) < 2:
        raise ImportFormatError(f"{name}: fewer than two records; nothing to import")
    values = np.array([row[1:] for row in rows], dtype=float)
    t_us = np.array([row[0] for row in rows], dtype=np.int64) * to_us
    return t_us, dict(zip(types[first][0], values.T, strict=True))


def _string(data: bytes, offset: int) -> tuple[str, int]:
    end = data.index(b"\0", offset)
    return data[offset:end].decode("ascii"), end + 1


def _declared_mass(path: Path) -> float | None:
    """Mass in kg from the info file kept beside such logs, info/infoNN.yaml for logs/logNN; None without
    one.
    """
    info = path.parent.parent / "info" / f"info{path.name.removeprefix('log')}.yaml"
    if not info.is_file():
        return None
    for line in info.read_text(encoding="utf-8", errors="replace").splitlines():
        key, _, value = line.partition(":")
        if key.strip() == "mass":
            try:
                return float(value)
            except ValueError:
                raise ImportFormatError(
                    f"{info.name}: mass {value.strip()!r} is not a number; mend it"
                ) from None
    return None
