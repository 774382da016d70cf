"""How well a vehicle file fits a recorded flight: thrust against weight, torque against angular acceleration.

All functions take plain arrays in SI units, body FRD, world NED, times in integer microseconds, so that an
import can call them before a flight log exists. `motion` brings the tracks of a recording to one time grid,
`thrust_figures` and `torque_figures` compare it with a vehicle. Nothing here decides: see `check`.

Torque. J w' + w x J w = B T, where T are the rotors' thrusts behind `motor_lag_s` and B is the allocation
matrix of the file. A controller answers a slow disturbance with the opposite torque, so a plain regression of
one on the other finds too little or nothing. Both sides are therefore means over BLOCK_S whose differences
are compared: within that time, no controller has answered yet.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from trimtab.firmware_model.law.allocation import allocation_matrix, command_to_thrust
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.host.vehicle.model import Vehicle

GRID_US = 10_000
BLOCK_S = 0.04
"""Length of the means that torque and angular acceleration are compared in."""

SLOWEST_INPUT_S = 0.05
"""Interval between inputs above which nothing can be said about torque."""

LEAST_US = 2_000_000
"""Least time in the air."""

_GRID_S = GRID_US * 1e-6
_TRIANGLE_S = 0.1
"""Half the width of the filter on forces: the second difference of positions has the same shape."""

_SEGMENTS = 10
"""Parts of a flight whose scatter gives a standard deviation."""

_STEADY_RATE, _STEADY_THRUST = 1.5, 0.3
"""Body rate, rad/s, and relative distance of the thrust from its median, up to which flight is steady."""

_YAW_TRIM = 0.05
"""One sigma of the difference of the thrusts of both directions of rotation over their sum, in the mean."""

_RANK_LEAST = 1e-3
"""Least singular value, over the greatest, of an allocation that can turn the vehicle about all axes."""


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


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A number and its standard deviation from the scatter within the flight."""

    value: float
    sd: float


@dataclass(frozen=True, kw_only=True)
class ThrustFigures:
    """Thrust of the flight over that of the vehicle file.

    Attributes
    ----------
    scale
        Mass times specific force along the thrust, over the commanded thrust, in steady flight.
    slope
        Change of that force with a change of the commanded thrust, over `scale`: 1 unless the command has an
        offset. None if the thrust hardly changes.
    force_xyz
        Mean specific force over gravity, FRD: [0, 0, -1] in steady flight.
    steady_s
        Time of steady flight.
    """

    scale: Estimate
    slope: Estimate | None
    force_xyz: tuple[float, float, float]
    steady_s: float


@dataclass(frozen=True, kw_only=True)
class TorqueFigures:
    """Angular acceleration of the flight against the torque of the vehicle file.

    Attributes
    ----------
    gain
        Measured over expected angular acceleration for each axis, with `order` and `spins`; None for an axis
        that hardly turned.
    order
        For each rotor of the file, the index of the motor command that drives it, as the flight shows it.
    order_margin
        Log-likelihood by which `order` is better than the file's own order; 0 if they are the same.
    order_lead
        Log-likelihood by which `order` is better than the next.
    spins
        Sign of each rotor's reaction torque about +z_frd, as the flight shows it.
    spins_margin, spins_lead
        The same for the spins.
    """

    gain: tuple[Estimate | None, Estimate | None, Estimate | None]
    order: tuple[int, ...] | None = None
    order_margin: float = 0.0
    order_lead: float = 0.0
    spins: tuple[int, ...] | None = None
    spins_margin: float = 0.0
    spins_lead: float = 0.0


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
    values: Annotated[np.ndarray, "samples k"], lag_s: float, step_s: float = _GRID_S
) -> Annotated[np.ndarray, "samples k"]:
    """Return values on a grid behind a first-order lag that starts settled."""
    keep = np.exp(-step_s / lag_s)
    out = np.empty_like(values, dtype=float)
    state = values[0].astype(float)
    for i, value in enumerate(values):
        state = value + (state - value) * keep
        out[i] = state
    return out


