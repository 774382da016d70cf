"""Motor lag: the time constant of the rotors differs from that in the vehicle file."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter
from trimtab.host.effects.unknowns import MOTOR_LAG, THRUST


def _lag(ops, theta, nominal_s):
    return nominal_s + theta[0]


EFFECT = Effect(
    name="motor-lag",
    title="Motor lag",
    family="timing",
    equation="dT_i/dt = (T_i,command - T_i) / (lag_nominal + extra_s)",
    source="first order, 12-70 ms on small quadrotors",
    parameters=(
        Parameter(
            key="extra_s",
            unit="s",
            neutral=0.0,
            typical=0.015,
            tolerance=0.001,
            lower=-0.008,
            upper=0.08,
            description="time constant minus that in the vehicle file",
            # Real rotors are no first-order lag, and the loop's response to noise looks like a wrong lag.
            discrepancy=0.25,
            # What phi fits to flights of a simulated vehicle without noise, turbulence and effects.
            loop_discrepancy=0.05,
            free_sigma=0.05,
        ),
    ),
    aliases=("mocap-latency", "actuation-delay", "inertia", "thrust-inflow", "uneven-lag", "dead-zone"),
    observable="fast rotations in roll and pitch with the gyro logged",
    replaced_by=(THRUST,),
    freed_by=(MOTOR_LAG,),
    closing=Closing(
        model="rotor thrust follows commands with the other time constant",
        planner="nothing: plans contain rotor thrusts, which have no lag",
        law=None,
        no_law="rotors cannot be made faster; correct the lag in the vehicle file",
    ),
    motor_lag_s=_lag,
)
