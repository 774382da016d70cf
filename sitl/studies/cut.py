"""Reduced copies of flight logs, with only the data that foreign loggers record."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TypeVar

import numpy as np

from trimtab.firmware_model.law.allocation import allocation_matrix, thrust_to_command
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.host.log import (
    Battery,
    Control,
    Flight,
    LogWriter,
    Mocap,
    Provenance,
    RecordedImu,
    RecordedInputs,
    read_flight,
    topics,
    write_imported,
)
from trimtab.host.log.flight import scan_closed, to_flight
from trimtab.host.log.provenance import PROVENANCE
from trimtab.host.log.scan import Entry
from trimtab.host.vehicle import Vehicle

_Rows = TypeVar("_Rows", Battery, Control, Mocap)
_REWRITTEN = ("format", "kind", "time_unit", "vehicle_id", "vehicle_name", "reference_id", "feedforward_id")


def without_gyro(log: Path, target: Path) -> None:
    """Write poses, motor commands, specific force and battery voltage to `target`.

    A command holds for the interval after its time; it is the mean of the flight's commands over it.
    """
    flight = read_flight(log)
    if flight.control is None:
        shutil.copyfile(log, target)
        return
    c = _since_arming(flight.control, flight.control.t0_us)
    inputs = RecordedInputs(t_us=c.t0_us, level="motor", motor=c.motor_mean)
    _write(flight, target, inputs, RecordedImu(t_us=c.t0_us, gyro=None, specific_force=c.force_mean))


def sampled(log: Path, target: Path) -> None:
    """Write poses, gyro, specific force, battery voltage and sampled motor commands to `target`.

    The motor commands are samples at 100 Hz instead of means.
    """
    flight = read_flight(log)
    if flight.control is None:
        shutil.copyfile(log, target)
        return
    c = _since_arming(flight.control, flight.control.t0_us)
    motor = motor_commands(flight.vehicle, c)
    imu = RecordedImu(t_us=c.t0_us, gyro=c.gyro_mean, specific_force=c.force_mean)
    _write(flight, target, RecordedInputs(t_us=c.t1_us, level="motor", motor=motor), imu)


def without_reference(log: Path, target: Path) -> None:
    """Write the flight log to `target` without its reference and the parameters of the control law."""
    records = scan_closed(log)
    flight = to_flight(records)
    session = {key: v for key, v in records.metadata[PROVENANCE].items() if key not in _REWRITTEN}
    remaining = [
        topic
        for topic in topics.FLIGHT_TOPICS
        if topic.name != topics.REFERENCE and not topic.name.startswith(topics.DISPLAY_PREFIX)
    ]
    with LogWriter(target, Provenance(vehicle=flight.vehicle, session=session), remaining) as writer:
        rows: list[tuple[Entry, str]] = []
        for topic in remaining:
            rows += [(entry, topic.name) for entry in records.by_topic().get(topic.name, ())]
        messages = {topic.name: topic.message for topic in remaining}
        for entry, name in sorted(rows, key=lambda row: row[0].log_time_us):
            message = messages[name].FromString(entry.data)
            writer.write(name, message, entry.log_time_us, entry.publish_time_us)


def motor_commands(vehicle: Vehicle, control: Control) -> np.ndarray:
    """Return motor commands (n, 4) in 0..1 at the times t1_us, from the commanded thrust and torque."""
    rotors = vehicle.rotors
    matrix = allocation_matrix(
        [r.position_m for r in rotors], [r.spin_sign for r in rotors], vehicle.torque_per_thrust_m
    )
    demand = np.column_stack([control.collective, control.torque])
    thrust = demand @ np.linalg.inv(np.reshape(matrix, (4, 4))).T
    c1, c2 = vehicle.thrust_curve
    command = [thrust_to_command(FLOAT, t, vehicle.thrust_max_n, c1, c2) for t in thrust.ravel().tolist()]
    return np.reshape(command, thrust.shape)


def _since_arming(track: _Rows, t_us: np.ndarray) -> _Rows:
    """Return the rows of a track that begin, t_us (n,), after arming, because imports start at time 0."""
    return track.rows(t_us >= 0)


def _write(flight: Flight, target: Path, inputs: RecordedInputs, imu: RecordedImu) -> None:
    """Write a log of these inputs and sensors as an imported flight."""
    assert flight.mocap is not None
    battery = flight.battery
    write_imported(
        target,
        vehicle=flight.vehicle,
        mocap=_since_arming(flight.mocap, flight.mocap.t_us),
        inputs=inputs,
        imu=imu,
        battery=None if battery is None else _since_arming(battery, battery.t_us),
        tracking_us=flight.tracking,
    )
