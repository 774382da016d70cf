"""Reader of PX4 ULog files by pyulog.

The world is NED, the body FRD, quaternions have w first, times are in us since boot. Poses come from motion
capture if the file holds it, else from the on-board estimator. Motor commands are the normalised outputs of
the mixer if they were logged, else pulse widths.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.host.imports.contents import Contents, Topic, topic
from trimtab.host.imports.extras import optional
from trimtab.host.imports.frames import turn_from_quaternion
from trimtab.host.imports.recording import (
    READABLE,
    Corner,
    ImportFormatError,
    Recording,
    Unknown,
    first_of_equal,
    fresh,
)
from trimtab.host.imports.tracks import Track, turns_at

MAGIC = b"ULog\x01\x12\x35"
UNKNOWN: tuple[Unknown, ...] = (
    "thrust-curve", "motor-lag", "mounting-tilt", "frame-tilt", "inertia", "torque", "pose-latency",
)  # fmt: skip
CORNERS: tuple[Corner, Corner, Corner, Corner] = ("front-right", "rear-left", "front-left", "rear-right")
"""Order of PX4's motors on a quadrotor in X, unless parameters CA_ROTOR* place them."""

PWM_MIN_US, PWM_MAX_US = 1000.0, 2000.0
"""Pulse widths of no and full command unless parameters PWM_MIN and PWM_MAX give others."""


@dataclass(frozen=True, kw_only=True)
class Source:
    """Fields of one topic that hold a quantity in SI."""

    topic: str
    fields: tuple[str, ...]


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
RATE = (_source("sensor_combined", "gyro_rad", 3), _source("vehicle_angular_velocity", "xyz", 3))
FORCE = (_source("sensor_combined", "accelerometer_m_s2", 3), _source("vehicle_acceleration", "xyz", 3))
VOLTAGE = (Source(topic="battery_status", fields=("voltage_v",)),)
REFERENCE = (
    Source(topic="vehicle_local_position_setpoint", fields=("x", "y", "z")),
    _source("trajectory_setpoint", "position", 3),
)


def recognises(path: Path, head: bytes) -> bool:
    """Return whether the file begins as a ULog."""
    return head.startswith(MAGIC)


def contents(path: Path) -> Contents:
    """Return the topics of the file with their rates. Raises ImportFormatError."""
    log = _Log(path)
    notes = ("the file is damaged; what could be read is used",) if log.damaged else ()
    return Contents(topics=log.topics(), duration_s=log.duration_s, notes=notes)


def read(path: Path | str) -> Recording:
    """Return the flight of a ULog. Raises ImportFormatError with the file, the problem and the remedy."""
    path = Path(path)
    log = _Log(path)
    source = next((source for source in POSITION if log.has(source)), None)
    if source is None:
        raise log.missing(POSITION)
    position, attitude = log.needed(source), log.needed(ATTITUDE[source.topic])
    try:
        turn = turn_from_quaternion(attitude.values, scalar_first=True)
    except ValueError as error:
        raise ImportFormatError(f"{path.name}: {error}; cut the log before that row") from None
    new = fresh(position.values)
    pose_us, p_ned = position.t_us[new], position.values[new]
    rate, force, voltage, reference = (log.first(of) for of in (RATE, FORCE, VOLTAGE, REFERENCE))
    imu, motors = rate or force, _motors(log)
    return Recording(
        source=path.name,
        pose_us=pose_us,
        p_ned=p_ned,
        q_ned_frd=turns_at(attitude.t_us, turn, pose_us).as_quat(scalar_first=True, canonical=True),
        input_us=None if motors is None else motors.t_us,
        motor_command=None if motors is None else motors.values,
        motor_corners=None if motors is None else _corners(log.parameters),
        imu_us=None if imu is None else imu.t_us,
        gyro=None if rate is None or imu is None else rate.at(imu.t_us),
        specific_force=None if force is None or imu is None else force.at(imu.t_us),
        battery_us=None if voltage is None else voltage.t_us,
        battery_v=None if voltage is None else voltage.values[:, 0],
        reference_us=None if reference is None else reference.t_us,
        p_ref_ned=None if reference is None else reference.values,
        unknown=UNKNOWN,
    )


