"""Mass: the vehicle weighs more or less than its file says."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter


def _factor(ops, theta):
    return theta[0]


def _feedforward(theta):
    return {"gain": 1.0 / theta[0]}


EFFECT = Effect(
    name="mass",
    title="Mass",
    equation="m = factor m_nominal",
    source="payloads and batteries: 5-30 %; only thrust over mass shows without a weighing",
    parameters=(
        Parameter(
            key="factor",
            unit="1",
            neutral=1.0,
            typical=0.08,
            tolerance=0.01,
            lower=0.4,
            upper=2.5,
            description="mass over the vehicle file's mass",
            # The vehicle was weighed.
            measured_below=0.005,
        ),
    ),
    aliases=("thrust-gain", "battery-sag", "ground-effect", "slung-payload"),
    observable="never apart from thrust in flight; weigh the vehicle",
    adjustment=True,
    closing=Closing(
        model="the mass times a constant",
        planner="without a drag beside it, plans a path of less acceleration, of which a share "
        "is missing; what hover lacks is "
        "left out",
        law="the commanded thrust is multiplied by the factor",
    ),
    mass_factor=_factor,
    to_feedforward=_feedforward,
)
