"""Writer for logs of imported flights, from arrays."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.host.base.parts import PartFile
from trimtab.host.log import topics
from trimtab.host.log.display import PERIOD_US
from trimtab.host.log.provenance import UNUSED, Provenance
from trimtab.host.log.tracks import Battery, Mocap, RecordedImu, RecordedInputs
from trimtab.host.log.writer import LogWriter
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.generated import flight_pb2

_Row = tuple[int, int, str, Any]
"""Log time, publish time (us), topic and message."""


def write_imported(  # noqa: PLR0913 (one keyword for each topic)
    output: Path | PartFile,
    *,
    vehicle: Vehicle,
    mocap: Mocap,
    inputs: RecordedInputs | None = None,
    imu: RecordedImu | None = None,
    battery: Battery | None = None,
    tracking_us: tuple[int, int] | None = None,
    unused_us: Sequence[tuple[int, int]] = (),
    session: Mapping[str, str] | None = None,
) -> dict[str, int]:
    """Write the log to `output`; return the number of messages of each topic.

    All times are non-negative us from the flight's first sample, on one clock. `tracking_us` is the interval
    that learning and tracing use; by default it spans all poses. `unused_us` holds the parts of it, in
    order, that are not used: the time on the ground between two flights. `session` is the origin of the data,
    for the log's provenance.
    """
    start_us, end_us = tracking_us or (int(mocap.t_us[0]), int(mocap.t_us[-1]))
    if not 0 <= start_us < end_us:
        raise ValueError(f"tracking from {start_us} to {end_us} us is not an interval after the first sample")
    first_us = min(int(track.t_us[0]) for track in (mocap, inputs, imu, battery) if track is not None)
    if first_us < 0:
        raise ValueError(f"a sample lies {-first_us} us before the start; shift the times")
    metadata = {**(session or {}), "tracking_us": f"{start_us} {end_us}"}
    edges_us = [start_us, *(edge for part in unused_us for edge in part), end_us]
    if any(a >= b for a, b in pairwise(edges_us)):
        raise ValueError(f"{unused_us} are not parts, in order, of tracking from {start_us} to {end_us} us")
    if unused_us:
        metadata[UNUSED] = " ".join(str(edge) for edge in edges_us[1:-1])
    if inputs is not None:
        metadata["input_level"] = inputs.level
    rows = [*_poses(mocap), *_inputs(inputs), *_imu(imu), *_battery(battery)]
    provenance = Provenance(vehicle=vehicle, kind="imported", session=metadata)
    with LogWriter(output, provenance, topics.IMPORTED_TOPICS) as writer:
        if inputs is not None and inputs.p_ref is not None:
            writer.display.reference_path(0, inputs.p_ref[_every(PERIOD_US, inputs.t_us)].tolist())
        for log_us, publish_us, topic, message in sorted(rows, key=lambda row: row[0]):
            writer.write(topic, message, log_us, publish_us)
            if topic == topics.MOCAP_POSE:
                writer.display.pose(log_us, publish_us, message.p_ned_m, message.q_ned_frd)
    return writer.counts()


def _every(period_us: int, t_us: np.ndarray) -> np.ndarray:
    """Return the index of the first sample in each period."""
    return np.unique(t_us // period_us, return_index=True)[1]


def _poses(mocap: Mocap) -> Iterator[_Row]:
    arrivals = zip(mocap.t_us.tolist(), mocap.t_arrival_us.tolist(), strict=True)
    for k, (t_us, arrival_us) in enumerate(arrivals):
        pose = flight_pb2.MocapPose(source_us=t_us, p_ned_m=mocap.p[k], q_ned_frd=mocap.q[k])
        yield arrival_us, t_us, topics.MOCAP_POSE, pose


def _inputs(inputs: RecordedInputs | None) -> Iterator[_Row]:
    if inputs is not None:
        yield from _rows(
            topics.RECORDED_INPUTS,
            flight_pb2.RecordedInputs,
            inputs.t_us,
            motor_command=inputs.motor,
            thrust_n=inputs.thrust_n,
            torque_n_m=inputs.torque_n_m,
            p_ref_ned_m=inputs.p_ref,
            v_ref_ned_m_s=inputs.v_ref,
            a_ref_ned_m_s2=inputs.a_ref,
            yaw_ref_rad=inputs.yaw_ref,
        )


def _imu(imu: RecordedImu | None) -> Iterator[_Row]:
    if imu is not None:
        yield from _rows(
            topics.RECORDED_IMU,
            flight_pb2.RecordedImu,
            imu.t_us,
            gyro_rad_s=imu.gyro,
            specific_force_m_s2=imu.specific_force,
        )


def _battery(battery: Battery | None) -> Iterator[_Row]:
    if battery is not None:
        for t_us, volt in zip(battery.t_us.tolist(), battery.battery_v.tolist(), strict=True):
            message = flight_pb2.RecordedBattery(source_us=t_us, battery_v=volt)
            yield t_us, t_us, topics.RECORDED_BATTERY, message


def _rows(topic: str, kind: Any, t_us: np.ndarray, **fields: np.ndarray | None) -> Iterator[_Row]:
    """Yield one message for each row, with every field that is not None."""
    columns = {
        name: values.reshape(len(t_us), -1).tolist() for name, values in fields.items() if values is not None
    }
    for k, stamp_us in enumerate(t_us.tolist()):
        message = kind(source_us=stamp_us, **{name: rows[k] for name, rows in columns.items()})
        yield stamp_us, stamp_us, topic, message
