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
class Motion:
    """A flight on a grid of GRID_US.

    Attributes
    ----------
    t_us
        Times.
    rate_frd, specific_force_frd
        Body rate (rad/s) and specific force (m/s^2), measured or derived from poses.
    rotor_thrust_n
        Thrust of each rotor that the commands ask for, behind the motor lag; None if only thrust was recorded.
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
    order: tuple[int, int, int, int] | None = None
    order_margin: float = 0.0
    order_lead: float = 0.0
    spins: tuple[int, int, int, int] | None = None
    spins_margin: float = 0.0
    spins_lead: float = 0.0


def motion(
    vehicle: Vehicle,
    *,
    inputs: tuple[
        Annotated[np.ndarray, "inputs"],
        Annotated[np.ndarray, "inputs 4"] | None,
        Annotated[np.ndarray, "inputs"] | None,
        Annotated[np.ndarray, "inputs 3"] | None,
    ],
    rate: tuple[Annotated[np.ndarray, "rates"], Annotated[np.ndarray, "rates 3"]] | None = None,
    force: tuple[Annotated[np.ndarray, "forces"], Annotated[np.ndarray, "forces 3"]] | None = None,
    poses: tuple[
        Annotated[np.ndarray, "poses"], Annotated[np.ndarray, "poses 3"], Annotated[np.ndarray, "poses 4"]
    ]
    | None = None,
    span_us: tuple[int, int],
) -> Motion | None:
    """Return the flight between two times on one grid; None if less than two seconds of it have all tracks.

    Parameters
    ----------
    vehicle
        File whose thrust curve and motor lag apply.
    inputs
        Times, and either motor commands in 0..1 in the order of the vehicle's rotors, or collective thrust (N)
        and, if known, torque (N m, FRD). A time is the middle of the interval in which its row acts.
    rate, force
        Times with body rate (rad/s, FRD) and specific force (m/s^2, FRD). None: from the poses.
    poses
        Times, positions (NED) and attitudes (w first). Needed for what is not measured.
    span_us
        Time in the air.
    """
    input_us, command, thrust_n, torque = inputs
    tracks = [each[0] for each in (inputs, rate, force) if each is not None]
    if rate is None or force is None:
        if poses is None:
            return None
        tracks.append(poses[0][1:-1])
    if min(len(times) for times in tracks) < 2:
        return None
    begin = max(span_us[0], *(int(times[0]) for times in tracks))
    end = min(span_us[1], *(int(times[-1]) for times in tracks))
    t_us = np.arange(begin, end + 1, GRID_US)
    if len(t_us) < 2_000_000 // GRID_US:
        return None

    def behind(values: np.ndarray) -> np.ndarray:
        return lagged(_at(t_us, input_us, values), vehicle.motor_lag_s)

    rotors = None
    if command is not None:
        c1, c2 = vehicle.thrust_curve
        rotors = behind(np.asarray(command_to_thrust(command, vehicle.thrust_max_n, c1, c2)))  # type: ignore[arg-type]
        collective = rotors.sum(axis=1)
    elif thrust_n is not None:
        collective = behind(thrust_n[:, None])[:, 0]
    else:
        return None
    return Motion(
        t_us=t_us,
        rate_frd=_at(t_us, *rate) if rate is not None else _rate_of_poses(t_us, poses),
        specific_force_frd=_at(t_us, *force) if force is not None else _force_of_poses(t_us, poses),
        collective_n=collective,
        rotor_thrust_n=rotors,
        torque_n_m=None if torque is None or rotors is not None else behind(torque),
        input_s=float(np.median(np.diff(input_us))) * 1e-6,
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
    expected = turning + np.cross(rate, rate * inertia) / inertia
    measured = np.diff(expected, axis=0)
    lift = np.diff(_between(flight.collective_n[:, None]), axis=0)
    if flight.rotor_thrust_n is None:
        if flight.torque_n_m is None:
            return None
        torque = np.diff(_between(flight.torque_n_m), axis=0) / inertia
        gains = [_axis(torque[:, k], measured[:, k], lift) for k in range(3)]
        return TorqueFigures(gain=_gains(gains))
    thrust = np.diff(_between(flight.rotor_thrust_n), axis=0)
    arms = np.array([rotor.position_m for rotor in vehicle.rotors])
    levers = np.stack([-arms[:, 1], arms[:, 0]]) / inertia[:2, None]
    orders = list(itertools.permutations(range(4)))
    turned = np.array(
        [
            sum(_likelihood(thrust[:, order] @ levers[k], measured[:, k], lift) for k in range(2))
            for order in orders
        ]
    )
    best, margin, lead = _best(turned, orders.index((0, 1, 2, 3)))
    order = orders[best]
    thrust, mean = thrust[:, order], flight.rotor_thrust_n[:, order].mean(axis=0)
    signs = [each for each in itertools.product((1, -1), repeat=4) if _turns_all(vehicle, each)]
    own = signs.index(tuple(rotor.spin_sign for rotor in vehicle.rotors))
    yawed = np.array(
        [
            _likelihood(thrust @ np.array(each), measured[:, 2], lift)
            - 0.5 * (float(mean @ np.array(each)) / (_YAW_TRIM * float(mean.sum()))) ** 2
            for each in signs
        ]
    )
    chosen, spins_margin, spins_lead = _best(yawed, own)
    spins = signs[chosen]
    rows = [thrust @ lever for lever in levers]
    rows.append(vehicle.torque_per_thrust_m / inertia[2] * thrust @ np.array(spins))
    gains = [_axis(row, measured[:, k], lift) for k, row in enumerate(rows)]
    return TorqueFigures(
        gain=_gains(gains),
        order=order,
        order_margin=margin,
        order_lead=lead,
        spins=spins,
        spins_margin=spins_margin,
        spins_lead=spins_lead,
    )


def _turns_all(vehicle: Vehicle, spins: Sequence[int]) -> bool:
    """Return whether rotors at the file's positions with these spins can turn the vehicle about all axes."""
    positions = [rotor.position_m for rotor in vehicle.rotors]
    matrix = np.array(allocation_matrix(positions, spins, 1.0)).reshape(4, 4)
    sizes = np.linalg.svd(matrix / np.abs(matrix).max(axis=1, keepdims=True), compute_uv=False)
    return bool(sizes[-1] > _RANK_LEAST * sizes[0])


