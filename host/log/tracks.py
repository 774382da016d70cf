"""The arrays of a flight, one type for each topic.

Times are integer microseconds on the host's clock from arming (an import: from its first sample). The world
is NED, the body FRD.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray

from trimtab.protocol.generated import flight_pb2
from trimtab.protocol.telemetry import TICK_US

Floats = NDArray[np.float64]
Times = NDArray[np.int64]
LEVELS = ("motor", "thrust-torque", "reference")
_NEIGHBOURS = 100
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
    """Poses of the camera system, as they arrived.

    Attributes
    ----------
    t_us, t_arrival_us
        Times of measurement and of arrival at the host, us.
    p
        Position in NED, m.
    q
        Attitude of FRD in NED as a quaternion, w first.
    forwarded_us
        Times of measurement as the vehicle was told them, us: a clock that was compared badly makes them
        differ from `t_us`. None if no pose was forwarded.
    """

    t_us: Annotated[Times, "poses"]
    t_arrival_us: Annotated[Times, "poses"]
    p: Annotated[Floats, "poses 3"]
    q: Annotated[Floats, "poses 4"]
    forwarded_us: Annotated[Times, "poses"] | None = None

    @property
    def late_us(self) -> Annotated[Times, "poses"]:
        """How much later each pose arrived than the promptest of a hundred before and after it, us."""
        delay_us = self.t_arrival_us - self.t_us
        around = np.pad(delay_us, _NEIGHBOURS, mode="edge")
        return delay_us - np.lib.stride_tricks.sliding_window_view(around, 2 * _NEIGHBOURS + 1).min(axis=1)


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate(_Track):
    """The on-board estimate.

    Attributes
    ----------
    t_us
        Times, us.
    p, v
        Position and velocity in NED, m and m/s.
    q
        Attitude of FRD in NED as a quaternion, w first.
    rate, gyro_bias
        Body rate without the bias of the gyro, and that bias, FRD, rad/s.
    mocap_age_s
        Age of the pose last used, s.
    """

    t_us: Annotated[Times, "samples"]
    p: Annotated[Floats, "samples 3"]
    v: Annotated[Floats, "samples 3"]
    q: Annotated[Floats, "samples 4"]
    rate: Annotated[Floats, "samples 3"]
    gyro_bias: Annotated[Floats, "samples 3"]
    mocap_age_s: Annotated[Floats, "samples"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Control(_Track):
    """Commands and integrals at the ends of intervals, and means over the intervals.

    A motor command acts from its tick to the next one. Gyro and specific force are sampled at the ticks after
    t0_us up to t1_us, so their means belong to the interval `sensed_us`. Rows with an invalid interval are
    left out.

    Attributes
    ----------
    t0_us, t1_us
        Start (excluded) and end of each interval, us.
    collective
        Commanded collective thrust at t1_us, N.
    rate_cmd, torque
        Commanded body rate and torque at t1_us, FRD, rad/s and N m.
    rate_integral
        The law's integral of the body rate's error up to t1_us, FRD, rad/s^2: its sum of errors, each over
        the tick that follows it.
    motor_mean
        Mean motor command, 0 to 1, in the order of the vehicle's rotors.
    gyro_mean, force_mean
        Mean gyro and specific force, FRD, rad/s and m/s^2.
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
    """The estimate of the on-board disturbance observer.

    Attributes
    ----------
    t_us
        Times, us.
    disturbance
        Acceleration that gravity, nominal thrust and feed-forward do not explain, NED, m/s^2.
    """

    t_us: Annotated[Times, "samples"]
    disturbance: Annotated[Floats, "samples 3"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Rotors(_Track):
    """Rotor speeds as the motor controllers measure them.

    Attributes
    ----------
    t_us
        Times, us.
    speed
        Speed of each rotor, over that at the greatest thrust.
    """

    t_us: Annotated[Times, "samples"]
    speed: Annotated[Floats, "samples 4"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Status(_Track):
    """State and health of the vehicle.

    Attributes
    ----------
    t_us
        Times, us.
    state, failsafe
        Numbers as in flight.proto.
    battery_v
        Voltage of the battery, V.
    loop_max_us, loop_mean_us, jitter_us
        Greatest and mean work time of a tick, and greatest deviation of its beginning, since the last
        status, us.
    loop_overruns, receive_overruns, bad_bytes
        Ticks that came late, bytes lost for lack of space, and bytes of no complete message, since boot.
    saturated_ticks, flight_ticks, poses_used
        Counts since boot. Saturated: the motors could not produce the command.
    mocap_age_max_us
        Greatest age of the newest pose used, since the last status, us.
    conditions, action
        Active rows of the failsafe table, by bit, and the action taken.
    feedforward_faded
        Percent of the residual acceleration fed forward that is faded out.
    """

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


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkHealth(_Track):
    """Health of the link. Counts are since connection.

    Attributes
    ----------
    t_us
        Times, us.
    frames_sent, frames_received, frames_lost, frames_repeated
        Radio frames, both ways.
    messages_sent, messages_received, messages_lost
        Messages sent and received by the host, and lost on the way to it.
    bytes_sent, bytes_received, bad_bytes
        Bytes at the host's port.
    rtt_us, rtt_last_us
        Smoothed and newest round trip, us.
    clock_offset_us, clock_offset_sd_us, camera_offset_us
        The vehicle's clock minus the host's with its standard deviation, and the cameras' clock minus the
        host's, us.
    radios
        Final counters of both radios, by the names in flight.proto; None unless both report.
    """

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


@dataclass(frozen=True, kw_only=True, eq=False)
class Timing(_Track):
    """How the host of a flight at a port kept to the wall clock.

    Attributes
    ----------
    t_us
        Times, us.
    poses, late_poses
        Poses that arrived since the last message, and how many of them were late.
    pose_late_us
        Greatest lateness since the last message, us.
    runs_late
        Whether time ran late: poses were late often.
    clock_steps
        How often the vehicle's clock has jumped against the host's, since connection.
    """

    t_us: Annotated[Times, "samples"]
    poses: Annotated[Times, "samples"]
    late_poses: Annotated[Times, "samples"]
    pose_late_us: Annotated[Times, "samples"]
    runs_late: Annotated[NDArray[np.bool_], "samples"]
    clock_steps: Annotated[Times, "samples"]


@dataclass(frozen=True, kw_only=True, eq=False)
class HostControl(_Track):
    """Steps of a controller on the host that flew the vehicle.

    Attributes
    ----------
    t_us
        Times of the steps, us.
    outcome, iterations
        Outcome (numbers as in flight.proto) and iterations of the solver.
    estimate_age_us
        Age of the estimate that the step used, us.
    act_us, late_us
        When the command was to take effect, and how much later than declared it was sent, us.
    commanded
        Whether a command was sent; the values of one that was not are zeros.
    rate_cmd, collective
        Commanded body rate, FRD, rad/s, and nominal collective thrust, N.
    start_us
        Start of the reference, us.
    period_us, computing_us
        Time between two steps, and declared computing time, us.
    controller, settings_id, model_id
        Name of the controller, id of its settings, and id of its model; None without one.
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

    @property
    def identity(self) -> tuple[str, str, str | None]:
        """Name, settings and model of the controller: two flights with the same one were flown alike."""
        return self.controller, self.settings_id, self.model_id


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedInputs(_Track):
    """Inputs of a foreign vehicle. Arrays that were not recorded are None.

    Attributes
    ----------
    t_us
        Times, us.
    level
        Which arrays are present: "motor", "thrust-torque" or "reference". Those of lower levels may be too.
    motor
        Motor commands, 0 to 1, in the order of the vehicle's rotors.
    thrust_n, torque_n_m
        Commanded collective thrust, N, and torque, FRD, N m.
    p_ref, v_ref, a_ref
        Position, velocity and acceleration of the reference, NED, m, m/s and m/s^2.
    yaw_ref
        Heading of the reference, rad.
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
    """IMU of a foreign vehicle. An array that was not recorded is None.

    Attributes
    ----------
    t_us
        Times, us.
    gyro, specific_force
        Body rate and specific force, FRD, rad/s and m/s^2.
    """

    t_us: Annotated[Times, "samples"]
    gyro: Annotated[Floats, "samples 3"] | None
    specific_force: Annotated[Floats, "samples 3"] | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Battery(_Track):
    """Voltage of the battery.

    Attributes
    ----------
    t_us
        Times, us.
    battery_v
        Voltage, V.
    """

    t_us: Annotated[Times, "voltages"]
    battery_v: Annotated[Floats, "voltages"]
