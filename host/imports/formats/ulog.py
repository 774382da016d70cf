"""Reader of PX4 ULog files by pyulog.

The world is NED, the body FRD, quaternions have w first, times are in us since boot. Poses come from motion
capture if the file holds it, else from the on-board estimator. Motor commands are the normalised outputs of
the mixer if they were logged, else pulse widths.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from io import SEEK_CUR, SEEK_SET, BufferedReader, FileIO
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.host.base.bounds import ULOG_ALL_FIELDS, ULOG_DEPTH, ULOG_FIELDS
from trimtab.host.base.extras import optional, quiet
from trimtab.host.imports.contents import Contents
from trimtab.host.imports.frames import turn_from_quaternion
from trimtab.host.imports.recording import (
    Corner,
    ImportFormatError,
    Recording,
    Unknown,
    corner_of,
    reading,
)
from trimtab.host.imports.topics import Sensors, Source, Topic, TopicLog, finite_numbers
from trimtab.host.imports.tracks import Track, command_shares

MAGIC = b"ULog\x01\x12\x35"
UNKNOWN: tuple[Unknown, ...] = (
    "thrust-curve", "motor-lag", "mounting-tilt", "frame-tilt", "inertia", "torque", "pose-latency",
)  # fmt: skip
CORNERS: tuple[Corner, Corner, Corner, Corner] = ("front-right", "rear-left", "front-left", "rear-right")
"""Order of PX4's motors on a quadrotor in X, unless parameters CA_ROTOR* place them."""

PWM_MIN_US, PWM_MAX_US = 1000.0, 2000.0
"""Pulse widths of no and full command unless parameters PWM_MIN and PWM_MAX give others."""


def _source(name: str, field: str, count: int) -> Source:
    return Source(topic=name, fields=tuple(f"{field}[{k}]" for k in range(count)))


POSITION = (
    Source(topic="vehicle_mocap_odometry", fields=("x", "y", "z")),
    _source("vehicle_mocap_odometry", "position", 3),
    Source(topic="vehicle_visual_odometry", fields=("x", "y", "z")),
    _source("vehicle_visual_odometry", "position", 3),
    Source(topic="vehicle_local_position", fields=("x", "y", "z")),
)
ATTITUDE = {
    "vehicle_mocap_odometry": _source("vehicle_mocap_odometry", "q", 4),
    "vehicle_visual_odometry": _source("vehicle_visual_odometry", "q", 4),
    "vehicle_local_position": _source("vehicle_attitude", "q", 4),
}
"""Where the attitude is that belongs to the topic of a position."""

MOTORS = _source("actuator_motors", "control", 4)
PULSES = _source("actuator_outputs", "output", 4)
SENSORS = Sensors(
    rate=(_source("sensor_combined", "gyro_rad", 3), _source("vehicle_angular_velocity", "xyz", 3)),
    force=(_source("sensor_combined", "accelerometer_m_s2", 3), _source("vehicle_acceleration", "xyz", 3)),
    voltage=(Source(topic="battery_status", fields=("voltage_v",)),),
    reference=(
        Source(topic="vehicle_local_position_setpoint", fields=("x", "y", "z")),
        _source("trajectory_setpoint", "position", 3),
    ),
)


def recognises(path: Path, head: bytes) -> bool:
    """Return whether the file begins as a ULog."""
    return head.startswith(MAGIC)


def contents(path: Path) -> Contents:
    """Return the topics of the file with their rates. Raises ImportFormatError."""
    return _log(path).contents()


def read(path: Path | str) -> Recording:
    """Return the flight of a ULog. Raises ImportFormatError with the file, the problem and the remedy."""
    path = Path(path)
    log = _log(path)
    source = next((source for source in POSITION if log.has(source)), None)
    if source is None:
        raise log.missing(POSITION)
    position, attitude = log.needed(source), log.needed(ATTITUDE[source.topic])
    try:
        turn = turn_from_quaternion(attitude.values, scalar_first=True)
    except ValueError as error:
        raise ImportFormatError(f"{path.name}: {error}; cut the log before that row") from None
    motors = _motors(log)
    return log.recording(
        position=position,
        attitude_us=attitude.t_us,
        turn=turn,
        motors=motors,
        corners=None if motors is None else _corners(log.parameters),
        sensors=SENSORS,
        unknown=UNKNOWN,
    )