def thrust_figures(flight: Motion, mass_kg: float) -> ThrustFigures | None:
    """Return thrust against weight, or None if less than a second of the flight is steady."""
    force = _triangle(flight.specific_force_frd)
    thrust_n = _triangle(flight.collective_n[:, None])[:, 0]
    rate = _triangle(np.abs(flight.rate_frd)).max(axis=1)
    middle = float(np.median(thrust_n))
    steady = (rate < _STEADY_RATE) & (np.abs(thrust_n - middle) < _STEADY_THRUST * abs(middle))
    if steady.sum() * _GRID_S < 1.0 or middle <= 0.0:
        return None
    up_n = -mass_kg * force[:, 2]
    scale = _slope(thrust_n[steady], up_n[steady])
    slope = None
    if np.std(thrust_n) > 0.02 * middle and scale.value > 0.0:
        free = _slope(thrust_n - thrust_n.mean(), up_n - up_n.mean())
        slope = Estimate(value=free.value / scale.value, sd=free.sd / scale.value)
    x, y, z = (float(value) for value in force[steady].mean(axis=0) / GRAVITY)
    return ThrustFigures(
        scale=scale, slope=slope, force_xyz=(x, y, z), steady_s=float(steady.sum()) * _GRID_S
    )


def torque_figures(flight: Motion, vehicle: Vehicle) -> TorqueFigures | None:
    """Return torque against angular acceleration; None if inputs are too slow or torque is not known.

    With motor commands, every order of the four motors and every combination of spins that can turn the
    vehicle is compared by its likelihood. Roll and pitch determine the order, yaw the spins: those whose
    torques cancel in the mean and explain the angular acceleration.
    """
    if flight.input_s > SLOWEST_INPUT_S:
        return None
    inertia = np.array(vehicle.inertia_kg_m2)
    turning, rate = _blocks(flight.rate_frd)
    lift = np.diff(_between(flight.collective_n[:, None]), axis=0)
    measured = _without(np.diff(turning + np.cross(rate, rate * inertia) / inertia, axis=0), lift)
    if flight.rotor_thrust_n is None:
        if flight.torque_n_m is None:
            return None
        expected = _without(np.diff(_between(flight.torque_n_m), axis=0), lift) / inertia
        return TorqueFigures(gain=_gains(expected, measured))
    thrust = _without(np.diff(_between(flight.rotor_thrust_n), axis=0), lift)
    order, order_margin, order_lead = _most_likely_order(thrust, measured, vehicle)
    thrust, mean = thrust[:, order], flight.rotor_thrust_n[:, order].mean(axis=0)
    spins, spins_margin, spins_lead = _most_likely_spins(thrust, mean, measured[:, 2], vehicle)
    yaw = vehicle.torque_per_thrust_m / inertia[2] * np.array(spins)
    return TorqueFigures(
        gain=_gains(thrust @ np.vstack([_levers(vehicle), yaw]).T, measured),
        order=order,
        order_margin=order_margin,
        order_lead=order_lead,
        spins=spins,
        spins_margin=spins_margin,
        spins_lead=spins_lead,
    )


def _levers(vehicle: Vehicle) -> np.ndarray:
    """Return the angular acceleration about roll and pitch (2, 4) for a newton of each rotor."""
    arms = np.array([rotor.position_m for rotor in vehicle.rotors])
    return np.stack([-arms[:, 1], arms[:, 0]]) / np.array(vehicle.inertia_kg_m2)[:2, None]


def _most_likely_order(
    thrust: np.ndarray, measured: np.ndarray, vehicle: Vehicle
) -> tuple[tuple[int, ...], float, float]:
    """Return the order of the commands that explains roll and pitch best, its margin and its lead."""
    orders = list(itertools.permutations(range(4)))
    levers = _levers(vehicle)
    likelihood = [
        sum(_likelihood(thrust[:, order] @ levers[k], measured[:, k]) for k in range(2)) for order in orders
    ]
    best, margin, lead = _best(np.array(likelihood), orders.index((0, 1, 2, 3)))
    return orders[best], margin, lead


def _most_likely_spins(
    thrust: np.ndarray, mean: np.ndarray, measured: np.ndarray, vehicle: Vehicle
) -> tuple[tuple[int, ...], float, float]:
    """Return the signs that cancel in the mean and explain yaw best, their margin and their lead."""
    signs: list[tuple[int, ...]] = [
        each for each in itertools.product((1, -1), repeat=4) if _turns_all(vehicle, each)
    ]
    own = signs.index(tuple(rotor.spin_sign for rotor in vehicle.rotors))
    likelihood = [
        _likelihood(thrust @ np.array(each), measured)
        - 0.5 * (float(mean @ np.array(each)) / (_YAW_TRIM * float(mean.sum()))) ** 2
        for each in signs
    ]
    best, margin, lead = _best(np.array(likelihood), own)
    return signs[best], margin, lead


