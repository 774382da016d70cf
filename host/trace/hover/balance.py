"""The balance of a log: the accelerations that the model predicts from its mean rotor thrusts.

At level attitude and at rest, the model of `trimtab.host.models.dynamics` gives the specific force along the
thrust and the three angular accelerations. In the mean of a flight the measured ones are the lift that the
motion needs, and 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.host.models.airframe import RATE
from trimtab.host.models.dynamics import rigid_body
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.hover.mean import HoverMean
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.vehicle import Vehicle

CHANNELS = 4
"""Specific force along the thrust, m/s^2, and angular acceleration about x, y, z (FRD), rad/s^2."""

_STEP = 1e-4
"""Step of the difference quotients, scaled."""

Channels = Annotated[np.ndarray, "4"]


@dataclass(frozen=True, kw_only=True)
class State:
    """What the model reads of a hover besides thrusts: height, m, and battery voltage over full voltage."""

    height_m: float
    voltage_ratio: float


@dataclass(frozen=True, kw_only=True)
class Balance:
    """Thrusts of the rotors in one log, and the balance that they gave.

    Attributes
    ----------
    thrust_n
        Mean thrust of each rotor, N.
    measured
        The measured balance.
    state
        Mean height and voltage.
    covariance
        Of measured minus predicted balance: from the scatter of the blocks of the log.
    scale
        Change of the predicted balance if all thrusts grow by their own size.
    yaw_sigma
        Standard deviation, rad/s^2, of the yaw acceleration of rotor axes that are tilted at random.
    """

    thrust_n: Annotated[np.ndarray, "4"]
    measured: Channels
    state: State
    covariance: Annotated[np.ndarray, "4 4"] = field(repr=False)
    scale: Channels = field(repr=False)
    yaw_sigma: float


def predicted(
    vehicle: Vehicle,
    space: ParameterSpace,
    theta_scaled: Annotated[np.ndarray, "parameters"],
    thrust_n: Annotated[np.ndarray, "4"],
    state: State,
) -> Channels:
    """Return the balance that the model predicts from rotor thrusts, N. Effects with states are at rest."""
    values = space.by_owner(space.values(theta_scaled).tolist())
    parts = [(space.effects[name], values[name]) for name in space.parts]
    x = [0.0, 0.0, -state.height_m, *(0.0,) * 9, *thrust_n.tolist()]
    out = rigid_body(FLOAT, vehicle, parts, x, state.voltage_ratio)
    return np.array([GRAVITY - out[5], *out[RATE]])


def slopes(
    vehicle: Vehicle,
    space: ParameterSpace,
    theta_scaled: Annotated[np.ndarray, "parameters"],
    balance: Balance,
) -> Annotated[np.ndarray, "parameters 4"]:
    """Return the derivatives of `predicted` with respect to theta_scaled, by central differences."""
    rows = []
    for row in np.eye(len(theta_scaled)) * _STEP:
        ahead, behind = (
            predicted(vehicle, space, theta_scaled + sign * row, balance.thrust_n, balance.state)
            for sign in (1.0, -1.0)
        )
        rows.append((ahead - behind) / (2.0 * _STEP))
    return np.array(rows)


def balances(
    vehicle: Vehicle, space: ParameterSpace, means: Sequence[HoverMean], baseline: int, linear: float
) -> list[Balance]:
    """Return the balance of each log.

    One factor scales all thrusts so that those of the baseline carry the weight: both sets share the errors
    of thrust curve and mass.

    Parameters
    ----------
    vehicle, space
        Vehicle, and parameters of the model.
    means
        Means of each log; the first `baseline` are of the baseline.
    linear
        Linear share of the thrust curve, 0 to 1.
    """
    neutral = np.zeros(len(space.columns))
    thrusts = [_thrusts(vehicle, mean, linear) for mean in means]
    needed = np.mean([vehicle.mass_kg * mean.lift_m_s2 for mean in means[:baseline]])
    gain = needed / np.mean([each.mean(0).sum() for each in thrusts[:baseline]])
    floor = np.diag(RULES.hover_floor * _per_weight(vehicle)) ** 2
    result = []
    for mean, blocks in zip(means, thrusts, strict=True):
        state = State(height_m=mean.height_m, voltage_ratio=mean.voltage_ratio)
        nominal = np.array([predicted(vehicle, space, neutral, gain * row, state) for row in blocks])
        result.append(
            Balance(
                thrust_n=gain * blocks.mean(0),
                measured=np.array([mean.lift_m_s2, 0.0, 0.0, 0.0]),
                state=state,
                covariance=np.cov(nominal.T) / len(nominal) + floor,
                scale=nominal.mean(0),
                yaw_sigma=_yaw_sigma(vehicle, gain * blocks.mean(0)),
            )
        )
    return result


def _thrusts(vehicle: Vehicle, mean: HoverMean, linear: float) -> Annotated[np.ndarray, "blocks 4"]:
    """Return the mean thrust of each rotor in each block, N, before the common factor."""
    if mean.in_newton:
        return mean.command
    return vehicle.thrust_max_n * (linear * mean.command + (1.0 - linear) * mean.command_squared)


def _per_weight(vehicle: Vehicle) -> Channels:
    """Return the balance if a thrust of the weight acted on each channel, with the levers of the rotors."""
    weight_n = vehicle.mass_kg * GRAVITY
    x, y = (np.abs([rotor.position_m[axis] for rotor in vehicle.rotors]).mean() for axis in (0, 1))
    levers = np.array([y, x, vehicle.torque_per_thrust_m])
    return np.array([GRAVITY, *(weight_n * levers / np.array(vehicle.inertia_kg_m2))])


def _yaw_sigma(vehicle: Vehicle, thrust_n: Annotated[np.ndarray, "4"]) -> float:
    """Return the standard deviation of the yaw acceleration, rad/s^2, of tilted rotor axes."""
    levers = np.array([np.hypot(*rotor.position_m[:2]) for rotor in vehicle.rotors])
    torque = RULES.rotor_tilt_sigma_rad * np.linalg.norm(thrust_n * levers)
    return float(torque / vehicle.inertia_kg_m2[2])
