"""A flight log as other tools would write it: a ULog, a DataFlash log or a ROS bag.

python tests/foreign_log.py LOG.mcap TARGET     TARGET: ends with .ulg, .bin or .bag; a folder for ROS 2
"""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.foreign import bag, dataflash, ulog
from trimtab.host.log import read_flight
from trimtab.host.vehicle import Vehicle

STEP_US = 10_000
FLIP = np.array([1.0, -1.0, -1.0])
"""From NED to north-west-up and from FRD to FLU."""


def clockwise(vehicle: Vehicle) -> list[int]:
    """The rotors of a quadrotor in X, clockwise from the front right."""
    at = [np.arctan2(rotor.position_m[1], rotor.position_m[0]) % (2 * np.pi) for rotor in vehicle.rotors]
    return np.argsort(at).tolist()


def flight_of(path: Path) -> SimpleNamespace:
    """Poses, motor commands and inertial measurements at common times, in NED and FRD."""
    flight = read_flight(path)
    control, mocap = flight.control, flight.mocap
    assert control is not None
    assert mocap is not None
    middle = 0.5 * (control.t0_us + control.t1_us)
    t_us = np.arange(max(mocap.t_us[0], middle[0]), min(mocap.t_us[-1], middle[-1]), STEP_US)

    def at(times: np.ndarray, values: np.ndarray) -> np.ndarray:
        return np.column_stack([np.interp(t_us, times, column) for column in values.T])

    return SimpleNamespace(
        t=(t_us - t_us[0]) * 1e-6,
        p=at(mocap.t_us, mocap.p),
        turn=Rotation.from_quat(at(mocap.t_us, mocap.q), scalar_first=True),
        gyro=at(middle, control.gyro_mean),
        force=at(middle, control.force_mean),
        # A row of commands acts until the next one.
        motor=at(middle - 0.5 * STEP_US, control.motor_mean)[:, clockwise(flight.vehicle)],
        volt=np.full(len(t_us), flight.vehicle.battery.full_v),
    )


def write(flight: SimpleNamespace, vehicle: Vehicle, target: Path) -> None:
    """Write the flight in the format that the target's name tells."""
    if target.suffix == ".ulg":
        target.write_bytes(ulog.ulog_bytes(ulog.topics_of(flight), {}))
    elif target.suffix == ".bin":
        target.write_bytes(dataflash.log_bytes(flight, {"FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0}))
    else:
        half = Rotation.from_rotvec([np.pi, 0.0, 0.0])
        turned = SimpleNamespace(
            t=flight.t,
            p=flight.p * FLIP,
            turn=half * flight.turn * half,
            gyro=flight.gyro * FLIP,
            force=flight.force * FLIP,
            motor=flight.motor[:, np.argsort(clockwise(vehicle))],
        )
        bag.write_bag(turned, target, "ros1" if target.suffix == ".bag" else "mcap")


if __name__ == "__main__":
    log = Path(sys.argv[1])
    write(flight_of(log), read_flight(log).vehicle, Path(sys.argv[2]))