def _gains(each: Sequence[Estimate | None]) -> tuple[Estimate | None, Estimate | None, Estimate | None]:
    roll, pitch, yaw = each
    return roll, pitch, yaw


def _at(t_us: np.ndarray, times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the columns of `values` interpolated at times."""
    return np.column_stack([np.interp(t_us, times, values[:, k]) for k in range(values.shape[1])])


def _attitude(t_us: np.ndarray, poses: tuple[np.ndarray, np.ndarray, np.ndarray]) -> Rotation:
    slerp = Slerp(poses[0], Rotation.from_quat(poses[2], scalar_first=True))
    return slerp(np.clip(t_us, poses[0][0], poses[0][-1]))


def _rate_of_poses(t_us: np.ndarray, poses: tuple[np.ndarray, np.ndarray, np.ndarray] | None) -> np.ndarray:
    """Return the body rate from the change of the attitude over two steps of the grid."""
    assert poses is not None
    before, after = (_attitude(t_us + shift, poses) for shift in (-GRID_US, GRID_US))
    return (before.inv() * after).as_rotvec() / (2.0 * _GRID_S)


def _force_of_poses(t_us: np.ndarray, poses: tuple[np.ndarray, np.ndarray, np.ndarray] | None) -> np.ndarray:
    """Return the specific force from the second difference of the positions."""
    assert poses is not None
    step_us = round(_TRIANGLE_S * 1e6)
    before, now, after = (_at(t_us + shift, poses[0], poses[1]) for shift in (-step_us, 0, step_us))
    a_ned = (before - 2.0 * now + after) / _TRIANGLE_S**2
    return _attitude(t_us, poses).inv().apply(a_ned - np.array([0.0, 0.0, GRAVITY]))


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


def _without(x: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return x without what a constant and the other columns explain of it."""
    design = np.column_stack([others, np.ones(len(x))])
    return x - design @ np.linalg.lstsq(design, x, rcond=None)[0]


def _axis(expected: np.ndarray, measured: np.ndarray, lift: np.ndarray) -> Estimate | None:
    """Return measured over expected angular acceleration of an axis, or None if none was expected."""
    x = _without(expected, lift)
    return _slope(x, _without(measured, lift)) if float(x @ x) > 0.0 else None


def _likelihood(expected: np.ndarray, measured: np.ndarray, lift: np.ndarray) -> float:
    """Return the log-likelihood by which a positive gain explains the measurement better than none."""
    x, y = _without(expected, lift), _without(measured, lift)
    norm = float(x @ x) * float(y @ y)
    correlation = float(x @ y) / np.sqrt(norm) if norm > 0.0 else 0.0
    return -0.5 * len(y) * float(np.log1p(-min(max(correlation, 0.0), 0.9999) ** 2))


def _best(likelihood: np.ndarray, own: int) -> tuple[int, float, float]:
    """Return the most likely index, its margin over the file's own, and its lead over the next."""
    best = int(np.argmax(likelihood))
    others = np.delete(likelihood, best)
    return best, float(likelihood[best] - likelihood[own]), float(likelihood[best] - others.max())
