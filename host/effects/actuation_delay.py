"""Actuation delay: a motor command takes effect some time after it was sent, in addition to the motor lag."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter
from trimtab.host.effects.unknowns import MOTOR_LAG, THRUST, TORQUE


def _delay(ops, theta):
    return theta[0]


EFFECT = Effect(
    name="actuation-delay",
    title="Actuation delay",
    family="timing",
    equation="T_i,command(t) = T_i,commanded(t - delay_s)",
    source="motor controllers and their protocols: 2-10 ms",
    parameters=(
        Parameter(
            key="delay_s",
            unit="s",
            neutral=0.0,
            typical=0.006,
            tolerance=0.0003,
            lower=0.0,
            upper=0.03,
            description="time from a motor command to its arrival at the rotor",
            # Real rotors are no first-order lag, and the response of the loop to noise looks like a delay.
            discrepancy=0.4,
        ),
    ),
    aliases=("motor-lag", "mocap-latency", "inertia", "thrust-inflow"),
    separated_by={"mocap-latency": "log the gyro, or measure the delay of the cameras"},
    observable="fast rotations in roll and pitch with the gyro logged; without the gyro, it looks like a "
    "mocap latency",
    replaced_by=(THRUST, MOTOR_LAG, TORQUE),
    closing=Closing(
        model="the rotors follow delayed commands",
        planner="nothing: plans contain rotor thrusts, which have no delay",
        law=None,
        no_law="the law cannot send a command before it knows it",
    ),
    command_delay_s=_delay,
)
