"""Dead zone: motor commands near one value all give the same rotor speed."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter
from trimtab.host.effects.unknowns import THRUST

_NARROW = 0.06


def _driven(ops, theta, command_n, hover_n):
    width, centre = theta
    off = command_n / hover_n - centre
    # A smooth step, since fast variations of the command blur the edges of the zone. A narrower zone than
    # _NARROW takes a share of the command's change, so that flights have a slope at a width of 0.
    lost = ops.minimum(width / _NARROW, 1.0)
    inside, outside = _sixteenth_power(ops.maximum(width, _NARROW)), _sixteenth_power(off)
    return hover_n * (centre + off * (1.0 - lost * inside / (inside + outside)))


def _sixteenth_power(x):
    x2 = x * x
    x4 = x2 * x2
    x8 = x4 * x4
    return x8 * x8


EFFECT = Effect(
    name="dead-zone",
    title="Dead zone of the motors",
    family="timing",
    equation="T_i,driven = T_h (centre + d (1 - s w^16 / (w^16 + d^16))), d = T_i,command / T_h - centre, "
    "w = max(width, 0.06), s = min(width / 0.06, 1), T_h: thrust of a rotor at hover",
    source="motor controllers that round their input or hold a speed against small changes: 1-5 % of full "
    "command",
    parameters=(
        Parameter(
            key="width",
            unit="1",
            neutral=0.0,
            typical=0.08,
            tolerance=0.02,
            lower=0.0,
            upper=0.6,
            description="half width of the zone over the thrust of a rotor at hover",
        ),
        Parameter(
            key="centre",
            unit="1",
            neutral=1.0,
            typical=0.05,
            tolerance=0.02,
            lower=0.3,
            upper=2.0,
            description="middle of the zone over the thrust of a rotor at hover",
            strength=False,
        ),
    ),
    aliases=("uneven-lag", "motor-lag"),
    observable="small changes of thrust about the middle of the zone, as in gentle flight",
    replaced_by=(THRUST,),
    closing=Closing(
        model="rotors hold their thrust while commands stay in the zone",
        planner="nothing: plans contain rotor thrusts, which have no dead zone",
        law=None,
        no_law="a command in the zone has no effect; turn the dead band off in the motor controllers",
    ),
    starts=((0.04, 1.0), (0.08, 1.0), (0.12, 1.0)),
    driven_thrust_n=_driven,
)
