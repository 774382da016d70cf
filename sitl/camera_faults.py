"""Faults of the camera system that the host's library does not have: a slipped camera, a hidden marker."""

from __future__ import annotations

import math
from collections.abc import Sequence

from trimtab.sitl.draw import World
from trimtab.sitl.vectors import into_world, rotation

_AIRBORNE_M = 0.2  # height above which the vehicle has lifted off
_EDGE_M = 0.06  # width of the edge of the area where a marker is hidden

Pose = tuple[Sequence[float], Sequence[float]]
"""p_ned and q_ned_frd, w first."""


class CameraFaults:
    """The faults of one world's camera system.

    From a time after lift-off on, a camera that has slipped turns all poses about the origin. On one side of
    the room a marker is hidden, so that poses are shifted and tilted there.
    """

    def __init__(self, world: World) -> None:
        def value(kind: str, key: str) -> float:
            return world.value(kind, key)

        towards, tilt = value("camera-slip", "towards"), value("camera-slip", "tilt")
        self._slip = (tilt * math.cos(towards), tilt * math.sin(towards), value("camera-slip", "yaw"))
        self._slips_after_us = 1e6 * value("camera-slip", "at_s")
        towards = value("hidden-marker", "towards")
        self._hidden = (math.cos(towards), math.sin(towards))
        self._edge_m = value("hidden-marker", "edge_m")
        self._shift_m, self._tilt = value("hidden-marker", "shift_m"), value("hidden-marker", "tilt")
        self._lift_off_us: int | None = None

    @classmethod
    def of(cls, world: World) -> CameraFaults | None:
        """Return the faults of the world's camera system, None without any."""
        return cls(world) if {"camera-slip", "hidden-marker"} & world.effects.keys() else None

    def seen(self, now_us: int, p: Sequence[float], q: Sequence[float]) -> Pose:
        """Return how the cameras see the vehicle with pose `p`, `q` at a time, in the order of time."""
        if self._lift_off_us is None and p[2] < -_AIRBORNE_M:
            self._lift_off_us = now_us
        north, east = self._hidden
        inside = (p[0] * north + p[1] * east - self._edge_m) / _EDGE_M
        share = 0.5 + 0.5 * math.tanh(inside)
        turn = (-share * self._tilt * east, share * self._tilt * north, 0.0)
        q = _turned(q, turn)
        p = (p[0] + share * self._shift_m * north, p[1] + share * self._shift_m * east, p[2])
        if self._lift_off_us is not None and now_us - self._lift_off_us >= self._slips_after_us:
            p, q = into_world(rotation(_quaternion(self._slip)), p), _turned(q, self._slip)
        return p, q


def _quaternion(turn: Sequence[float]) -> tuple[float, float, float, float]:
    """Return the quaternion, w first, of a rotation vector."""
    angle = math.hypot(*turn)
    share = 0.5 if angle == 0.0 else math.sin(0.5 * angle) / angle
    return math.cos(0.5 * angle), share * turn[0], share * turn[1], share * turn[2]


def _turned(q: Sequence[float], turn: Sequence[float]) -> tuple[float, float, float, float]:
    """Return an attitude turned in the world by a rotation vector in NED."""
    w, x, y, z = _quaternion(turn)
    r, a, b, c = q
    return (
        w * r - x * a - y * b - z * c,
        w * a + x * r + y * c - z * b,
        w * b + y * r + z * a - x * c,
        w * c + z * r + x * b - y * a,
    )
