"""Read the topics of a log into arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any

import numpy as np

from trimtab.host.log import topics
from trimtab.host.log.scan import Entry
from trimtab.host.log.tracks import (
    Battery,
    Control,
    Estimate,
    Floats,
    HostControl,
    LinkHealth,
    Mocap,
    Observer,
    RecordedImu,
    RecordedInputs,
    Rotors,
    Status,
    Times,
    Timing,
)
from trimtab.protocol.generated import flight_pb2, host_control_pb2, rotors_pb2, timing_pb2

CAMERAS_SET_US = 25_000
"""Jump of the cameras' clock against the host's above which the clock was set."""


def decoded(entries: Mapping[str, Sequence[Entry]], topic: str, kind: Any) -> list[tuple[Entry, Any]]:
    """Return every message of a topic with its entry, in file order."""
    parse = kind.FromString
    return [(entry, parse(entry.data)) for entry in entries.get(topic, ())]


def _finite(kind: type[Any], **arrays: Any) -> Any:
    """Return a `kind` of the rows with finite numbers only; None if there are none.

    A faulty vehicle may report anything. The log keeps it; the arrays leave it out and count it.
    """
    keep = np.ones(len(next(iter(arrays.values()))), dtype=bool)
    for values in arrays.values():
        keep &= np.isfinite(values).reshape(len(values), -1).all(axis=1)
    if not keep.any():
        return None
    return kind(left_out=int((~keep).sum()), **{name: values[keep] for name, values in arrays.items()})


def _times(values: Sequence[int]) -> Times:
    return np.array(values, dtype=np.int64)


def _columns(messages: Sequence[Any], get: Callable[[Any], Sequence[float]], width: int) -> Floats:
    """Return a repeated field, (n, width). Raises ValueError for a message with another number of values."""
    rows = [get(message)[:] for message in messages]  # five times as fast as iterating over each
    if not set(map(len, rows)) <= {width}:
        raise ValueError(f"a message does not have {width} values")
    return np.array(rows, dtype=float).reshape(len(rows), width)


def _quaternions(messages: Sequence[Any]) -> Floats:
    """Return the attitudes, (n, 4), as NaN where all four values are zero, which is no attitude."""
    rows = _columns(messages, lambda m: m.q_ned_frd, 4)
    rows[~rows.any(axis=1)] = np.nan
    return rows


def _scalars(messages: Sequence[Any], name: str) -> Floats:
    return np.array(list(map(attrgetter(name), messages)), dtype=float)


def _counts(messages: Sequence[Any], name: str) -> Times:
    return _times(list(map(attrgetter(name), messages)))


def read_mocap(
    entries: Mapping[str, Sequence[Entry]], shift_us: int, vehicle_shift_us: int, *, stepped: bool
) -> Mocap | None:
    """Return the poses, on the host's clock; None if the log has none.

    shift_us, vehicle_shift_us: by how much the stamps of cameras and vehicle are ahead. stepped: whether the
    vehicle's clock jumped against the host's.
    """
    pairs = decoded(entries, topics.MOCAP_POSE, flight_pb2.MocapPose)
    if not pairs:
        return None
    messages = [message for _, message in pairs]
    source_us, vehicle_us = _counts(messages, "source_us"), _counts(messages, "vehicle_us")
    sent = vehicle_us > 0
    if stepped and sent.any():
        # The host's clock is no bridge then. The stamps with which the poses were forwarded join the clocks
        # of cameras and vehicle directly: where simulated time stood still, both did.
        ahead_us = round(np.median((vehicle_us - source_us)[sent]))
        shifts_us = np.full(len(source_us), vehicle_shift_us - ahead_us)
    else:
        shifts_us = source_us - _times([entry.publish_time_us for entry, _ in pairs])
        start = 0
        for end in np.flatnonzero(np.abs(np.diff(shifts_us)) > CAMERAS_SET_US) + 1:
            shifts_us[start:end] = shifts_us[end - 1]  # the last offset is the most accurate
            start = end
        shifts_us[start:] = shift_us
    t_us = source_us - shifts_us
    forwarded = {"forwarded_us": np.where(sent, vehicle_us - vehicle_shift_us, t_us)} if sent.any() else {}
    return _finite(
        Mocap,
        t_us=t_us,
        t_arrival_us=_times([entry.log_time_us for entry, _ in pairs]),
        p=_columns(messages, lambda m: m.p_ned_m, 3),
        q=_quaternions(messages),
        **forwarded,
    )


def read_estimate(entries: Mapping[str, Sequence[Entry]], shift_us: int) -> Estimate | None:
    """Return the estimates; None if the log has none."""
    messages = [m for _, m in decoded(entries, topics.FC_ESTIMATE, flight_pb2.Estimate)]
    if not messages:
        return None
    return _finite(
        Estimate,
        t_us=_counts(messages, "source_us") - shift_us,
        p=_columns(messages, lambda m: m.p_ned_m, 3),
        v=_columns(messages, lambda m: m.v_ned_m_s, 3),
        q=_quaternions(messages),
        rate=_columns(messages, lambda m: m.rate_frd_rad_s, 3),
        gyro_bias=_columns(messages, lambda m: m.gyro_bias_rad_s, 3),
        mocap_age_s=_scalars(messages, "mocap_age_us") * 1e-6,
    )


def read_control(entries: Mapping[str, Sequence[Entry]], shift_us: int) -> Control | None:
    """Return the control intervals; None if the log has none."""
    every = decoded(entries, topics.FC_CONTROL, flight_pb2.Control)
    messages = [m for _, m in every if m.interval_us]
    if not messages:
        return None
    t1_us = _counts(messages, "source_us") - shift_us
    return _finite(
        Control,
        t0_us=t1_us - _counts(messages, "interval_us"),
        t1_us=t1_us,
        collective=_scalars(messages, "collective_n"),
        rate_cmd=_columns(messages, lambda m: m.rate_cmd_rad_s, 3),
        torque=_columns(messages, lambda m: m.torque_cmd_n_m, 3),
        rate_integral=_columns(messages, lambda m: m.rate_integral, 3),
        motor_mean=_columns(messages, lambda m: m.motor_mean, 4),
        gyro_mean=_columns(messages, lambda m: m.gyro_mean_rad_s, 3),
        force_mean=_columns(messages, lambda m: m.force_mean_m_s2, 3),
    )


def read_observer(entries: Mapping[str, Sequence[Entry]], shift_us: int) -> Observer | None:
    """Return the observer's estimates; None if the log has none."""
    every = decoded(entries, topics.FC_CONTROL, flight_pb2.Control)
    messages = [m for _, m in every if len(m.observer_ned_m_s2)]
    if not messages:
        return None
    return _finite(
        Observer,
        t_us=_counts(messages, "source_us") - shift_us,
        disturbance=_columns(messages, lambda m: m.observer_ned_m_s2, 3),
    )


