"""A flight in memory: one type of arrays for each topic, and the flight that holds them.

Times are integer microseconds on the host's clock from arming (an import: from its first sample). The world
is NED, the body FRD.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray

from trimtab.host.log.contents import LogContents
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

    def rows(self, keep: Annotated[NDArray[Any], "_"]) -> Self:
        """Return the track with these rows only, given as indices or as a mask."""
        arrays = {name: v[keep] for name, v in vars(self).items() if isinstance(v, np.ndarray)}
        return replace(self, **arrays)

    @property
    def _times(self) -> Times:
        """The first of the arrays."""
        return next(v for v in vars(self).values() if isinstance(v, np.ndarray))


@dataclass(frozen=True, kw_only=True, eq=False)
class Mocap(_Track):
    """Camera poses: time of measurement and of arrival, p_ned, q_ned_frd."""

    t_us: Annotated[Times, "poses"]
    t_arrival_us: Annotated[Times, "poses"]
    p: Annotated[Floats, "poses 3"]
    q: Annotated[Floats, "poses 4"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate(_Track):
    """The on-board estimate: p_ned, v_ned, q_ned_frd, rate_frd, gyro bias, age of the pose last used."""

    t_us: Annotated[Times, "samples"]
    p: Annotated[Floats, "samples 3"]
    v: Annotated[Floats, "samples 3"]
    q: Annotated[Floats, "samples 4"]
    rate: Annotated[Floats, "samples 3"]
    gyro_bias: Annotated[Floats, "samples 3"]
    mocap_age_s: Annotated[Floats, "samples"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Control(_Track):
    """Commands and integrals at t1_us; means over (t0_us, t1_us] of motors, gyro and specific force (FRD).

    A motor command acts from its tick to the next one. Gyro and specific force are sampled at the ticks after
    t0_us up to t1_us, so their means belong to the interval `sensed_us`. The rate integral is the control
    law's sum of errors up to t1_us, each over the tick that follows it. Rows with an invalid interval are
    left out.
    """

    t0_us: Annotated[Times, "intervals"]
    t1_us: Annotated[Times, "intervals"]
    collective: Annotated[Floats, "intervals"]
    rate_cmd: Annotated[Floats, "intervals 3"]
    torque: Annotated[Floats, "intervals 3"]
    rate_integral: Annotated[Floats, "intervals 3"]
    motor_mean: Annotated[Floats, "intervals 4"]
    gyro_mean: Annotated[Floats, "intervals 3"]
    force_mean: Annotated[Floats, "intervals 3"]

    @property
    def sensed_us(self) -> Annotated[Floats, "intervals 2"]:
        """Start and end of the interval that each mean of gyro and specific force covers, us."""
        return np.column_stack([self.t0_us, self.t1_us]).astype(np.float64) + 0.5 * TICK_US


@dataclass(frozen=True, kw_only=True, eq=False)
class Observer(_Track):
    """The on-board disturbance observer's estimate at t_us, m/s^2, NED."""

    t_us: Annotated[Times, "samples"]
    disturbance: Annotated[Floats, "samples 3"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Status(_Track):
    """State and failsafe (numbers as in flight.proto), battery voltage, times of ticks, counts since boot."""

    t_us: Annotated[Times, "samples"]
    state: Annotated[Times, "samples"]
    failsafe: Annotated[Times, "samples"]
    battery_v: Annotated[Floats, "samples"]
    loop_max_us: Annotated[Times, "samples"]
    loop_overruns: Annotated[Times, "samples"]
    receive_overruns: Annotated[Times, "samples"]
    saturated_ticks: Annotated[Times, "samples"]
    flight_ticks: Annotated[Times, "samples"]
    poses_used: Annotated[Times, "samples"]
    loop_mean_us: Annotated[Times, "samples"]
    jitter_us: Annotated[Times, "samples"]
    mocap_age_max_us: Annotated[Times, "samples"]
    bad_bytes: Annotated[Times, "samples"]
    conditions: Annotated[Times, "samples"]
    action: Annotated[Times, "samples"]
    feedforward_faded: Annotated[Times, "samples"]
    """Percent of the residual acceleration fed forward that is faded out."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkHealth(_Track):
    """Counters of the link since connection, round trip, clock offsets (vehicle or camera minus host)."""

    t_us: Annotated[Times, "samples"]
    frames_sent: Annotated[Times, "samples"]
    frames_received: Annotated[Times, "samples"]
    frames_lost: Annotated[Times, "samples"]
    frames_repeated: Annotated[Times, "samples"]
    messages_sent: Annotated[Times, "samples"]
    messages_received: Annotated[Times, "samples"]
    messages_lost: Annotated[Times, "samples"]
    bytes_sent: Annotated[Times, "samples"]
    bytes_received: Annotated[Times, "samples"]
    bad_bytes: Annotated[Times, "samples"]
    rtt_us: Annotated[Floats, "samples"]
    rtt_last_us: Annotated[Floats, "samples"]
    clock_offset_us: Annotated[Floats, "samples"]
    clock_offset_sd_us: Annotated[Floats, "samples"]
    camera_offset_us: Annotated[Floats, "samples"]
    radios: Mapping[str, int] | None = None
    """Final counters of both radios, by the names in flight.proto."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HostControl(_Track):
    """Steps of a controller on the host that flew the vehicle.

    A command of zeros where `commanded` is False was not sent. Times and `start_us`, the start of the
    reference, are on the log's clock. `act_us` is when a command was to take effect; `late_us` is how much
    later than declared it was sent. `outcome`: numbers as in flight.proto.
    """

    t_us: Annotated[Times, "steps"]
    outcome: Annotated[Times, "steps"]
    iterations: Annotated[Times, "steps"]
    estimate_age_us: Annotated[Times, "steps"]
    act_us: Annotated[Times, "steps"]
    commanded: Annotated[NDArray[np.bool_], "steps"]
    rate_cmd: Annotated[Floats, "steps 3"]
    collective: Annotated[Floats, "steps"]
    late_us: Annotated[Times, "steps"]
    start_us: int
    period_us: int
    computing_us: int
    controller: str
    settings_id: str
    model_id: str | None


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedInputs(_Track):
    """Inputs of a foreign vehicle; `level` says which arrays are present.

    "motor": motor in 0..1. "thrust-torque": thrust_n, torque_n_m FRD. "reference": p_ref and, if the log has
    them, v_ref, a_ref NED and yaw_ref. Arrays of lower levels may be present too.
    """

    t_us: Annotated[Times, "inputs"]
    level: str
    motor: Annotated[Floats, "inputs 4"] | None = None
    thrust_n: Annotated[Floats, "inputs"] | None = None
    torque_n_m: Annotated[Floats, "inputs 3"] | None = None
    p_ref: Annotated[Floats, "inputs 3"] | None = None
    v_ref: Annotated[Floats, "inputs 3"] | None = None
    a_ref: Annotated[Floats, "inputs 3"] | None = None
    yaw_ref: Annotated[Floats, "inputs"] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.level not in LEVELS:
            raise ValueError(f"level {self.level!r} is not one of {', '.join(LEVELS)}")
        needed = {"motor": (self.motor,), "thrust-torque": (self.thrust_n, self.torque_n_m)}
        if any(values is None for values in needed.get(self.level, (self.p_ref,))):
            raise ValueError(f"level {self.level!r} without its values")


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedImu(_Track):
    """A foreign vehicle's gyro and specific force, FRD; None for one that was not recorded."""

    t_us: Annotated[Times, "samples"]
    gyro: Annotated[Floats, "samples 3"] | None
    specific_force: Annotated[Floats, "samples 3"] | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Battery(_Track):
    """Battery voltage."""

    t_us: Annotated[Times, "voltages"]
    battery_v: Annotated[Floats, "voltages"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Flight:
    """One flight or import. Absent data is None.

    Attributes
    ----------
    id, path
        First 12 hex digits of the SHA-256 of the log, and its path.
    kind
        "flight" or "imported".
    vehicle
        The vehicle file in the log.
    reference, reference_id
        Reference that was flown.
    feedforward, firmware_parameters
        Feed-forward that was flown, and the parameters on board by name.
    metadata
        Provenance of the log: version, command, host seed, index of the flight, and others.
    mocap, estimate, control, observer, status, link
        Arrays of each topic.
    recorded_inputs, recorded_imu
        Inputs and IMU of a foreign vehicle.
    battery
        Voltage over time.
    tracking
        Start and end of the interval that learning and errors use, us.
    tracking_whole
        Whether the reference was flown to its end. Always True for an import.
    failsafe
        Name of the failsafe that ended the flight: a key of FAILSAFE_WORDS.
    duration_s
        Duration of the log, s.
    contents
        Size and topics of the log's file.
    host_control
        Steps of a controller on the host; None if the vehicle flew by its own law, or in an import.
    """

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
    failsafe: str | None
    duration_s: float
    contents: LogContents
    host_control: HostControl | None = None

    @property
    def flown_by_own_law(self) -> bool:
        """Whether the reference and the law on board explain the flight: no other controller commanded."""
        known = self.reference is not None and self.firmware_parameters is not None
        return known and self.host_control is None

    def to_dict(self) -> dict[str, Any]:
        """Return the object that `trimtab log info --json` prints, as plain data."""
        from trimtab.host.log.info import describe

        return describe(self)

    def _repr_html_(self) -> str:
        from trimtab.host.log.info import flight_card

        return flight_card(self)