def _motors(log: TopicLog) -> Track | None:
    """Return the motor commands in 0..1; None without any."""
    if log.has(MOTORS):
        commands, low, high = log.needed(MOTORS), 0.0, 1.0
    elif log.has(PULSES):
        commands = log.needed(PULSES)
        low = log.parameters.get("PWM_MIN", PWM_MIN_US)
        high = log.parameters.get("PWM_MAX", PWM_MAX_US)
        if not low < high:
            raise ImportFormatError(f"{log.name}: PWM_MIN {low:g} is not below PWM_MAX {high:g}; correct it")
    else:
        return None
    return Track(t_us=commands.t_us, values=command_shares(commands.values, low, high))


def _corners(parameters: Mapping[str, float]) -> tuple[Corner, Corner, Corner, Corner]:
    """Return the corners of the motors, from the parameters that place them if there are any."""
    corners: list[Corner] = [
        corner_of(parameters.get(f"CA_ROTOR{k}_PX", 0.0), parameters.get(f"CA_ROTOR{k}_PY", 0.0))
        for k in range(4)
    ]
    if len(set(corners)) < len(corners):
        return CORNERS
    return corners[0], corners[1], corners[2], corners[3]


def _log(path: Path) -> TopicLog:
    """Return the topics of the file, the first instance of each."""
    pyulog = optional("pyulog", "logs")
    with reading(path):
        stream = _Forwards(FileIO(path))
    with stream, quiet():
        try:
            file: Any = _bounded(pyulog.ULog)(stream, disable_str_exceptions=True)
        except _Beyond as error:
            raise ImportFormatError(f"{path.name}: {error}") from None
        except Exception as error:
            # pyulog reports damage by whatever exception its parser ran into.
            raise ImportFormatError(
                f"{path.name}: not a whole ULog ({type(error).__name__}); copy it from the vehicle again"
            ) from None
    if file.start_timestamp > np.iinfo(np.int64).max:
        raise ImportFormatError(f"{path.name}: its start is damaged; copy it from the vehicle again")
    topics: dict[str, Topic] = {}
    for data in file.data_list:
        times = data.data.get("timestamp")
        # In a damaged definition, the times have another name or type.
        if times is not None and times.dtype.kind == "u" and len(times):
            topics.setdefault(data.name, Topic(t_us=times.astype(np.int64), columns=data.data))
    if not topics:
        raise ImportFormatError(f"{path.name}: no data; was the log stopped before take-off?")
    return TopicLog(
        name=path.name,
        topics=topics,
        start_us=int(file.start_timestamp),
        duration_s=max(0, int(file.last_timestamp) - int(file.start_timestamp)) * 1e-6,
        parameters=finite_numbers(file.initial_parameters),
        damaged=bool(file.file_corruption),
    )


class _Beyond(Exception):
    """A definition is beyond a bound. pyulog takes a ValueError for damage and goes on."""


def _bounded(ulog: Any) -> Any:
    """Return pyulog's class with bounds on the definitions of one file. It raises _Beyond."""
    total = 0

    class Subscription(ulog._MessageAddLogged):  # type: ignore[misc]
        def _parse_format(self, formats: Mapping[str, Any]) -> None:
            nonlocal total
            total += _field_count(self.message_name, formats)
            if total > ULOG_ALL_FIELDS.limit:
                raise _Beyond(ULOG_ALL_FIELDS.problem())
            super()._parse_format(formats)

    return type("BoundedULog", (ulog,), {"_MessageAddLogged": Subscription})


def _field_count(name: str, formats: Mapping[str, Any], depth: int = 0) -> int:
    """Return how many values a message has. Raises _Beyond, or KeyError for an unknown format."""
    if depth > ULOG_DEPTH.limit:
        raise _Beyond(f"{name}: {ULOG_DEPTH.problem()}")
    count, basic = 0, optional("pyulog", "logs").ULog._UNPACK_TYPES
    for kind, length, _ in formats[name].fields:
        count += max(1, length) * (1 if kind in basic else _field_count(kind, formats, depth + 1))
        if count > ULOG_FIELDS.limit:
            raise _Beyond(f"{name}: {ULOG_FIELDS.problem()}")
    return count


class _Forwards(BufferedReader):
    """A file that does not let pyulog read the last definition of a truncated file for ever."""

    def __init__(self, raw: FileIO) -> None:
        super().__init__(raw)
        self._from_end: Counter[int] = Counter()

    def seek(self, target: int, whence: int = SEEK_SET, /) -> int:
        """Go to a position. Raises EOFError for the third way back from the end by the same length.

        The first two are the ends of the definitions and of the data.
        """
        if whence == SEEK_CUR and not self.peek(1):
            self._from_end[target] += 1
            if self._from_end[target] > 2:
                raise EOFError
        return super().seek(target, whence)
