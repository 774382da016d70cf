"""Uneven lag: rotors slow down with another time constant than they speed up."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter, form
from trimtab.host.effects.unknowns import MOTOR_LAG, THRUST

_ROUNDING = 0.8
"""Mean of |n| of normal noise of unit power: by how much noise rounds the corner between the two lags."""
_LEAST = 1e-30
"""Least square of a thrust, N^2, under the roots: their slopes are finite without noise."""


def _driven(ops, theta, command_n, hover_n):
    ratio, fast_share = theta
    return command_n * (1.0 + _raised(ops, ratio, fast_share))


def _raised(ops, ratio, fast_share):
    """Return by which share fast commands raise the mean thrust, since it rises faster than it falls."""
    return 0.5 * _ROUNDING * fast_share * (ratio - 1.0) / ops.sqrt(ratio)


def _factor(ops, theta, driven_n, thrust_n):
    # The rate of the mean thrust is p d + q sqrt(d^2 + n^2), a hyperbola between the two lags. d: what the
    # mean command lacks, n: noise of the commands. p, q: mean and half difference of the rates over the lag.
    # Both time constants have the mean of the vehicle file.
    ratio, fast_share = theta
    noise_n = _ROUNDING * fast_share * driven_n
    raised_n = driven_n * _raised(ops, ratio, fast_share)
    lacking_n = driven_n - raised_n - thrust_n
    corner = noise_n * noise_n + _LEAST
    rising = (lacking_n - raised_n) / (
        ops.sqrt(lacking_n * lacking_n + corner) + ops.sqrt(raised_n * raised_n + corner)
    )
    return 4.0 * ratio / ((1.0 + ratio) * (1.0 + ratio + (ratio - 1.0) * rising))


EFFECT = Effect(
    name="uneven-lag",
    title="Uneven motor lag",
    family="timing",
    equation="dT_i/dt = (p d + q sqrt(d^2 + (0.8 fast_share T_i,command)^2)) / lag, d = T_i,command - T_i, "
    "p = (1 + ratio)^2 / (4 ratio), q = (ratio^2 - 1) / (4 ratio)",
    source="motor controllers without active braking: drag alone slows a propeller down, 1.5-3 times as "
    "slowly as the motor speeds it up",
    parameters=(
        Parameter(
            key="ratio",
            unit="1",
            neutral=1.0,
            typical=1.0,
            tolerance=0.1,
            lower=0.5,
            upper=10.0,
            description="time constant of slowing down over that of speeding up; their mean stays",
        ),
        # Fast commands, which answer noise of the sensors, blur which of the two lags acts.
        form("fast_share", 0.01, 0.0, 0.1, "fast part of the commands over the thrust, rms", neutral=0.01),
    ),
    aliases=("motor-lag", "dead-zone"),
    observable="fast changes of thrust with the gyro or the rotor speeds logged",
    replaced_by=(THRUST, MOTOR_LAG),
    closing=Closing(
        model="rotor thrust rises and falls with different time constants",
        planner="nothing: plans contain rotor thrusts, which have no lag",
        law=None,
        no_law="rotors cannot be made to slow down faster; turn on active braking in the motor controllers",
    ),
    driven_thrust_n=_driven,
    lag_factor=_factor,
)
