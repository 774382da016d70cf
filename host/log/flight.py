"""Read a log into the arrays of a Flight.

Times are integer microseconds on the host's clock, from arming on (imports: from the first sample on).
Vehicle stamps are translated with the log's last clock offset, because it uses the whole flight.
"""

from __future__ import annotations

import gc
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from google.protobuf.message import DecodeError

from trimtab.host.log import topics
from trimtab.host.log.composed import composed, swap_us
from trimtab.host.log.contents import LogContents
from trimtab.host.log.errors import NOT_OURS, LogError, foreign_log
from trimtab.host.log.one_flight import Flight
from trimtab.host.log.provenance import (
    AUTOPILOT,
    FEEDFORWARD_FILE,
    HOST_CONTROL,
    PARAMETERS,
    PROVENANCE,
    REFERENCE_FILE,
    THEN_FILE,
    UNUSED,
    VEHICLE_FILE,
)
from trimtab.host.log.read_topics import (
    decoded,
    read_battery,
    read_control,
    read_estimate,
    read_host_control,
    read_imu,
    read_inputs,
    read_link,
    read_mocap,
    read_observer,
    read_rotors,
    read_status,
    read_timing,
)
from trimtab.host.log.rebuilt import rebuilt_of
from trimtab.host.log.scan import Entry, Scan, scan
from trimtab.host.log.tracks import (
    HostControl,
    failsafe_name,
)
from trimtab.host.log.unfinished import check_not_written, find_damaged
from trimtab.host.vehicle import ConfigurationError, parse_vehicle
from trimtab.protocol.blobs import FeedForward, Reference, blob_id
from trimtab.protocol.generated import flight_pb2

State = flight_pb2.Status.State


def read_flight(path: Path | str, *, leave_out: Collection[str] = ()) -> Flight:
    """Read the flight in a closed log.

    Parameters
    ----------
    path
        Flight log, .mcap.
    leave_out
        Topics whose arrays are not read.

    Returns
    -------
    Flight
        Arrays of each topic: times in us, positions in NED in m, attitudes as quaternions of FRD in NED.

    Raises
    ------
    LogError
        If the log is cut, damaged or of another program.
    """
    with _garbage_kept():
        return to_flight(scan_closed(Path(path)), leave_out=leave_out)


@contextmanager
def _garbage_kept() -> Iterator[None]:
    """Pause the search for cyclic garbage: a log's messages are many objects without cycles."""
    searching = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if searching:
            gc.enable()


def scan_closed(path: Path) -> Scan:
    """Return all records of a closed log. Raises LogError, with the remedy, for a cut or foreign log."""
    source = find_damaged(path)
    records = scan(source)
    if records.is_foreign:
        raise foreign_log(records.path, NOT_OURS)
    if not records.whole:
        check_not_written(source)
        raise LogError(
            f"{records.path}: ends early or is damaged ({records.damage}); "
            f"run `trimtab log recover {records.path}`"
        )
    if PROVENANCE not in records.metadata or VEHICLE_FILE not in records.attachments:
        raise foreign_log(records.path, NOT_OURS)
    return records


def to_flight(records: Scan, *, leave_out: Collection[str] = ()) -> Flight:
    """Return the arrays of a closed log's records, without the topics in `leave_out`.

    Raises LogError if they contradict each other.
    """
    try:
        return _to_flight(records, leave_out)
    except (DecodeError, ValueError, KeyError, ConfigurationError) as error:
        text = " ".join(str(error).split())
        raise LogError(
            f"{records.path}: damaged ({text}); copy the log again from the machine that flew it"
        ) from error


