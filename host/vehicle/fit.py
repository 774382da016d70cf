"""How well a vehicle file fits a recorded flight: thrust against weight, torque against angular acceleration.

All functions take plain arrays in SI units, body FRD, world NED, times in integer microseconds, so that an
import can call them before a flight log exists. `motion.motion` brings the tracks of a recording to one time
grid, `thrust_figures` and `torque_figures` compare it with a vehicle. Nothing here decides: see `check`.

Torque. J w' + w x J w = B T, where T are the rotors' thrusts behind `motor_lag_s` and B is the allocation
matrix of the file. A controller answers a slow disturbance with the opposite torque, so a plain regression of
one on the other finds too little or nothing. Both sides are therefore means over BLOCK_S whose differences
are compared: within that time, no controller has answered yet.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trimtab.firmware_model.law.allocation import allocation_matrix
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.host.vehicle.model import Vehicle
from trimtab.host.vehicle.motion import GRID_S, TRIANGLE_S, Motion

BLOCK_S = 0.04
"""Length of the means that torque and angular acceleration are compared in."""

SLOWEST_INPUT_S = 0.05
"""Interval between inputs above which nothing can be said about torque."""

_SEGMENTS = 10
"""Parts of a flight whose scatter gives a standard deviation."""

_STEADY_RATE, _STEADY_THRUST = 1.5, 0.3
"""Body rate, rad/s, and relative distance of the thrust from its median, up to which flight is steady."""

_YAW_TRIM = 0.05
"""One sigma of the difference of the thrusts of both directions of rotation over their sum, in the mean."""

_RANK_LEAST = 1e-3
"""Least singular value, over the greatest, of an allocation that can turn the vehicle about all axes."""


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


def thrust_figures(flight: Motion, mass_kg: float) -> ThrustFigures | None:
    """Return thrust against weight, or None if less than a second of the flight is steady."""
    force = _triangle(flight.specific_force_frd)
    thrust_n = _triangle(flight.collective_n[:, None])[:, 0]
    rate = _triangle(np.abs(flight.rate_frd)).max(axis=1)
    middle = float(np.median(thrust_n))
    steady = (rate < _STEADY_RATE) & (np.abs(thrust_n - middle) < _STEADY_THRUST * abs(middle))
    if steady.sum() * GRID_S < 1.0 or middle <= 0.0:
        return None
    up_n = -mass_kg * force[:, 2]
    scale = _slope(thrust_n[steady], up_n[steady])
    slope = None
    if np.std(thrust_n) > 0.02 * middle and scale.value > 0.0:
        free = _slope(thrust_n - thrust_n.mean(), up_n - up_n.mean())
        slope = Estimate(value=free.value / scale.value, sd=free.sd / scale.value)
    x, y, z = (float(value) for value in force[steady].mean(axis=0) / GRAVITY)
    return ThrustFigures(scale=scale, slope=slope, force_xyz=(x, y, z), steady_s=float(steady.sum()) * GRID_S)


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


def _triangle(values: np.ndarray) -> np.ndarray:
    """Return columns filtered with a triangle, without the ends that it does not cover."""
    half = round(TRIANGLE_S / GRID_S)
    kernel = np.bartlett(2 * half + 1)
    kernel /= kernel.sum()
    columns = [np.convolve(values[:, k], kernel, mode="valid") for k in range(values.shape[1])]
    return np.column_stack(columns)


def _means(values: np.ndarray) -> np.ndarray:
    """Return the means of columns over consecutive blocks."""
    size = round(BLOCK_S / GRID_S)
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
