"""Motor lag: the rotors follow their command more slowly, or faster, than the vehicle file says."""

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
            description="time constant beyond the vehicle file's",
            # Rotors are no first-order lag; the loop's answer to noise within a step looks like a wrong one.
            discrepancy=0.25,
            # What phi reads into flights of a simulated vehicle without noise, turbulence or effect.
            loop_discrepancy=0.05,
            free_sigma=0.05,
        ),
    ),
    aliases=("mocap-latency", "actuation-delay", "inertia", "thrust-inflow"),
    observable="quick turns of roll and pitch with the gyro in the log",
    replaced_by=(THRUST,),
    freed_by=(MOTOR_LAG,),
    closing=Closing(
        model="rotor thrust with the longer time constant",
        planner="nothing: the rotor thrusts of a plan have no lag",
        law=None,
    ),
    motor_lag_s=_lag,
)