def _to_flight(records: Scan, leave_out: Collection[str]) -> Flight:
    metadata = records.metadata[PROVENANCE]
    attached = {name: data for name, (_, data) in records.attachments.items()}
    vehicle = parse_vehicle(attached[VEHICLE_FILE].decode(), f"{records.path}:{VEHICLE_FILE}")
    _check_ids(attached, metadata, vehicle.id)
    entries = {topic: rows for topic, rows in records.by_topic().items() if topic not in leave_out}
    link = read_link(entries)
    arm_us = int(metadata.get("arm_host_us", "0"))
    vehicle_shift_us = arm_us + (round(float(link.clock_offset_us[-1])) if link is not None else 0)
    camera_shift_us = arm_us + (round(float(link.camera_offset_us[-1])) if link is not None else 0)
    timing = read_timing(entries)
    stepped = timing is not None and bool(timing.clock_steps[-1] > timing.clock_steps[0])
    statuses = decoded(entries, topics.FC_STATUS, flight_pb2.Status)
    status = read_status(statuses, vehicle_shift_us)
    reference, reference_id, began_us = _flown_reference(attached, metadata, statuses)
    host_control = read_host_control(entries, records.metadata.get(HOST_CONTROL), vehicle_shift_us)
    if host_control is not None and reference is not None:
        tracking, whole = _tracking_by_host(statuses, reference, vehicle_shift_us, host_control)
    elif AUTOPILOT in records.metadata and reference is not None:
        start_us = int(records.metadata[AUTOPILOT]["reference_start_us"])
        tracking, whole = _tracking_by_setpoints(entries, reference, start_us)
    else:
        tracking, whole = _tracking(statuses, reference, vehicle_shift_us, began_us)
    if tracking is None and "tracking_us" in metadata:
        start_us, end_us = metadata["tracking_us"].split()
        tracking, whole = (int(start_us), int(end_us)), True
    feedforward = attached.get(FEEDFORWARD_FILE)
    parameters = records.metadata.get(PARAMETERS)
    times = [entry.log_time_us for entry in records.messages]
    return Flight(
        id=records.id,
        path=records.path,
        kind=metadata["kind"],
        vehicle=vehicle,
        reference=reference,
        reference_id=reference_id,
        feedforward=None if feedforward is None else FeedForward.from_bytes(feedforward),
        firmware_parameters=None if parameters is None else {k: float(v) for k, v in parameters.items()},
        metadata=metadata,
        mocap=read_mocap(entries, camera_shift_us, vehicle_shift_us, stepped=stepped),
        estimate=read_estimate(entries, vehicle_shift_us),
        control=read_control(entries, vehicle_shift_us),
        observer=read_observer(entries, vehicle_shift_us),
        status=status,
        link=link,
        recorded_inputs=read_inputs(entries, metadata),
        recorded_imu=read_imu(entries),
        battery=read_battery(entries, status),
        tracking=tracking,
        tracking_whole=whole,
        unused=_unused(metadata),
        rebuilt=rebuilt_of(metadata),
        failsafe=failsafe_name(max((message.failsafe for _, message in statuses), default=0)),
        duration_s=(max(times) - min(times)) * 1e-6 if times else 0.0,
        contents=LogContents.of(records),
        host_control=host_control,
        rotors=read_rotors(entries, vehicle_shift_us),
        timing=timing,
    )


def _unused(metadata: Mapping[str, str]) -> tuple[tuple[int, int], ...]:
    """Return the parts of an import's tracking phase that are not used, us."""
    edges = [int(edge) for edge in metadata.get(UNUSED, "").split()]
    return tuple(zip(edges[::2], edges[1::2], strict=True))


def _check_ids(attached: Mapping[str, bytes], metadata: Mapping[str, str], vehicle_id: str) -> None:
    """Raise ValueError for an attachment whose id is not the one in the metadata."""
    for file, key in (
        (REFERENCE_FILE, "reference_id"),
        (FEEDFORWARD_FILE, "feedforward_id"),
        (THEN_FILE, "then_id"),
    ):
        blob = attached.get(file)
        if blob is not None and blob_id(blob) != metadata.get(key):
            raise ValueError(f"the attached blob is not {key} {metadata.get(key)}")
    if vehicle_id != metadata["vehicle_id"]:
        raise ValueError(f"the attached vehicle is {vehicle_id}, not {metadata['vehicle_id']}")


