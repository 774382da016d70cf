"""Reader of Crazyflie uSD binary logs with any variables that hold a pose.

Every quantity has several sources: the log variables of controllers and estimators. The first that the log
holds is read. The world is z-up (nwu here), the body FLU. Poses come from the on-board filter, which may be
slower than the log, so rows that repeat a pose are dropped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from trimtab.host.imports.airborne import far_from_ground
from trimtab.host.imports.attitude import (
    acceleration_of_positions,
    averaged_acceleration,
    pitch_from_acceleration,
)
from trimtab.host.imports.contents import Contents, topic
from trimtab.host.imports.formats.nanobench import CORNERS, PWM_MAX, STANDARD_GRAVITY
from trimtab.host.imports.formats.nanobench import UNKNOWN as UNKNOWN_OF_MOTORS
from trimtab.host.imports.formats.usd_events import MARK, Event, decode
from trimtab.host.imports.frames import q_ned_frd, to_frd, to_ned, turn_from_euler, turn_from_quaternion
from trimtab.host.imports.recording import (
    READABLE,
    ImportFormatError,
    Recording,
    Unknown,
    first_of_equal,
    fresh,
    reading,
    since_first_us,
)
from trimtab.host.imports.tracks import Track
from trimtab.host.log import Rebuilt

UNKNOWN: tuple[Unknown, ...] = (
    "motor-lag", "mounting-tilt", "frame-tilt", "inertia", "torque", "pose-latency",
)  # fmt: skip
"""What a log of commanded thrust does not determine. One of motor commands is like NanoBench's."""

DEG = np.pi / 180.0


@dataclass(frozen=True, kw_only=True)
class Source:
    """Log variables of one quantity, and the factors from their units to SI."""

    variables: tuple[str, ...]
    factors: tuple[float, ...]


def _vector(prefix: str, axes: str = "xyz", factor: float = 1.0) -> Source:
    """Return the source of a vector whose variables have one prefix and one unit."""
    return Source(variables=tuple(f"{prefix}{axis}" for axis in axes), factors=(factor,) * len(axes))


POSITION = (
    _vector("stateEstimateZ.", factor=1e-3),
    _vector("stateEstimate."),
    _vector("kalman.state", "XYZ"),
    _vector("locSrv."),
)
QUATERNION = (
    Source(variables=tuple(f"stateEstimate.q{axis}" for axis in "wxyz"), factors=(1.0,) * 4),
    Source(variables=tuple(f"kalman.q{axis}" for axis in "0123"), factors=(1.0,) * 4),
)
"""Body to world, w first."""

EULER = (
    _vector("ctrlLee.rpy"),
    # The firmware's pitch has the other sign.
    Source(
        variables=("stateEstimate.roll", "stateEstimate.pitch", "stateEstimate.yaw"), factors=(DEG, -DEG, DEG)
    ),
)
ROLL_AND_YAW = (Source(variables=("stateEstimate.roll", "stateEstimate.yaw"), factors=(DEG, DEG)),)
ACCELERATION = (_vector("stateEstimate.a", factor=STANDARD_GRAVITY),)
"""The accelerometer's, turned into the world by the on-board filter, without gravity."""

RATE = (_vector("ctrlLee.omega"), _vector("gyro.", factor=DEG))
FORCE = (_vector("acc.", factor=STANDARD_GRAVITY),)
THRUST = (Source(variables=("ctrlLee.thrustSI",), factors=(1.0,)),)
TORQUE = (_vector("ctrlLee.torque"),)
MOTORS = (
    Source(variables=tuple(f"motor.m{k}" for k in (1, 2, 3, 4)), factors=(1.0 / PWM_MAX,) * 4),
    Source(variables=tuple(f"pwm.m{k}_pwm" for k in (1, 2, 3, 4)), factors=(1.0 / PWM_MAX,) * 4),
)
"""Clockwise from the front right."""

VOLTAGE = (
    Source(variables=("pm.vbatMV",), factors=(1e-3,)),
    Source(variables=("pm.vbat",), factors=(1.0,)),
)
TARGET = (_vector("ctrltargetZ.", factor=1e-3), _vector("ctrltarget."))
TARGET_RATE = (_vector("ctrltargetZ.v", factor=1e-3), _vector("ctrltarget.v"))


def recognises(path: Path, head: bytes) -> bool:
    """Return whether the file begins with the mark of a uSD log."""
    return head[:1] == bytes([MARK])


def contents(path: Path) -> Contents:
    """Return the variables of the log with the rates of their event types. Raises ImportFormatError."""
    events = _events(path)
    spans = [
        (float(event.times[-1] - event.times[0]) * event.unit_us * 1e-6 if len(event.times) else 0.0, event)
        for event in events
    ]
    return Contents(
        topics=tuple(
            topic(variable, len(event.times), span_s) for span_s, event in spans for variable in event.columns
        ),
        duration_s=max(span_s for span_s, _ in spans),
    )