def _turns_all(vehicle: Vehicle, spins: Sequence[int]) -> bool:
    """Return whether rotors at the file's positions with these spins can turn the vehicle about all axes."""
    positions = [rotor.position_m for rotor in vehicle.rotors]
    matrix = np.array(allocation_matrix(positions, spins, 1.0)).reshape(4, 4)
    sizes = np.linalg.svd(matrix / np.abs(matrix).max(axis=1, keepdims=True), compute_uv=False)
    return bool(sizes[-1] > _RANK_LEAST * sizes[0])


def _gains(
    expected: np.ndarray, measured: np.ndarray
) -> tuple[Estimate | None, Estimate | None, Estimate | None]:
    """Return measured over expected angular acceleration of each axis, None where none was expected."""
    roll, pitch, yaw = (
        _slope(x, y) if float(x @ x) > 0.0 else None for x, y in zip(expected.T, measured.T, strict=True)
    )
    return roll, pitch, yaw


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
    return (before.inv() * after).as_rotvec() / (2.0 * _GRID_S)


def _force(tracks: Tracks, t_us: np.ndarray) -> np.ndarray:
    """Return the specific force, from the second difference of the positions if not measured."""
    if tracks.force_us is not None and tracks.specific_force_frd is not None:
        return _at(t_us, tracks.force_us, tracks.specific_force_frd)
    assert tracks.pose_us is not None
    assert tracks.p_ned is not None
    step_us = round(_TRIANGLE_S * 1e6)
    before, now, after = (_at(t_us + shift, tracks.pose_us, tracks.p_ned) for shift in (-step_us, 0, step_us))
    a_ned = (before - 2.0 * now + after) / _TRIANGLE_S**2
    return _attitude(tracks, t_us).inv().apply(a_ned - np.array([0.0, 0.0, GRAVITY]))


def _triangle(values: np.ndarray) -> np.ndarray:
    """Return columns filtered with a triangle, without the ends that it does not cover."""
    half = round(_TRIANGLE_S / _GRID_S)
    kernel = np.bartlett(2 * half + 1)
    kernel /= kernel.sum()
    columns = [np.convolve(values[:, k], kernel, mode="valid") for k in range(values.shape[1])]
    return np.column_stack(columns)


def _means(values: np.ndarray) -> np.ndarray:
    """Return the means of columns over consecutive blocks."""
    size = round(BLOCK_S / _GRID_S)
    whole = len(values) // size * size
    return values[:whole].reshape(-1, size, values.shape[1]).mean(axis=1)


def _between(values: np.ndarray) -> np.ndarray:
    """Return the mean around each boundary of two blocks."""
    means = _means(values)
    return 0.5 * (means[1:] + means[:-1])


def _blocks(rate_frd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return angular acceleration and body rate around each boundary of two blocks."""
    means = _means(rate_frd)
    return np.diff(means, axis=0) / BLOCK_S, 0.5 * (means[1:] + means[:-1])


def _slope(x: np.ndarray, y: np.ndarray) -> Estimate:
    """Return the slope of y = slope x and its standard deviation, from parts of the rows as clusters."""
    square = float(x @ x)
    value = float(x @ y) / square
    parts = np.array_split(x * (y - value * x), _SEGMENTS)
    return Estimate(value=value, sd=float(np.sqrt(sum(float(part.sum()) ** 2 for part in parts))) / square)


def _without(values: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return columns without what a constant and another column explain of them."""
    design = np.column_stack([other, np.ones(len(values))])
    return values - design @ np.linalg.lstsq(design, values, rcond=None)[0]


def _likelihood(expected: np.ndarray, measured: np.ndarray) -> float:
    """Return the log-likelihood by which a positive gain explains the measurement better than none."""
    norm = float(expected @ expected) * float(measured @ measured)
    correlation = float(expected @ measured) / np.sqrt(norm) if norm > 0.0 else 0.0
    return -0.5 * len(measured) * float(np.log1p(-(min(max(correlation, 0.0), 0.9999) ** 2)))


def _best(likelihood: np.ndarray, own: int) -> tuple[int, float, float]:
    """Return the most likely index, its margin over the file's own, and its lead over the next."""
    best = int(np.argmax(likelihood))
    others = np.delete(likelihood, best)
    return best, float(likelihood[best] - likelihood[own]), float(likelihood[best] - others.max())
