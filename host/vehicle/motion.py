"""A recorded flight on one time grid: body rate, specific force, and the thrust that its commands ask for.

Tracks have their own times and rates. What was not measured comes from the poses. SI units, body FRD, world
NED, integer microseconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from trimtab.firmware_model.law.allocation import command_to_thrust
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.host.vehicle.model import Vehicle

GRID_US = 10_000
GRID_S = GRID_US * 1e-6
LEAST_US = 2_000_000
"""Least time in the air."""

TRIANGLE_S = 0.1
"""Half the width of the filter on forces: the second difference of positions has the same shape."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Tracks:
    """The tracks of a recording, each with its own increasing times. None: not recorded.

    Attributes
    ----------
    input_us
        Middle of the interval in which each row of inputs acts.
    motor_command
        In 0..1, in the order of the vehicle's rotors.
    thrust_n, torque_n_m
        Commanded collective thrust and, if known, torque (FRD), instead of motor commands.
    rate_us, rate_frd
        Body rate, rad/s. None: from the poses.
    force_us, specific_force_frd
        Specific force, m/s^2. None: from the poses.
    pose_us, p_ned, q_ned_frd
        Positions, m, and attitudes, w first.
    """

    input_us: Annotated[np.ndarray, "inputs"]
    motor_command: Annotated[np.ndarray, "inputs 4"] | None = None
    thrust_n: Annotated[np.ndarray, "inputs"] | None = None
    torque_n_m: Annotated[np.ndarray, "inputs 3"] | None = None
    rate_us: Annotated[np.ndarray, "rates"] | None = None
    rate_frd: Annotated[np.ndarray, "rates 3"] | None = None
    force_us: Annotated[np.ndarray, "forces"] | None = None
    specific_force_frd: Annotated[np.ndarray, "forces 3"] | None = None
    pose_us: Annotated[np.ndarray, "poses"] | None = None
    p_ned: Annotated[np.ndarray, "poses 3"] | None = None
    q_ned_frd: Annotated[np.ndarray, "poses 4"] | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """A flight on a grid of GRID_US.

    Attributes
    ----------
    t_us
        Times.
    rate_frd, specific_force_frd
        Body rate (rad/s) and specific force (m/s^2), measured or derived from poses.
    rotor_thrust_n
        Thrust of each rotor that the commands ask for, behind the motor lag; None without motor commands.
    collective_n
        Sum of the rotors' thrusts, behind the motor lag.
    torque_n_m
        Commanded torque, behind the motor lag; None if motors were recorded, or if it is not known.
    input_s
        Median interval between inputs.
    """

    t_us: Annotated[np.ndarray, "samples"]
    rate_frd: Annotated[np.ndarray, "samples 3"]
    specific_force_frd: Annotated[np.ndarray, "samples 3"]
    collective_n: Annotated[np.ndarray, "samples"]
    rotor_thrust_n: Annotated[np.ndarray, "samples 4"] | None
    torque_n_m: Annotated[np.ndarray, "samples 3"] | None
    input_s: float


def motion(tracks: Tracks, vehicle: Vehicle, span_us: tuple[int, int]) -> Motion | None:
    """Return the flight between two times on one grid; None if less than two seconds have all that is needed.

    The vehicle's thrust curve and motor lag apply to the commands.
    """
    needed = [tracks.input_us]
    for times in (tracks.rate_us, tracks.force_us):
        if times is not None:
            needed.append(times)
        elif tracks.pose_us is not None:
            needed.append(tracks.pose_us)
        else:
            return None
    if min(map(len, needed)) < 2:
        return None
    begin = max(span_us[0], *(int(times[0]) for times in needed))
    end = min(span_us[1], *(int(times[-1]) for times in needed))
    t_us = np.arange(begin, end + 1, GRID_US)
    if len(t_us) < LEAST_US // GRID_US:
        return None

    def behind_lag(values: np.ndarray) -> np.ndarray:
        return lagged(_at(t_us, tracks.input_us, values), vehicle.motor_lag_s)

    rotors, torque = None, None
    if tracks.motor_command is not None:
        thrust_n = command_to_thrust(tracks.motor_command, vehicle.thrust_max_n, *vehicle.thrust_curve)
        rotors = behind_lag(thrust_n)
        collective = rotors.sum(axis=1)
    elif tracks.thrust_n is not None:
        collective = behind_lag(tracks.thrust_n[:, None])[:, 0]
        torque = None if tracks.torque_n_m is None else behind_lag(tracks.torque_n_m)
    else:
        return None
    return Motion(
        t_us=t_us,
        rate_frd=_rate(tracks, t_us),
        specific_force_frd=_force(tracks, t_us),
        collective_n=collective,
        rotor_thrust_n=rotors,
        torque_n_m=torque,
        input_s=float(np.median(np.diff(tracks.input_us))) * 1e-6,
    )


def lagged(
    values: Annotated[np.ndarray, "samples k"], lag_s: float, step_s: float = GRID_S
) -> Annotated[np.ndarray, "samples k"]:
    """Return values on a grid behind a first-order lag that starts settled."""
    keep = np.exp(-step_s / lag_s)
    out = np.empty_like(values, dtype=float)
    state = values[0].astype(float)
    for i, value in enumerate(values):
        state = value + (state - value) * keep
        out[i] = state
    return out


def _at(t_us: np.ndarray, times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the columns of `values` interpolated at times."""
    return np.column_stack([np.interp(t_us, times, values[:, k]) for k in range(values.shape[1])])


def _attitude(tracks: Tracks, t_us: np.ndarray) -> Rotation:
    assert tracks.pose_us is not None
    slerp = Slerp(tracks.pose_us, Rotation.from_quat(tracks.q_ned_frd, scalar_first=True))
    return slerp(np.clip(t_us, tracks.pose_us[0], tracks.pose_us[-1]))


def _rate(tracks: Tracks, t_us: np.ndarray) -> np.ndarray:
    """Return the body rate, from the change of the attitude over two steps of the grid if not measured."""
    if tracks.rate_us is not None and tracks.rate_frd is not None:
        return _at(t_us, tracks.rate_us, tracks.rate_frd)
    before, after = (_attitude(tracks, t_us + shift) for shift in (-GRID_US, GRID_US))
    return (before.inv() * after).as_rotvec() / (2.0 * GRID_S)


def _force(tracks: Tracks, t_us: np.ndarray) -> np.ndarray:
    """Return the specific force, from the second difference of the positions if not measured."""
    if tracks.force_us is not None and tracks.specific_force_frd is not None:
        return _at(t_us, tracks.force_us, tracks.specific_force_frd)
    assert tracks.pose_us is not None
    assert tracks.p_ned is not None
    step_us = round(TRIANGLE_S * 1e6)
    before, now, after = (_at(t_us + shift, tracks.pose_us, tracks.p_ned) for shift in (-step_us, 0, step_us))
    a_ned = (before - 2.0 * now + after) / TRIANGLE_S**2
    return _attitude(tracks, t_us).inv().apply(a_ned - np.array([0.0, 0.0, GRAVITY]))