def read(path: Path | str) -> Recording:
    """Return the flight of a uSD log. Raises ImportFormatError with the file, the problem and the remedy."""
    path = Path(path)
    log = _Log(_events(path), path.name)
    position = log.needed(POSITION)
    attitude, turn, rebuilt = _attitude(log, position)
    new = fresh(position.values, attitude)
    if new.sum() < 2:
        raise ImportFormatError(f"{path.name}: the pose never changes; is a position estimate running?")
    thrust = log.track(THRUST)
    motors = log.track(MOTORS) if thrust is None else None
    torque = log.track(TORQUE) if thrust is not None else None
    rate, force, voltage = log.track(RATE), log.track(FORCE), log.track(VOLTAGE)
    target, target_rate = log.track(TARGET), log.track(TARGET_RATE)
    inputs, imu = thrust or motors, rate or force

    def beside(track: Track | None, first: Track | None) -> np.ndarray | None:
        return None if track is None or first is None else track.at(first.t_us)

    def in_world(track: Track | None) -> np.ndarray | None:
        return None if track is None or target is None else to_ned(track.at(target.t_us), "nwu")

    def in_body(track: Track | None, first: Track | None) -> np.ndarray | None:
        return None if track is None or first is None else to_frd(track.at(first.t_us), "flu")

    return Recording(
        source=path.name,
        pose_us=position.t_us[new],
        p_ned=to_ned(position.values, "nwu")[new],
        q_ned_frd=q_ned_frd(turn, "nwu", "flu")[new],
        input_us=None if inputs is None else inputs.t_us,
        motor_command=beside(motors, inputs),
        motor_corners=None if motors is None else CORNERS,
        thrust_n=None if thrust is None else thrust.values[:, 0],
        torque_n_m=in_body(torque, inputs),
        imu_us=None if imu is None else imu.t_us,
        gyro=in_body(rate, imu),
        specific_force=in_body(force, imu),
        battery_us=None if voltage is None else voltage.t_us,
        battery_v=None if voltage is None else voltage.values[:, 0],
        reference_us=None if target is None else target.t_us,
        p_ref_ned=in_world(target),
        v_ref_ned=in_world(target_rate),
        mass_kg=_declared_mass(path),
        epoch_us=log.epoch_us,
        rebuilt=rebuilt,
        unknown=UNKNOWN if motors is None else UNKNOWN_OF_MOTORS,
    )


def _events(path: Path) -> tuple[Event, ...]:
    """Return the events of the file. Raises ImportFormatError."""
    with reading(path):
        data = path.read_bytes()
    return decode(data, path.name)


def _attitude(log: _Log, position: Track) -> tuple[np.ndarray, Rotation, Rebuilt | None]:
    """Return the attitude at each position, as in the log and as rotations from FLU to NWU.

    A log with roll and yaw alone gets its pitch from its accelerations or, without them, from the positions.
    """
    t_us = position.t_us
    euler, quaternion = log.track(EULER), log.track(QUATERNION)
    if euler is not None:
        angles = euler.at(t_us)
        return angles, turn_from_euler(angles), None
    if quaternion is not None:
        q = quaternion.at(t_us)
        try:
            return q, turn_from_quaternion(q, scalar_first=True), None
        except ValueError as error:
            raise ImportFormatError(f"{log.name}: {error}; remove or correct that row") from None
    partly = log.track(ROLL_AND_YAW)
    if partly is None:
        raise log.missing(EULER)
    roll, yaw = partly.at(t_us).T
    t_s, acceleration = t_us * 1e-6, log.track(ACCELERATION)
    if acceleration is None:
        a_nwu = acceleration_of_positions(t_s, position.values)
    else:
        a_nwu = averaged_acceleration(t_s, acceleration.at(t_us))
    flying = far_from_ground(t_us, position.values[:, 2])
    pitch, sd_rad = pitch_from_acceleration(a_nwu, roll, yaw, flying)
    angles = np.column_stack([roll, pitch, yaw])
    source = "positions" if acceleration is None else "accelerations"
    return angles, turn_from_euler(angles), Rebuilt(part="pitch", source=source, sd_rad=sd_rad)


class _Log:
    """Events of one log on one clock."""

    def __init__(self, events: Sequence[Event], name: str) -> None:
        self.name = name
        self._events = [event for event in events if len(event.times) > 1]
        if not self._events:
            raise ImportFormatError(f"{name}: fewer than two records; nothing to import")
        self._start = min(float(event.times[0]) for event in self._events)
        self.epoch_us = round(self._events[0].unit_us * self._start)

    def track(self, sources: Sequence[Source]) -> Track | None:
        """Return the quantity from the first source that an event type holds whole; None without any.

        Case does not count, since firmwares differ in it.
        """
        for source in sources:
            for event in self._events:
                named = {variable.lower(): column for variable, column in event.columns.items()}
                if all(variable.lower() in named for variable in source.variables):
                    values = np.column_stack([named[variable.lower()] for variable in source.variables])
                    return self._track(event, values, source)
        return None

    def needed(self, sources: Sequence[Source]) -> Track:
        """Return the quantity. Raises ImportFormatError if no event type holds it."""
        found = self.track(sources)
        if found is None:
            raise self.missing(sources)
        return found

    def missing(self, sources: Sequence[Source]) -> ImportFormatError:
        """Return the error that names the variables of every source."""
        wanted = ", or ".join(" ".join(source.variables) for source in sources)
        return ImportFormatError(f"{self.name}: no {wanted}; log them on the vehicle and fly again")

    def _track(self, event: Event, values: np.ndarray, source: Source) -> Track:
        if not (np.abs(values) < READABLE).all():
            raise ImportFormatError(
                f"{self.name}: {', '.join(source.variables)} contain values that are not numbers; fly again"
            )
        t_us = since_first_us(event.times, event.unit_us, self.name)
        t_us = t_us + round((float(event.times[0]) - self._start) * event.unit_us)
        keep = first_of_equal(t_us)
        return Track(t_us=t_us[keep], values=values[keep] * np.array(source.factors))


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
