"""Parts of the sampled on-board law in continuous time: rate filter, integral, observer, late commands."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from trimtab.firmware_model.law import step as law_step
from trimtab.firmware_model.law.observer import DISTURBANCE_MAX
from trimtab.firmware_model.law.ops import Ops
from trimtab.firmware_model.law.rotations import dot

Scalar = Any

LIMIT_DECAY = 70.0
"""Rate, 1/s, at which what exceeds an integral's limit decays; RK4 is stable with it at steps of 20 ms."""

_DELAY_FILTER_S = 0.0041
"""Shortest time constant of the filter on late commands; RK4 is stable with it at steps of 10 ms."""


def sampled_filter(corner: float) -> tuple[float, float]:
    """Return the corner (rad/s) of the sampled rate filter in continuous time, and its excess slope factor.

    The law's filter advances by c = w dt / (1 + w dt/2) in a tick. In continuous time it decays at
    -ln(1 - c)/dt. Its lag behind a ramp is dt/c, and the law takes w times that lag as the slope.
    """
    dt = law_step.TICK_S
    advance = corner * dt / (1.0 + 0.5 * corner * dt)
    continuous = -math.log1p(-advance) / dt
    return continuous, continuous * dt / advance


def torque_with_filter_lag(
    torque: Sequence[Scalar],
    present_torque: Sequence[Scalar],
    rate_derivative: Sequence[Scalar],
    share: float,
    lag_s: Scalar,
) -> list[Scalar]:
    """Return the commanded torque where the filtered slope lags; `torque` is with the present slope.

    The filter's slope is late by its time constant. It therefore lacks K_d times the change of torque in that
    time. That change is itself (commanded - present) / lag, which gives one equation for each axis.
    """
    commanded = []
    for wanted, present, gain in zip(torque, present_torque, rate_derivative, strict=True):
        c = gain * share / lag_s
        commanded.append((wanted - c * present) / (1.0 - c))
    return commanded


def limited_integral_rate(ops: Ops, value: Scalar, rate: Scalar, limit: float) -> Scalar:
    """Return the rate of an integral that the law limits: what exceeds the limit decays at LIMIT_DECAY.

    If the rate were 0 at the limit instead, a roll-out would jump where it reaches the limit in another step,
    and its slopes would mean nothing. The law uses the clipped value.
    """
    return rate - LIMIT_DECAY * (value - ops.clip(value, -limit, limit))


def observer_rates(
    ops: Ops,
    firmware: Sequence[Scalar],
    states: Sequence[Scalar],
    measured: Sequence[Scalar],
    commanded_thrust: Scalar,
    hold_s: float,
) -> list[Scalar]:
    """Return the derivatives of the observer's four states (`trimtab.firmware_model.law.observer`).

    states: disturbance estimate 3, lagged collective thrust (N). measured: `measured_disturbance` at them.
    """
    *d_hat, thrust = states
    bandwidth, lag = law_step.observer(firmware)
    rates = [bandwidth * (s - d) for d, s in zip(d_hat, measured, strict=True)]
    square = dot(d_hat, d_hat)
    bound_squared = DISTURBANCE_MAX * DISTURBANCE_MAX
    growth = ops.maximum(dot(d_hat, rates), 0.0) / ops.maximum(square, bound_squared)
    outward = ops.where(square >= bound_squared, growth, 0.0)  # the estimate is at its bound
    rates = [rate - outward * d for rate, d in zip(rates, d_hat, strict=True)]
    return [*rates, (commanded_thrust - thrust) / (lag + hold_s)]


def delayed_command(
    ops: Ops, command: Sequence[Scalar], states: Sequence[Scalar], delay_s: Scalar
) -> tuple[list[Scalar], list[Scalar]]:
    """Return the rotor commands (N) that arrive after a delay, and the derivatives of the delay's states.

    exp(-D s) is approximated by 1 - D s / (1 + T s), which is right to second order in s where D = 2 T.
    """
    filter_s = ops.maximum(0.5 * delay_s, _DELAY_FILTER_S)
    rates = [(u - state) / filter_s for u, state in zip(command, states, strict=True)]
    return [u - delay_s * rate for u, rate in zip(command, rates, strict=True)], rates