def read_rotors(entries: Mapping[str, Sequence[Entry]], shift_us: int) -> Rotors | None:
    """Return the rotor speeds; None if the log has none."""
    messages = [m for _, m in decoded(entries, topics.FC_ROTORS, rotors_pb2.Rotors)]
    if not messages:
        return None
    return _finite(
        Rotors,
        t_us=_counts(messages, "source_us") - shift_us,
        speed=_columns(messages, lambda m: m.speed, 4),
    )


def read_status(pairs: Sequence[tuple[Entry, Any]], shift_us: int) -> Status | None:
    """Return the statuses; None if the log has none."""
    messages = [message for _, message in pairs]
    if not messages:
        return None
    return _finite(
        Status,
        t_us=_counts(messages, "source_us") - shift_us,
        state=_counts(messages, "state"),
        failsafe=_counts(messages, "failsafe"),
        battery_v=_scalars(messages, "battery_v"),
        loop_max_us=_counts(messages, "loop_max_us"),
        loop_overruns=_counts(messages, "loop_overruns"),
        receive_overruns=_counts(messages, "receive_overruns"),
        saturated_ticks=_counts(messages, "saturated_ticks"),
        flight_ticks=_counts(messages, "flight_ticks"),
        poses_used=_counts(messages, "poses_used"),
        loop_mean_us=_counts(messages, "loop_mean_us"),
        jitter_us=_counts(messages, "jitter_us"),
        mocap_age_max_us=_counts(messages, "mocap_age_max_us"),
        bad_bytes=_counts(messages, "bad_bytes"),
        conditions=_counts(messages, "conditions"),
        action=_counts(messages, "action"),
        feedforward_faded=_counts(messages, "feedforward_faded"),
    )


def read_link(entries: Mapping[str, Sequence[Entry]]) -> LinkHealth | None:
    """Return the health of the link; None if the log has none."""
    pairs = decoded(entries, topics.LINK, flight_pb2.Link)
    messages = [message for _, message in pairs]
    if not messages:
        return None
    counters = {
        name: _counts(messages, name)
        for name in (
            "frames_sent", "frames_received", "frames_lost", "frames_repeated",
            "messages_sent", "messages_received", "messages_lost",
            "bytes_sent", "bytes_received", "bad_bytes",
        )
    }  # fmt: skip
    clocks = {
        name: _scalars(messages, name)
        for name in ("rtt_us", "rtt_last_us", "clock_offset_us", "clock_offset_sd_us", "camera_offset_us")
    }
    reported = [message.radios for message in messages if message.HasField("radios")]
    names = [field.name for field in flight_pb2.Radios.DESCRIPTOR.fields]
    times = _times([entry.log_time_us for entry, _ in pairs])
    health = _finite(LinkHealth, t_us=times, **counters, **clocks)
    if health is None or not reported:
        return health
    return replace(health, radios={name: getattr(reported[-1], name) for name in names})


