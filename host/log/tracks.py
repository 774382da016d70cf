"""A flight in memory: one type of arrays for each topic, and the flight that holds them.

Times are integer microseconds on the host's clock from arming (an import: from its first sample). The world
is NED, the body FRD.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import FeedForward, Reference
from trimtab.protocol.generated import flight_pb2
from trimtab.protocol.telemetry import TICK_US

Floats = NDArray[np.float64]
Times = NDArray[np.int64]
LEVELS = ("motor", "thrust-torque", "reference")
FAILSAFE_WORDS = {
    "mocap-lost": "mocap lost",
    "link-lost": "link lost",
    "tilt": "tilted too far",
    "battery-low": "battery low",
    "saturated": "motors saturated for long",
    "imu-stuck": "IMU stuck",
    "loop-overrun": "ticks too late too often",
    "geofence": "outside the flight volume",
}
"""Descriptions of the failsafes, by name."""


def failsafe_name(number: int) -> str | None:
    """Return the name of a failsafe by its number in FC_STATUS and in the log; None for 0 (no failsafe)."""
    names = {value: name.lower().replace("_", "-") for name, value in flight_pb2.Status.Failsafe.items()}
    return names.get(number, str(number)) if number else None


@dataclass(frozen=True, kw_only=True, eq=False)
class _Track:
    """Arrays of one topic, all with the same first dimension. Times never decrease.

    `left_out` counts the rows of the log that were left out because a value was not finite.
    """

    left_out: int = 0

    def __post_init__(self) -> None:
        lengths = set()
        for spec in fields(self):
            values = getattr(self, spec.name)
            if isinstance(values, np.ndarray):
                lengths.add(len(values))
                if values.dtype.kind == "f" and not np.isfinite(values).all():
                    raise ValueError(f"{type(self).__name__}.{spec.name} holds values that are not finite")
        if len(lengths) != 1:
            raise ValueError(f"{type(self).__name__}: arrays of lengths {sorted(lengths)}")
        if (np.diff(self._times) < 0).any():
            raise ValueError(f"{type(self).__name__}: times decrease")

    def __len__(self) -> int:
        return len(self._times)

    def rows(self, keep: NDArray[Any]) -> Self:
        """Return the track with these rows only, given as indices or as a mask (n,)."""
        arrays = {name: v[keep] for name, v in vars(self).items() if isinstance(v, np.ndarray)}
        return replace(self, **arrays)

    @property
    def _times(self) -> Times:
        """The first of the arrays."""
        return next(v for v in vars(self).values() if isinstance(v, np.ndarray))


@dataclass(frozen=True, kw_only=True, eq=False)
class Mocap(_Track):
    """Camera poses: time of measurement and of arrival, p_ned (n, 3), q_ned_frd (n, 4)."""

    t_us: Times
    t_arrival_us: Times
    p: Floats
    q: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate(_Track):
    """The on-board estimate: p_ned, v_ned, q_ned_frd, rate_frd, gyro bias, age of the pose last used."""

    t_us: Times
    p: Floats
    v: Floats
    q: Floats
    rate: Floats
    gyro_bias: Floats
    mocap_age_s: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Control(_Track):
    """Commands and integrals at t1_us; means over (t0_us, t1_us] of motors, gyro and specific force (FRD).

    A motor command acts from its tick to the next one. Gyro and specific force are sampled at the ticks after
    t0_us up to t1_us, so their means belong to the interval `sensed_us`. The rate integral is the control
    law's sum of errors up to t1_us, each over the tick that follows it. Rows with an invalid interval are
    left out.
    """

    t0_us: Times
    t1_us: Times
    collective: Floats
    rate_cmd: Floats
    torque: Floats
    rate_integral: Floats
    motor_mean: Floats
    gyro_mean: Floats
    force_mean: Floats

    @property
    def sensed_us(self) -> Floats:
        """Start and end (n, 2) of the interval that each mean of gyro and specific force covers, us."""
        return np.column_stack([self.t0_us, self.t1_us]).astype(np.float64) + 0.5 * TICK_US


@dataclass(frozen=True, kw_only=True, eq=False)
class Observer(_Track):
    """The on-board disturbance observer's estimate at t_us: (n, 3), m/s^2, NED."""

    t_us: Times
    disturbance: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Status(_Track):
    """State and failsafe (numbers as in flight.proto), battery voltage, times of ticks, counts since boot."""

    t_us: Times
    state: Times
    failsafe: Times
    battery_v: Floats
    loop_max_us: Times
    loop_overruns: Times
    receive_overruns: Times
    saturated_ticks: Times
    flight_ticks: Times
    poses_used: Times
    loop_mean_us: Times
    jitter_us: Times
    mocap_age_max_us: Times
    bad_bytes: Times
    conditions: Times
    action: Times


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkHealth(_Track):
    """Counters of the link since connection, round trip, clock offsets (vehicle or camera minus host)."""

    t_us: Times
    frames_sent: Times
    frames_received: Times
    frames_lost: Times
    frames_repeated: Times
    messages_sent: Times
    messages_received: Times
    messages_lost: Times
    bytes_sent: Times
    bytes_received: Times
    bad_bytes: Times
    rtt_us: Floats
    rtt_last_us: Floats
    clock_offset_us: Floats
    clock_offset_sd_us: Floats
    camera_offset_us: Floats
    radios: Mapping[str, int] | None = None
    """Final counters of both radios, by the names in flight.proto."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedInputs(_Track):
    """Inputs of a foreign vehicle; `level` says which arrays are present.

    "motor": motor (n, 4) in 0..1. "thrust-torque": thrust_n (n,), torque_n_m (n, 3) FRD. "reference": p_ref
    and, if the log has them, v_ref, a_ref (n, 3) NED and yaw_ref (n,). Arrays of lower levels may be present
    too.
    """

    t_us: Times
    level: str
    motor: Floats | None = None
    thrust_n: Floats | None = None
    torque_n_m: Floats | None = None
    p_ref: Floats | None = None
    v_ref: Floats | None = None
    a_ref: Floats | None = None
    yaw_ref: Floats | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.level not in LEVELS:
            raise ValueError(f"level {self.level!r} is not one of {', '.join(LEVELS)}")
        needed = {"motor": (self.motor,), "thrust-torque": (self.thrust_n, self.torque_n_m)}
        if any(values is None for values in needed.get(self.level, (self.p_ref,))):
            raise ValueError(f"level {self.level!r} without its values")


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedImu(_Track):
    """A foreign vehicle's gyro and specific force (n, 3), FRD; None for one that was not recorded."""

    t_us: Times
    gyro: Floats | None
    specific_force: Floats | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Battery(_Track):
    """Battery voltage."""

    t_us: Times
    battery_v: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Flight:
    """One flight or import. Absent data is None. `tracking` is the interval that learning and errors use."""

    id: str
    path: Path
    kind: str
    vehicle: Vehicle
    reference: Reference | None
    reference_id: str | None
    feedforward: FeedForward | None
    firmware_parameters: Mapping[str, float] | None
    metadata: Mapping[str, str]
    mocap: Mocap | None
    estimate: Estimate | None
    control: Control | None
    observer: Observer | None
    status: Status | None
    link: LinkHealth | None
    recorded_inputs: RecordedInputs | None
    recorded_imu: RecordedImu | None
    battery: Battery | None
    tracking: tuple[int, int] | None
    tracking_whole: bool
    """Whether the reference was flown to its end. Always True for an import."""
    failsafe: str | None
    """Name of the failsafe that ended the flight: a key of FAILSAFE_WORDS."""
    duration_s: float
