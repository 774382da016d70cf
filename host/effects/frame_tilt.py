"""Tilt of the camera frame: its vertical differs from gravity, so hover requires an unplanned tilt."""

from __future__ import annotations

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter
from trimtab.host.effects.unknowns import FRAME_TILT


def _gravity(ops, theta):
    x, y = theta
    return (GRAVITY * y, -GRAVITY * x, 0.0)


def _feedforward(theta):
    x, y = theta
    return {"bias_ned": (GRAVITY * y, -GRAVITY * x, 0.0)}


def _axis(key: str, direction: str) -> Parameter:
    return Parameter(
        key=key,
        unit="rad",
        neutral=0.0,
        typical=0.015,
        tolerance=0.001,
        lower=-0.1,
        upper=0.1,
        description=f"rotation of the camera frame about its {direction} axis, relative to the true vertical",
        free_sigma=0.02,
    )


EFFECT = Effect(
    name="frame-tilt",
    title="Tilt of the camera frame",
    equation="g in the camera frame = (g tilt_y, -g tilt_x, g)",
    source="manual calibration of a camera system: 0.2-2 deg, 0.17 m/s^2 per degree",
    parameters=(_axis("tilt_x", "north"), _axis("tilt_y", "east")),
    aliases=("wind", "com-offset"),
    observable="a force that is constant in the room for all headings and does not grow with speed",
    freed_by=(FRAME_TILT,),
    closing=Closing(
        model="gravity is rotated in the frame of the poses",
        planner="nothing, except in starred plans, whose dynamics contain it",
        law="the horizontal part of gravity in the tilted frame is fed forward as a constant acceleration",
    ),
    gravity_ned=_gravity,
    to_feedforward=_feedforward,
)