def read_timing(entries: Mapping[str, Sequence[Entry]]) -> Timing | None:
    """Return how the host kept to the wall clock; None if the log has nothing of it."""
    pairs = decoded(entries, topics.HOST_TIMING, timing_pb2.Timing)
    if not pairs:
        return None
    messages = [message for _, message in pairs]
    names = ("poses", "late_poses", "pose_late_us", "clock_steps")
    return _finite(
        Timing,
        t_us=_times([entry.log_time_us for entry, _ in pairs]),
        runs_late=np.array([message.runs_late for message in messages]),
        **{name: _counts(messages, name) for name in names},
    )


def read_host_control(
    entries: Mapping[str, Sequence[Entry]], record: Mapping[str, str] | None, shift_us: int
) -> HostControl | None:
    """Return the steps of a controller on the host, described by `record`; None if the log has none."""
    messages = [m for _, m in decoded(entries, topics.HOST_CONTROL, host_control_pb2.HostControl)]
    if record is None or not messages:
        return None
    start_us = int(record["reference_start_us"]) - shift_us
    commanded = np.array([len(message.collective_n) > 0 for message in messages])
    rate_cmd, collective = np.zeros((len(messages), 3)), np.zeros(len(messages))
    sent = [message for message, has_command in zip(messages, commanded, strict=True) if has_command]
    rate_cmd[commanded] = _columns(sent, lambda m: m.rate_cmd_rad_s, 3)
    collective[commanded] = _columns(sent, lambda m: m.collective_n, 1)[:, 0]
    return HostControl(
        t_us=start_us + _counts(messages, "reference_us"),
        outcome=_counts(messages, "outcome"),
        iterations=_counts(messages, "iterations"),
        estimate_age_us=_counts(messages, "estimate_age_us"),
        act_us=start_us + _counts(messages, "act_us"),
        commanded=commanded,
        rate_cmd=rate_cmd,
        collective=collective,
        late_us=_counts(messages, "late_us"),
        start_us=start_us,
        period_us=int(record["period_us"]),
        computing_us=int(record["computing_us"]),
        controller=record["controller"],
        settings_id=record["settings_id"],
        model_id=record.get("model_id"),
    )


def _optional(messages: Sequence[Any], name: str, width: int) -> Floats | None:
    """Return a repeated field, (n, width), or (n,) for width 1; None if it is always empty."""
    if not len(getattr(messages[0], name)):
        return None
    values = _columns(messages, lambda m: getattr(m, name), width)
    return values[:, 0] if width == 1 else values


def read_inputs(entries: Mapping[str, Sequence[Entry]], metadata: Mapping[str, str]) -> RecordedInputs | None:
    """Return the recorded inputs of an imported flight; None if the log has none."""
    pairs = decoded(entries, topics.RECORDED_INPUTS, flight_pb2.RecordedInputs)
    messages = [message for _, message in pairs]
    if not messages:
        return None
    return RecordedInputs(
        t_us=_times([entry.publish_time_us for entry, _ in pairs]),
        level=metadata["input_level"],
        motor=_optional(messages, "motor_command", 4),
        thrust_n=_optional(messages, "thrust_n", 1),
        torque_n_m=_optional(messages, "torque_n_m", 3),
        p_ref=_optional(messages, "p_ref_ned_m", 3),
        v_ref=_optional(messages, "v_ref_ned_m_s", 3),
        a_ref=_optional(messages, "a_ref_ned_m_s2", 3),
        yaw_ref=_optional(messages, "yaw_ref_rad", 1),
    )


def read_imu(entries: Mapping[str, Sequence[Entry]]) -> RecordedImu | None:
    """Return the recorded IMU samples of an imported flight; None if the log has none."""
    pairs = decoded(entries, topics.RECORDED_IMU, flight_pb2.RecordedImu)
    messages = [message for _, message in pairs]
    if not messages:
        return None
    return RecordedImu(
        t_us=_times([entry.publish_time_us for entry, _ in pairs]),
        gyro=_optional(messages, "gyro_rad_s", 3),
        specific_force=_optional(messages, "specific_force_m_s2", 3),
    )


def read_battery(entries: Mapping[str, Sequence[Entry]], status: Status | None) -> Battery | None:
    """Return the battery voltage; None if the log has none."""
    if status is not None:
        return Battery(t_us=status.t_us, battery_v=status.battery_v)
    pairs = decoded(entries, topics.RECORDED_BATTERY, flight_pb2.RecordedBattery)
    if not pairs:
        return None
    return Battery(
        t_us=_times([entry.publish_time_us for entry, _ in pairs]),
        battery_v=_scalars([message for _, message in pairs], "battery_v"),
    )
