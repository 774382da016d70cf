"""Writer of a recording as a Trimtab flight log."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

import numpy as np

from trimtab.host.base.parts import PartFile
from trimtab.host.imports.airborne import airborne
from trimtab.host.imports.plausible import consistent_parts
from trimtab.host.imports.recording import Cut, Recording, corner_of
from trimtab.host.log import Battery, Mocap, RecordedImu, RecordedInputs, write_imported
from trimtab.host.vehicle import ConfigurationError, Vehicle

DECLARED_MASS_SIGMA = 0.005
"""Relative standard deviation of a mass that a recording declares.

The vehicle was not weighed for this flight, so mass remains an alias of thrust.
"""


def write(
    recording: Recording,
    vehicle: Vehicle,
    output: Path | PartFile,
    *,
    format: str,
    provenance: Mapping[str, str] | None = None,
) -> tuple[dict[str, int], tuple[Cut, ...]]:
    """Write the log to `output`; return its number of messages by topic, and what was cut from its flights.

    The tracking phase is the time in the air, with the landings between several flights left out. The vehicle
    gets the mass that the recording declares. `provenance` holds further entries for the log. Raises
    ImportFormatError if the recording is never airborne or inconsistent, and ConfigurationError if the
    vehicle cannot be the recorded one.
    """
    r = recording
    parts_us, cut = consistent_parts(r, airborne(r))
    origin = {"source_format": format, "source_file": r.source, "unknown": " ".join(r.unknown)}
    if r.rebuilt is not None:
        origin |= r.rebuilt.metadata()
    if r.epoch_us is not None:
        origin["epoch_us"] = str(r.epoch_us)
    counts = write_imported(
        output,
        vehicle=_as_declared(vehicle, r),
        mocap=Mocap(t_us=r.pose_us, t_arrival_us=r.pose_us, p=r.p_ned, q=r.q_ned_frd),
        inputs=_inputs(r, vehicle),
        imu=None
        if r.imu_us is None
        else RecordedImu(t_us=r.imu_us, gyro=r.gyro, specific_force=r.specific_force),
        battery=None
        if r.battery_us is None or r.battery_v is None
        else Battery(t_us=r.battery_us, battery_v=r.battery_v),
        tracking_us=(parts_us[0][0], parts_us[-1][1]),
        unused_us=[(a[1], b[0]) for a, b in pairwise(parts_us)],
        session={**origin, **(provenance or {})},
    )
    return counts, (*r.cut, *cut)


def _as_declared(vehicle: Vehicle, r: Recording) -> Vehicle:
    """Return the vehicle with the mass that the recording declares, and with the tolerance of that mass."""
    if r.mass_kg is None:
        return vehicle
    sigma = min(DECLARED_MASS_SIGMA, vehicle.tolerance("mass", "factor", DECLARED_MASS_SIGMA))
    try:
        return vehicle.replace(mass_kg=r.mass_kg, tolerances={**vehicle.tolerances, "mass.factor": sigma})
    except ConfigurationError as error:
        problems = [f"{r.source} declares {r.mass_kg:g} kg: {problem}" for problem in error.problems]
        raise ConfigurationError(problems) from None


def _inputs(r: Recording, vehicle: Vehicle) -> RecordedInputs | None:
    """Return the inputs of the highest recorded level, motors in the vehicle's order; None without any."""
    t_us = r.input_us if r.input_us is not None else r.reference_us
    if t_us is None:
        return None
    reference = (r.p_ref_ned, r.v_ref_ned, r.a_ref_ned)
    if r.reference_us is None or not np.array_equal(r.reference_us, t_us):
        reference = (None, None, None)
    motor, torque = r.motor_command, r.torque_n_m
    if motor is not None:
        motor = np.clip(motor[:, _rotor_order(r, vehicle)], 0.0, 1.0)
    if r.thrust_n is not None and torque is None:
        torque = np.zeros((len(t_us), 3))  # listed as unknown, so nothing uses it
    level = "motor" if motor is not None else "thrust-torque" if r.thrust_n is not None else "reference"
    p_ref, v_ref, a_ref = reference
    return RecordedInputs(
        t_us=t_us,
        level=level,
        motor=motor,
        thrust_n=r.thrust_n,
        torque_n_m=torque,
        p_ref=p_ref,
        v_ref=v_ref,
        a_ref=a_ref,
    )


def _rotor_order(r: Recording, vehicle: Vehicle) -> list[int]:
    """Return the index of the recorded motor for each rotor of the vehicle file."""
    if r.motor_corners is None:
        return [0, 1, 2, 3]
    placed = [corner_of(*rotor.position_m[:2]) for rotor in vehicle.rotors]
    if sorted(placed) != sorted(r.motor_corners):
        raise ConfigurationError(
            [
                f"{vehicle.name}: its rotors are not at the corners as in {r.source}; "
                "give the recorded vehicle with --vehicle"
            ]
        )
    return [r.motor_corners.index(corner) for corner in placed]