def _flown_reference(
    attached: Mapping[str, bytes], metadata: Mapping[str, str], statuses: Sequence[tuple[Entry, Any]]
) -> tuple[Reference | None, str | None, int | None]:
    """Return the reference that was flown, its id, and its time 0 if a second one took over in flight.

    The time is on the vehicle's clock, us. After a swap the reference is composed of both.
    """
    first, second = attached.get(REFERENCE_FILE), attached.get(THEN_FILE)
    if first is None:
        return None, metadata.get("reference_id"), None
    reference = Reference.from_bytes(first)
    if second is not None:
        then = Reference.from_bytes(second)
        swapped = swap_us([message for _, message in statuses], then)
        if swapped is not None:
            reference = composed(reference, then, swapped[1] - swapped[0])
            return reference, reference.id, swapped[0]
    return reference, metadata.get("reference_id"), None


def _tracking(
    pairs: Sequence[tuple[Entry, Any]],
    reference: Reference | None,
    shift_us: int,
    began_us: int | None,
) -> tuple[tuple[int, int] | None, bool]:
    """Return start and end of the tracking phase, and whether the reference was flown to its end.

    The phase starts at the reference's time 0, as the vehicle reports it, or at `began_us` (vehicle's clock)
    after a swap. It ends with the reference. If the vehicle left the phase early, or the log ends, it
    ends with the last status in TRACKING.
    """
    in_tracking = [message for _, message in pairs if message.state == State.TRACKING]
    starts = [message.tracking_start_us for _, message in pairs if message.tracking_start_us]
    if not starts or not (in_tracking or reference is not None):
        return None, False
    zero_us = starts[-1] if began_us is None else began_us
    start_us = zero_us - shift_us
    passed = [m.source_us for _, m in pairs if m.state > State.TRACKING and m.source_us > zero_us]
    if reference is not None:
        end_us = start_us + reference.duration_us
        if passed and min(passed) - shift_us >= end_us:
            return (start_us, end_us), True
    if not in_tracking:
        return None, False
    end_us = max(message.source_us for message in in_tracking) - shift_us
    return ((start_us, end_us), False) if end_us > start_us else (None, False)


def _tracking_by_host(
    pairs: Sequence[tuple[Entry, Any]], reference: Reference, shift_us: int, steps: HostControl
) -> tuple[tuple[int, int] | None, bool]:
    """Return the tracking phase of a flight by a controller on the host, and whether it was whole.

    The phase starts with the reference. It ends with the reference, with the last command, or when the
    vehicle leaves OFFBOARD, whichever comes first.
    """
    start_us, end_us = steps.start_us, steps.start_us + reference.duration_us
    if not steps.commanded.any():
        return None, False
    ends = [int(steps.act_us[steps.commanded].max())]
    statuses = [(message.source_us - shift_us, message.state) for _, message in pairs]
    began_us = int(steps.t_us[0])
    ends += [t_us for t_us, state in statuses if t_us > began_us and state != State.OFFBOARD][:1]
    last_us = min(ends)
    if last_us >= end_us:
        return (start_us, end_us), True
    return ((start_us, last_us), False) if last_us > start_us else (None, False)


def _tracking_by_setpoints(
    entries: Mapping[str, Sequence[Entry]], reference: Reference, start_us: int
) -> tuple[tuple[int, int] | None, bool]:
    """Return the tracking phase of a flight by streamed setpoints, and whether it was whole.

    It lasts from the start of the reference to its end, or to the last setpoint of it that was sent.
    """
    rows = decoded(entries, topics.REFERENCE, flight_pb2.Reference)
    last_us = max((message.reference_us for _, message in rows), default=0)
    end_us = min(last_us, reference.duration_us)
    return ((start_us, start_us + end_us), last_us >= reference.duration_us) if end_us else (None, False)
