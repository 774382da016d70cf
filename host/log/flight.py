"""Reads a log into the arrays of a Flight.

Times are integer microseconds on the host's clock from arm (an import: from its first sample). Vehicle stamps
are translated with the last clock offset of the log, which rests on the whole flight, not with the one of the
moment.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError

from trimtab.host.log import topics
from trimtab.host.log.composed import composed, swap_us
from trimtab.host.log.errors import LogError
from trimtab.host.log.scan import Entry, Scan, find_damaged, scan
from trimtab.host.log.tracks import (
    Battery,
    Control,
    Estimate,
    Flight,
    Floats,
    LinkHealth,
    Mocap,
    Observer,
    RecordedImu,
    RecordedInputs,
    Status,
    Times,
    failsafe_name,
)
from trimtab.host.log.writer import (
    FEEDFORWARD_FILE,
    PARAMETERS,
    PROVENANCE,
    REFERENCE_FILE,
    THEN_FILE,
    VEHICLE_FILE,
)
from trimtab.host.vehicle import ConfigurationError, parse_vehicle
from trimtab.protocol.blobs import FeedForward, Reference, blob_id
from trimtab.protocol.generated import flight_pb2

State = flight_pb2.Status.State
CAMERAS_SET_US = 25_000
"""Where the cameras' clock against the host's jumps by more, it was set."""


def read_flight(path: Path | str, *, leave_out: Collection[str] = ()) -> Flight:
    """Return the flight in a closed log, as if it had no messages of the topics in `leave_out`.

    Raises LogError (exit code 5) where it is cut, damaged or not ours.
    """
    return to_flight(scan_closed(Path(path)), leave_out=leave_out)


def scan_closed(path: Path) -> Scan:
    """All records of a closed log. Raises LogError, naming the remedy, where it is cut or no log of ours."""
    found = scan(find_damaged(path))
    if not found.whole:
        raise LogError(
            f"{found.path}: ends early or is damaged ({found.damage}); run `trimtab log recover {found.path}`"
        )
    if PROVENANCE not in found.metadata or VEHICLE_FILE not in found.attachments:
        raise LogError(
            f"{found.path}: an MCAP file, but no trimtab log; foreign logs come in by `trimtab import`"
        )
    return found


def to_flight(found: Scan, *, leave_out: Collection[str] = ()) -> Flight:
    """Return the arrays of a closed log's records, without the topics in `leave_out`.

    Raises LogError where they contradict each other.
    """
    try:
        return _to_flight(found, leave_out)
    except (DecodeError, ValueError, KeyError, ConfigurationError) as error:
        text = " ".join(str(error).split())
        raise LogError(
            f"{found.path}: damaged ({text}); take the log again from where it was flown"
        ) from error


def _to_flight(found: Scan, leave_out: Collection[str]) -> Flight:
    told = found.metadata[PROVENANCE]
    attached = {name: data for name, (_, data) in found.attachments.items()}
    vehicle = parse_vehicle(attached[VEHICLE_FILE].decode(), f"{found.path}:{VEHICLE_FILE}")
    reference_bytes = attached.get(REFERENCE_FILE)
    feedforward_bytes = attached.get(FEEDFORWARD_FILE)
    then_bytes = attached.get(THEN_FILE)
    for blob, key in (
        (reference_bytes, "reference_id"),
        (feedforward_bytes, "feedforward_id"),
        (then_bytes, "then_id"),
    ):
        if blob is not None and blob_id(blob) != told.get(key):
            raise ValueError(f"the attached blob is not {key} {told.get(key)}")
    if vehicle.id != told["vehicle_id"]:
        raise ValueError(f"the attached vehicle is {vehicle.id}, not {told['vehicle_id']}")
    reference = None if reference_bytes is None else Reference.from_bytes(reference_bytes)
    entries = {topic: rows for topic, rows in found.by_topic().items() if topic not in leave_out}
    link = _read_link(entries)
    offset_us = float(link.clock_offset_us[-1]) if link is not None else 0.0
    camera_us = float(link.camera_offset_us[-1]) if link is not None else 0.0
    arm_us = int(told.get("arm_host_us", "0"))
    vehicle_shift_us = round(offset_us) + arm_us
    camera_shift_us = round(camera_us) + arm_us
    mocap = _read_mocap(entries, camera_shift_us)
    statuses = _decoded(entries, topics.FC_STATUS, flight_pb2.Status)
    status = _read_status(statuses, vehicle_shift_us)
    reference_id, swapped = told.get("reference_id"), None
    if reference is not None and then_bytes is not None:
        then = Reference.from_bytes(then_bytes)
        swapped = swap_us([message for _, message in statuses], then)
        if swapped is not None:
            reference = composed(reference, then, swapped[1] - swapped[0])
            reference_id = reference.id
    began_us = None if swapped is None else swapped[0]
    tracking, whole = _tracking(statuses, reference, vehicle_shift_us, began_us)
    if tracking is None and "tracking_us" in told:
        start_us, end_us = told["tracking_us"].split()
        tracking, whole = (int(start_us), int(end_us)), True
    parameters = found.metadata.get(PARAMETERS)
    failsafe = max((message.failsafe for _, message in statuses), default=0)
    times = [entry.log_time_us for entry in found.messages]
    return Flight(
        id=found.id,
        path=found.path,
        kind=told["kind"],
        vehicle=vehicle,
        reference=reference,
        reference_id=reference_id,
        feedforward=None if feedforward_bytes is None else FeedForward.from_bytes(feedforward_bytes),
        firmware_parameters=None if parameters is None else {k: float(v) for k, v in parameters.items()},
        metadata=told,
        mocap=mocap,
        estimate=_read_estimate(entries, vehicle_shift_us),
        control=_read_control(entries, vehicle_shift_us),
        observer=_read_observer(entries, vehicle_shift_us),
        status=status,
        link=link,
        recorded_inputs=_read_inputs(entries, told),
        recorded_imu=_read_imu(entries),
        battery=_read_battery(entries, status),
        tracking=tracking,
        tracking_whole=whole,
        failsafe=failsafe_name(failsafe),
        duration_s=(max(times) - min(times)) * 1e-6 if times else 0.0,
    )


def _decoded(entries: Mapping[str, Sequence[Entry]], topic: str, kind: Any) -> list[tuple[Entry, Any]]:
    """Every message of a topic with its entry, in file order."""
    parse = kind.FromString
    return [(entry, parse(entry.data)) for entry in entries.get(topic, ())]


def _finite(kind: type[Any], **arrays: Any) -> Any:
    """Return a `kind` of the rows that hold finite numbers only, None where there are none.

    A vehicle that lost its mind may report anything; the log keeps it, the arrays do not, but say how many.
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
    """(n, width) of a repeated field. Raises ValueError where a message has another number of values."""
    rows = [get(message)[:] for message in messages]  # five times as fast as iterating over each
    if any(len(row) != width for row in rows):
        raise ValueError(f"a message without its {width} values")
    return np.array(rows, dtype=float).reshape(len(rows), width)


