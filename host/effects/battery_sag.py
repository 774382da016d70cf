"""Battery sag: thrust at a given motor command falls with the battery voltage."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter, form
from trimtab.host.effects.unknowns import THRUST

_VOLTMETER_NOISE = 0.01  # share of the full voltage; smaller changes of the voltage show no sag


def _factor(ops, theta, ctx):
    exponent, load_share = theta
    return ops.exp(exponent * (1.0 + load_share * ctx.excess_speed(ops)) * ops.log(ctx.voltage_ratio))


def _feedforward(theta):
    return {"voltage_exponent": theta[0]}


EFFECT = Effect(
    name="battery-sag",
    title="Battery sag",
    equation="T_i = T_i,nominal (V / V_full)^(exponent (1 + load_share (sqrt(T / T_hover) - 1)))",
    source="measured on small brushless drives: thrust ~ V^1.5..2 at a fixed command",
    parameters=(
        Parameter(
            key="exponent",
            unit="1",
            neutral=0.0,
            typical=1.7,
            tolerance=0.1,
            lower=0.0,
            upper=8.0,
            description="exponent of the voltage ratio in the thrust",
        ),
        # The speed of a loaded motor falls less than in proportion to the voltage.
        form("load_share", 0.2, -0.5, 0.5, "share of the exponent that grows with rotor speed"),
    ),
    aliases=("thrust-gain", "mass", "ground-effect"),
    separated_by={"thrust-gain": "fly again with a full battery and log its voltage"},
    observable="flights with a full and with a partly discharged battery, or one long flight, with logged "
    "voltage",
    needs_signals={"voltage_ratio": _VOLTMETER_NOISE},
    replaced_by=(THRUST,),
    closing=Closing(
        model="the thrust of every rotor is multiplied by a power of the measured voltage ratio",
        planner="nothing: plans assume a full battery",
        law="the commanded thrust is divided by the same power of the voltage measured on board",
    ),
    slows_rotors=True,
    thrust_factor=_factor,
    to_feedforward=_feedforward,
)
