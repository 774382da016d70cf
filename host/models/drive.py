"""The inputs of phi: the rows of each drive, and the constants of a flight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np

from trimtab.firmware_model.law.dfbc import FlatState
from trimtab.firmware_model.law.feedforward import ATTITUDE_OFFSET, NEUTRAL, PREDICTION_TIME

Scalar = Any
Drive = Literal["reference", "estimate", "inputs"]

DRIVE_ROWS: Mapping[Drive, int] = {"reference": 23, "estimate": 35, "inputs": 6}
"""Rows of each drive.

reference: flat outputs 14, acceleration fed forward 3 and its derivative 3, gain (actual over nominal
rotor thrust), voltage ratio, time.
estimate: the same, then p, v, Theta and body rate as estimated on board.
inputs: commanded rotor thrusts 4 (N), voltage ratio, time.
"""
FF_ACCEL, FF_JERK, FF_GAIN = slice(14, 17), slice(17, 20), 20
VOLTAGE_AND_TIME = slice(21, 23)
ESTIMATED_P, ESTIMATED_V = slice(23, 26), slice(26, 29)
ESTIMATED_THETA, ESTIMATED_RATE = slice(29, 32), slice(32, 35)
COMMANDED_THRUST, INPUTS_VOLTAGE_AND_TIME = slice(0, 4), slice(4, 6)


def flat_reference(drive: Sequence[Scalar]) -> FlatState:
    """Return the flat outputs of a drive `reference` or `estimate` as the law takes them."""
    return FlatState(drive[0:3], drive[3:6], drive[6:9], drive[9:12], drive[12], drive[13])


class FlightConstants(NamedTuple):
    """Constants of one flight, which phi takes as one vector.

    attitude offsets (rad), prediction time: form (a) of the feed-forward. mocap_age_s: age of a pose when it
    is used. mocap_interval_s: time between poses. feedback_delay_s: further delay of the position and
    velocity that the law is fed. accelerometer_x, _y, _z: bias (m/s^2, FRD) as it appears against the poses;
    accelerometer_x_per_north and so on: how much smaller that is per m/s^2 of gravity towards north or east
    in the frame of the poses (`trimtab.host.models.bias`).
    """

    attitude_offset_roll: Scalar
    attitude_offset_pitch: Scalar
    prediction_time_s: Scalar
    mocap_age_s: Scalar
    mocap_interval_s: Scalar
    feedback_delay_s: Scalar
    accelerometer_x: Scalar
    accelerometer_y: Scalar
    accelerometer_z: Scalar
    accelerometer_x_per_north: Scalar
    accelerometer_x_per_east: Scalar
    accelerometer_y_per_north: Scalar
    accelerometer_y_per_east: Scalar
    accelerometer_z_per_north: Scalar
    accelerometer_z_per_east: Scalar

    @property
    def accelerometer_bias(self) -> Sequence[Scalar]:
        """(3,) bias, m/s^2 FRD."""
        return self[6:9]

    @property
    def bias_per_gravity(self) -> Sequence[Scalar]:
        """(6,) decrease of the bias per gravity towards north and east, axis by axis."""
        return self[9:15]


FLIGHT = FlightConstants._fields


def flight_constants(
    block: Sequence[float] | None = None,
    *,
    mocap_age_s: float = 0.0,
    mocap_interval_s: float = 0.0,
    feedback_delay_s: float = 0.0,
    accelerometer_bias: Sequence[float] | Annotated[np.ndarray, "3"] = (0.0, 0.0, 0.0),
    bias_per_gravity: Annotated[np.ndarray, "3 2"] | None = None,
) -> Annotated[np.ndarray, "15"]:
    """Return the constants of a flight, for `Phi`; `block` is form (a) of the feed-forward.

    By default gravity has no part in the bias.
    """
    values = NEUTRAL if block is None else block
    offset, prediction = values[ATTITUDE_OFFSET], values[PREDICTION_TIME]
    late = (mocap_age_s, mocap_interval_s, feedback_delay_s)
    share = np.zeros((3, 2)) if bias_per_gravity is None else bias_per_gravity
    return np.array([*offset, prediction, *late, *accelerometer_bias, *np.ravel(share)])
