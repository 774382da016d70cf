"""Foreign logs as topics with named fields on one clock."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from scipy.spatial.transform import Rotation

from trimtab.host.imports.contents import Contents, topic
from trimtab.host.imports.recording import Corner, ImportFormatError, Recording, Unknown, fresh
from trimtab.host.imports.tracks import Track, sound_track, turns_at


@dataclass(frozen=True, kw_only=True)
class Source:
    """Fields of one topic that hold a quantity, and the factor from their unit to SI."""

    topic: str
    fields: tuple[str, ...]
    factor: float = 1.0


@dataclass(frozen=True, kw_only=True)
class Sensors:
    """Sources of body rate, specific force, voltage and reference position, in order of preference."""

    rate: tuple[Source, ...]
    force: tuple[Source, ...]
    voltage: tuple[Source, ...]
    reference: tuple[Source, ...] = ()


def finite_numbers(parameters: Mapping[str, object]) -> dict[str, float]:
    """Return the parameters that are finite numbers; a damaged file may hold others."""
    return {
        name: float(value)
        for name, value in parameters.items()
        if isinstance(value, int | float) and math.isfinite(value)
    }


@dataclass(frozen=True, kw_only=True, eq=False)
class Topic:
    """Rows of one topic: times, us, on the clock of the log, and columns by field."""

    t_us: Annotated[np.ndarray, "rows"]
    columns: Mapping[str, Annotated[np.ndarray, "rows"]]


@dataclass(frozen=True, kw_only=True, eq=False)
class TopicLog:
    """The topics of one file, the vehicle's parameters, and whether the file is damaged.

    `start_us` is the time of the first row on the clock of the log; tracks begin there.
    """

    name: str
    topics: Mapping[str, Topic]
    start_us: int
    duration_s: float
    parameters: Mapping[str, float] = field(default_factory=dict)
    damaged: bool = False

    def contents(self) -> Contents:
        """Return the topics in the order of their names."""
        return Contents(
            topics=tuple(
                topic(name, len(held.t_us), float(np.ptp(held.t_us)) * 1e-6)
                for name, held in sorted(self.topics.items())
                if len(held.t_us)
            ),
            duration_s=self.duration_s,
            notes=("the file is damaged; what could be read is used",) if self.damaged else (),
        )

    def has(self, source: Source) -> bool:
        """Return whether the file holds all fields of a source."""
        held = self.topics.get(source.topic)
        return held is not None and all(name in held.columns for name in source.fields)

    def first(self, sources: Sequence[Source]) -> Track | None:
        """Return the quantity from the first source that the file holds; None without any."""
        return next((self.needed(source) for source in sources if self.has(source)), None)

    def needed(self, source: Source) -> Track:
        """Return the quantity. Raises ImportFormatError if it is missing or has no finite values."""
        if not self.has(source):
            raise self.missing([source])
        held = self.topics[source.topic]
        with np.errstate(invalid="ignore"):  # damaged values; they are left out
            values = np.column_stack([held.columns[name] for name in source.fields]).astype(float)
        track = sound_track(held.t_us - self.start_us, values)
        if len(track.t_us) < 2:
            raise ImportFormatError(
                f"{self.name}: fewer than two finite values of {source.topic}; log it again"
            )
        return Track(t_us=track.t_us, values=track.values * source.factor)

    def recording(
        self,
        *,
        position: Track,
        attitude_us: Annotated[np.ndarray, "attitudes"],
        turn: Rotation,
        motors: Track | None,
        corners: tuple[Corner, Corner, Corner, Corner] | None,
        sensors: Sensors,
        unknown: tuple[Unknown, ...],
    ) -> Recording:
        """Return the flight of an autopilot, whose world is NED and whose body is FRD."""
        new = fresh(position.values)
        pose_us = position.t_us[new]
        rate, force, voltage, reference = (
            self.first(of) for of in (sensors.rate, sensors.force, sensors.voltage, sensors.reference)
        )
        imu = rate or force
        return Recording(
            source=self.name,
            pose_us=pose_us,
            p_ned=position.values[new],
            q_ned_frd=turns_at(attitude_us, turn, pose_us).as_quat(scalar_first=True, canonical=True),
            input_us=None if motors is None else motors.t_us,
            motor_command=None if motors is None else motors.values,
            motor_corners=corners,
            imu_us=None if imu is None else imu.t_us,
            gyro=None if rate is None or imu is None else rate.at(imu.t_us),
            specific_force=None if force is None or imu is None else force.at(imu.t_us),
            battery_us=None if voltage is None else voltage.t_us,
            battery_v=None if voltage is None else voltage.values[:, 0],
            reference_us=None if reference is None else reference.t_us,
            p_ref_ned=None if reference is None else reference.values,
            epoch_us=self.start_us,
            unknown=unknown,
        )

    def missing(self, sources: Sequence[Source]) -> ImportFormatError:
        """Return the error that names the topics of every source."""
        wanted = " or ".join(dict.fromkeys(source.topic for source in sources))
        return ImportFormatError(f"{self.name}: no topic {wanted} with its values; log it and fly again")
