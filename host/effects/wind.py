"""Constant horizontal wind: drag depends on the velocity relative to the air."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter
from trimtab.host.effects.unknowns import FRAME_TILT


def _wind(ops, theta):
    wx, wy = theta
    return (wx, wy, 0.0)


def _feedforward(theta):
    wx, wy = theta
    return {"wind_ned": (wx, wy, 0.0)}


def _axis(key: str, direction: str) -> Parameter:
    return Parameter(
        key=key,
        unit="m/s",
        neutral=0.0,
        typical=1.5,
        tolerance=0.05,
        lower=-10.0,
        upper=10.0,
        description=f"{direction} component of the velocity of the air",
    )


EFFECT = Effect(
    name="wind",
    title="Constant wind",
    family="aerodynamic",
    equation="v_air_ned = v_ned - (wx, wy, 0)",
    source="0.5-3 m/s outdoors and near air conditioning; acts only through drag",
    parameters=(_axis("wx", "north"), _axis("wy", "east")),
    aliases=("linear-drag", "quadratic-drag", "com-offset", "frame-tilt"),
    separated_by={"frame-tilt": "fly again without wind, or level the camera system"},
    observable="flights in both directions of each axis; in hover it looks like a tilt of the camera frame",
    replaced_by=(FRAME_TILT,),
    requires_any=("linear-drag", "quadratic-drag"),
    closing=Closing(
        model="drag depends on the velocity relative to the air",
        planner="prefers paths with less drag in moving air: slower against the wind",
        law="the drag that is fed forward is that of the velocity relative to the air",
    ),
    wind_ned=_wind,
    to_feedforward=_feedforward,
)
