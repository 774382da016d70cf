"""Dead zone: motor commands near one value all give the same rotor speed."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter
from trimtab.host.effects.unknowns import THRUST

_NARROW = 0.03
_EDGE = 0.0025
"""Width of the zone's edges, in rotor speeds at hover: fast variations of the command blur them."""
_FAR = 40.0
"""Distance from an edge, in its widths, from which on nothing is left of the zone."""
_SLOWEST = 0.03
"""Least rotor speed, over that at hover: the root has a finite slope there."""


def _driven(ops, theta, command_n, hover_n):
    width, centre = theta
    middle = ops.sqrt(centre)
    off = ops.sqrt(ops.maximum(command_n / hover_n, _SLOWEST * _SLOWEST)) - middle
    # A zone narrower than _NARROW takes a share of the command's change, so that flights have a slope at a
    # width of 0.
    lost = ops.minimum(width / _NARROW, 1.0)
    half = ops.maximum(width, _NARROW) / (2.0 * middle)
    beyond = (ops.maximum(off, -off) - half) / _EDGE
    speed = middle + off * (1.0 - lost / (1.0 + ops.exp(ops.minimum(beyond, _FAR))))
    return hover_n * speed * speed


EFFECT = Effect(
    name="dead-zone",
    title="Dead zone of the motors",
    family="timing",
    equation="T_i,driven = T_h n^2, n = sqrt(centre) + d (1 - s / (1 + exp((|d| - v) / 0.0025))), "
    "d = sqrt(T_i,command / T_h) - sqrt(centre), v = max(width, 0.03) / (2 sqrt(centre)), "
    "s = min(width / 0.03, 1), T_h: thrust of a rotor at hover",
    source="motor controllers that round their input or hold a speed against small changes: 1-5 % of full "
    "command",
    parameters=(
        Parameter(
            key="width",
            unit="1",
            neutral=0.0,
            typical=0.08,
            tolerance=0.01,
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
    noise_dependent=True,
    starts=tuple((0.05 * 1.2**step, 1.0) for step in range(11)),
    driven_thrust_n=_driven,
)
