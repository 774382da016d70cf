"""Uneven lag: rotors slow down with another time constant than they speed up."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter
from trimtab.host.effects.unknowns import MOTOR_LAG, THRUST


def _factor(ops, theta, driven_n, thrust_n):
    # Both time constants have the mean of the vehicle file.
    ratio = theta[0]
    return ops.where(driven_n > thrust_n, 2.0, 2.0 * ratio) / (1.0 + ratio)


EFFECT = Effect(
    name="uneven-lag",
    title="Uneven motor lag",
    family="timing",
    equation="dT_i/dt = (T_i,command - T_i) / (lag f), f = 2 / (1 + ratio) if T_i,command > T_i, else "
    "2 ratio / (1 + ratio)",
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
    lag_factor=_factor,
)
