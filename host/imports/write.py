"""Writes a recording as a flight log of the project's own."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from host.imports.recording import ImportFormatError, Recording
from host.log import Battery, Mocap, RecordedImu, RecordedInputs, write_imported
from host.vehicle import Vehicle

AIRBORNE_M = 0.15
"""Height above the first poses from which a vehicle counts as clear of the ground."""

_EDGE_US = 500_000
_SHORTEST_US = 2_000_000


def write(recording: Recording, vehicle: Vehicle, path: Path, *, profile: str) -> dict[str, int]:
    """Messages by topic of the log written at `path`; its tracking phase is the time clear of the ground.

    The vehicle takes the mass that the recording declares. Raises ImportFormatError when it never flew.
    """
    r = recording
    if r.mass_kg is not None and r.mass_kg != vehicle.mass_kg:
        vehicle = vehicle.model_copy(update={"mass_kg": r.mass_kg})
    return write_imported(
        path,
        vehicle=vehicle,
        mocap=Mocap(t_us=r.pose_us, t_arrival_us=r.pose_us, p=r.p_ned, q=r.q_ned_frd),
        inputs=_inputs(r),
        imu=None
        if r.imu_us is None
        else RecordedImu(t_us=r.imu_us, gyro=r.gyro, specific_force=r.specific_force),
        battery=None
        if r.battery_us is None or r.battery_v is None
        else Battery(t_us=r.battery_us, battery_v=r.battery_v),
        tracking_us=airborne(r),
        session={"profile": profile, "source_file": r.source, "unknown": " ".join(r.unknown)},
    )


def airborne(recording: Recording) -> tuple[int, int]:
    """Begin and end in us of the longest time clear of the ground, half a second shorter at both ends."""
    height = np.median(recording.p_ned[:20, 2]) - recording.p_ned[:, 2]
    floor = height.min()
    up = height > floor + AIRBORNE_M
    edges = np.flatnonzero(np.diff(np.r_[False, up, False].astype(int)))
    spans = [
        (int(recording.pose_us[a]) + _EDGE_US, int(recording.pose_us[b - 1]) - _EDGE_US)
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]
    best = max(spans, key=lambda span: span[1] - span[0], default=(0, 0))
    if height.max() - floor < AIRBORNE_M:  # recorded in the air from first row to last
        best = (int(recording.pose_us[0]) + _EDGE_US, int(recording.pose_us[-1]) - _EDGE_US)
    if best[1] - best[0] < _SHORTEST_US:
        raise ImportFormatError(
            f"{recording.source}: less than {_SHORTEST_US / 1e6:g} s clear of the ground; "
            "import a longer flight"
        )
    return best


def _inputs(r: Recording) -> RecordedInputs | None:
    """The recorded inputs at the highest level there is; None without any."""
    if r.input_us is None and r.reference_us is None:
        return None
    t_us = r.input_us if r.input_us is not None else r.reference_us
    assert t_us is not None
    shared = r.reference_us is not None and np.array_equal(r.reference_us, t_us)
    torque = r.torque_n_m if r.torque_n_m is not None or r.thrust_n is None else np.zeros((len(t_us), 3))
    level = (
        "motor" if r.motor_command is not None else "thrust-torque" if r.thrust_n is not None else "reference"
    )
    return RecordedInputs(
        t_us=t_us,
        level=level,
        motor=r.motor_command,
        thrust_n=r.thrust_n,
        torque_n_m=torque,
        p_ref=r.p_ref_ned if shared else None,
        v_ref=r.v_ref_ned if shared else None,
    )