def _scalars(messages: Sequence[Any], name: str) -> Floats:
    return np.array([getattr(message, name) for message in messages], dtype=float)


def _counts(messages: Sequence[Any], name: str) -> Times:
    return _times([getattr(message, name) for message in messages])


def _read_mocap(entries: Mapping[str, Sequence[Entry]], shift_us: int) -> Mocap | None:
    pairs = _decoded(entries, topics.MOCAP_POSE, flight_pb2.MocapPose)
    if not pairs:
        return None
    messages = [message for _, message in pairs]
    source_us = _counts(messages, "source_us")
    shifts_us = source_us - _times([entry.publish_time_us for entry, _ in pairs])
    start = 0
    for end in np.flatnonzero(np.abs(np.diff(shifts_us)) > CAMERAS_SET_US) + 1:
        shifts_us[start:end] = shifts_us[end - 1]  # how far a clock is, is known best at the end
        start = end
    shifts_us[start:] = shift_us
    return _finite(
        Mocap,
        t_us=source_us - shifts_us,
        t_arrival_us=_times([entry.log_time_us for entry, _ in pairs]),
        p=_columns(messages, lambda m: m.p_ned_m, 3),
        q=_columns(messages, lambda m: m.q_ned_frd, 4),
    )


def _read_estimate(entries: Mapping[str, Sequence[Entry]], shift_us: int) -> Estimate | None:
    messages = [m for _, m in _decoded(entries, topics.FC_ESTIMATE, flight_pb2.Estimate)]
    if not messages:
        return None
    return _finite(
        Estimate,
        t_us=_counts(messages, "source_us") - shift_us,
        p=_columns(messages, lambda m: m.p_ned_m, 3),
        v=_columns(messages, lambda m: m.v_ned_m_s, 3),
        q=_columns(messages, lambda m: m.q_ned_frd, 4),
        rate=_columns(messages, lambda m: m.rate_frd_rad_s, 3),
        gyro_bias=_columns(messages, lambda m: m.gyro_bias_rad_s, 3),
        mocap_age_s=_scalars(messages, "mocap_age_us") * 1e-6,
    )