def _motors(log: _Log) -> Track | None:
    """Return the motor commands in 0..1; None without any."""
    if log.has(MOTORS):
        commands = log.needed(MOTORS)
    elif log.has(PULSES):
        pulses = log.needed(PULSES)
        low = log.parameters.get("PWM_MIN", PWM_MIN_US)
        high = log.parameters.get("PWM_MAX", PWM_MAX_US)
        if not low < high:
            raise ImportFormatError(f"{log.name}: PWM_MIN {low:g} is not below PWM_MAX {high:g}; correct it")
        commands = Track(t_us=pulses.t_us, values=(pulses.values - low) / (high - low))
    else:
        return None
    # A disarmed motor is commanded below its least pulse.
    return Track(t_us=commands.t_us, values=np.maximum(commands.values, 0.0))


def _corners(parameters: Mapping[str, float]) -> tuple[Corner, Corner, Corner, Corner]:
    """Return the corners of the motors, from the parameters that place them if there are any."""
    sides: dict[tuple[bool, bool], Corner] = {
        (True, True): "front-right",
        (False, True): "rear-right",
        (False, False): "rear-left",
        (True, False): "front-left",
    }
    placed = [
        (parameters.get(f"CA_ROTOR{k}_PX", 0.0), parameters.get(f"CA_ROTOR{k}_PY", 0.0)) for k in range(4)
    ]
    corners: list[Corner] = [sides[x > 0.0, y > 0.0] for x, y in placed]
    if len(set(corners)) < len(corners):
        return CORNERS
    return corners[0], corners[1], corners[2], corners[3]


class _Log:
    """The topics of one file, first instance of each, at times since the first record of all."""

    def __init__(self, path: Path) -> None:
        ulog = optional("pyulog", "logs")
        self.name = path.name
        try:
            path.open("rb").close()
        except OSError as error:
            raise ImportFormatError(f"{path}: cannot be read ({error.strerror}); check the path") from None
        try:
            file: Any = ulog.ULog(str(path), disable_str_exceptions=True)
        except Exception as error:
            # pyulog reports damage by whatever exception its parser ran into.
            raise ImportFormatError(
                f"{path.name}: not a whole ULog ({type(error).__name__}); copy it from the vehicle again"
            ) from None
        self.damaged = bool(file.file_corruption)
        self.parameters: Mapping[str, float] = dict(file.initial_parameters)
        self._data: dict[str, Mapping[str, np.ndarray]] = {}
        for data in file.data_list:
            if len(data.data["timestamp"]):
                self._data.setdefault(data.name, data.data)
        if not self._data:
            raise ImportFormatError(f"{path.name}: no data; was the log stopped before take-off?")
        self._start_us = int(file.start_timestamp)
        self.duration_s = (int(file.last_timestamp) - self._start_us) * 1e-6

    def topics(self) -> tuple[Topic, ...]:
        """Return the topics in the order of their names."""
        spans = {name: np.ptp(data["timestamp"].astype(np.int64)) * 1e-6 for name, data in self._data.items()}
        return tuple(
            topic(name, len(self._data[name]["timestamp"]), float(spans[name])) for name in sorted(spans)
        )

    def has(self, source: Source) -> bool:
        """Return whether the file holds all fields of a source."""
        return all(field in self._data.get(source.topic, {}) for field in source.fields)

    def first(self, sources: Sequence[Source]) -> Track | None:
        """Return the quantity from the first source that the file holds; None without any."""
        return next((self.needed(source) for source in sources if self.has(source)), None)

    def needed(self, source: Source) -> Track:
        """Return the quantity. Raises ImportFormatError if it is missing or has no finite values."""
        if not self.has(source):
            raise self.missing([source])
        data = self._data[source.topic]
        values = np.column_stack([data[field] for field in source.fields]).astype(float)
        t_us = data["timestamp"].astype(np.int64) - self._start_us
        sound = (np.abs(values) < READABLE).all(axis=1)
        order = np.argsort(t_us[sound], kind="stable")
        t_us, values = t_us[sound][order], values[sound][order]
        if len(t_us) < 2:
            raise ImportFormatError(
                f"{self.name}: {source.topic} has fewer than two finite values; log it again"
            )
        keep = first_of_equal(t_us)
        return Track(t_us=t_us[keep], values=values[keep])

    def missing(self, sources: Sequence[Source]) -> ImportFormatError:
        """Return the error that names the topics of every source."""
        wanted = " or ".join(dict.fromkeys(source.topic for source in sources))
        return ImportFormatError(f"{self.name}: no topic {wanted} with its values; log it and fly again")
