"""Inertia: the vehicle turns more or less readily than its file's principal moments say."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter
from trimtab.host.effects.unknowns import INERTIA, TORQUE


def _factors(ops, theta):
    return tuple(theta)


def _axis(key: str, tolerance: float) -> Parameter:
    return Parameter(
        key=key,
        unit="1",
        neutral=1.0,
        typical=0.2,
        tolerance=tolerance,
        lower=0.3,
        upper=3.0,
        description=f"moment of inertia about body {key} over the vehicle file's",
        # The loop's answer to noise within a step looks like a wrong inertia.
        discrepancy=0.2,
        free_sigma=0.5,
    )


EFFECT = Effect(
    name="inertia",
    title="Inertia",
    family="torque",
    equation="J = diag(x, y, z) J_nominal",
    source="payloads, batteries and drawings that left out the wiring: 10-30 %",
    parameters=(_axis("x", 0.02), _axis("y", 0.02), _axis("z", 0.04)),
    aliases=("motor-lag", "actuation-delay", "thrust-gain", "gyroscopic"),
    observed_relative_to="thrust-gain",
    observable="quick turns; only thrust times arm over inertia shows, swing the vehicle for more",
    replaced_by=(TORQUE,),
    freed_by=(INERTIA,),
    closing=Closing(
        model="the principal moments times constants",
        planner="without a drag beside it, plans a path of gentler turns, for which less torque is missing",
        law=None,
    ),
    inertia_factors=_factors,
)