def _read_control(entries: Mapping[str, Sequence[Entry]], shift_us: int) -> Control | None:
    every = _decoded(entries, topics.FC_CONTROL, flight_pb2.Control)
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


def _read_observer(entries: Mapping[str, Sequence[Entry]], shift_us: int) -> Observer | None:
    every = _decoded(entries, topics.FC_CONTROL, flight_pb2.Control)
    messages = [m for _, m in every if len(m.observer_ned_m_s2)]
    if not messages:
        return None
    return _finite(
        Observer,
        t_us=_counts(messages, "source_us") - shift_us,
        disturbance=_columns(messages, lambda m: m.observer_ned_m_s2, 3),
    )


def _read_status(pairs: Sequence[tuple[Entry, Any]], shift_us: int) -> Status | None:
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
    )


def _read_link(entries: Mapping[str, Sequence[Entry]]) -> LinkHealth | None:
    pairs = _decoded(entries, topics.LINK, flight_pb2.Link)
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
    found = _finite(LinkHealth, t_us=times, **counters, **clocks)
    if found is None or not reported:
        return found
    return replace(found, radios={name: getattr(reported[-1], name) for name in names})


def _tracking(
    pairs: Sequence[tuple[Entry, Any]],
    reference: Reference | None,
    shift_us: int,
    began_us: int | None,
) -> tuple[tuple[int, int] | None, bool]:
    """Start and end of the tracking phase, and whether the reference was flown to its end.

    It starts where the vehicle says the reference's time 0 is, or at `began_us` (the vehicle's clock) where
    another took over since. It ends with the reference, or with the last
    status that still says tracking where the vehicle left the phase before or the log ends.
    """
    seen = [message for _, message in pairs if message.state == State.TRACKING]
    starts = [message.tracking_start_us for _, message in pairs if message.tracking_start_us]
    if not starts or not (seen or reference is not None):
        return None, False
    zero_us = starts[-1] if began_us is None else began_us
    start_us = zero_us - shift_us
    passed = [m.source_us for _, m in pairs if m.state > State.TRACKING and m.source_us > zero_us]
    if reference is not None:
        end_us = start_us + reference.duration_us
        if passed and min(passed) - shift_us >= end_us:
            return (start_us, end_us), True
    if not seen:
        return None, False
    end_us = max(message.source_us for message in seen) - shift_us
    return ((start_us, end_us), False) if end_us > start_us else (None, False)


def _optional(messages: Sequence[Any], name: str, width: int) -> Floats | None:
    """(n, width) of a repeated field, (n,) for width 1, None where it is empty throughout."""
    if not len(getattr(messages[0], name)):
        return None
    values = _columns(messages, lambda m: getattr(m, name), width)
    return values[:, 0] if width == 1 else values


def _read_inputs(entries: Mapping[str, Sequence[Entry]], told: Mapping[str, str]) -> RecordedInputs | None:
    pairs = _decoded(entries, topics.RECORDED_INPUTS, flight_pb2.RecordedInputs)
    messages = [message for _, message in pairs]
    if not messages:
        return None
    return RecordedInputs(
        t_us=_times([entry.publish_time_us for entry, _ in pairs]),
        level=told["input_level"],
        motor=_optional(messages, "motor_command", 4),
        thrust_n=_optional(messages, "thrust_n", 1),
        torque_n_m=_optional(messages, "torque_n_m", 3),
        p_ref=_optional(messages, "p_ref_ned_m", 3),
        v_ref=_optional(messages, "v_ref_ned_m_s", 3),
        a_ref=_optional(messages, "a_ref_ned_m_s2", 3),
        yaw_ref=_optional(messages, "yaw_ref_rad", 1),
    )


def _read_imu(entries: Mapping[str, Sequence[Entry]]) -> RecordedImu | None:
    pairs = _decoded(entries, topics.RECORDED_IMU, flight_pb2.RecordedImu)
    messages = [message for _, message in pairs]
    if not messages:
        return None
    return RecordedImu(
        t_us=_times([entry.publish_time_us for entry, _ in pairs]),
        gyro=_optional(messages, "gyro_rad_s", 3),
        specific_force=_optional(messages, "specific_force_m_s2", 3),
    )


def _read_battery(entries: Mapping[str, Sequence[Entry]], status: Status | None) -> Battery | None:
    if status is not None:
        return Battery(t_us=status.t_us, battery_v=status.battery_v)
    pairs = _decoded(entries, topics.RECORDED_BATTERY, flight_pb2.RecordedBattery)
    if not pairs:
        return None
    return Battery(
        t_us=_times([entry.publish_time_us for entry, _ in pairs]),
        battery_v=_scalars([message for _, message in pairs], "battery_v"),
    )
