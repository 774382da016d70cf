"""Battery sag: thrust at a given motor command falls with the battery voltage."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter
from trimtab.host.effects.unknowns import THRUST

_VOLTMETER_NOISE = 0.01  # share of the full voltage; smaller changes of the voltage show no sag


def _factor(ops, theta, ctx):
    return ops.exp(theta[0] * ops.log(ctx.voltage_ratio))


def _feedforward(theta):
    return {"voltage_exponent": theta[0]}


EFFECT = Effect(
    name="battery-sag",
    title="Battery sag",
    equation="T_i = T_i,nominal (V / V_full)^exponent",
    source="measured on small brushless drives: thrust ~ V^1.5..2 at a fixed command",
    parameters=(
        Parameter(
            key="exponent",
            unit="1",
            neutral=0.0,
            typical=1.7,
            tolerance=0.1,
            lower=-1.0,
            upper=5.0,
            description="exponent of the voltage ratio in the thrust",
        ),
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
    thrust_factor=_factor,
    to_feedforward=_feedforward,
)
