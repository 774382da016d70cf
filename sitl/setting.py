"""What a simulated vehicle is built from, and where it stands after a reboot."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from trimtab.host.vehicle import Vehicle
from trimtab.sitl.draw import World

_UPRIGHT = 0.9
"""Least cosine of the tilt of a vehicle that stands on its feet; the floor is level."""


class Place(NamedTuple):
    """Position, m, NED, and yaw, rad, at which a vehicle stands. The floor is at z = 0."""

    p_ned: tuple[float, float, float]
    yaw: float

    @property
    def q_ned_frd(self) -> tuple[float, float, float, float]:
        """Attitude of a vehicle that stands upright."""
        return math.cos(0.5 * self.yaw), 0.0, 0.0, math.sin(0.5 * self.yaw)


@dataclass(frozen=True, kw_only=True)
class Setting:
    """Everything that a simulated vehicle is built from, apart from the flight index and the memory."""

    vehicle: Vehicle
    world: World
    is_world_named: bool
    """Whether the world was chosen. Its effects then also act with a foreign plant."""
    plant: str | None
    plant_options: Mapping[str, Any]
    plant_trusted: bool = False
    """Whether the plant's code may run although others can change its file."""
    start: Place
    at_port: bool = False
    """Whether the vehicle is served at a port, in real time."""

    def place_after_reboot(self, pose: Sequence[float]) -> Place:
        """Return where a vehicle stands that is rebooted at `pose`.

        pose: position, velocity and attitude, (10,), as a plant gives them. A vehicle that stands upright in
        its flight volume stays there. Any other one has crashed: somebody puts it back to its start.
        """
        x, y = pose[0:2]
        q_w, q_x, q_y, q_z = pose[6:10]
        upright = 1.0 - 2.0 * (q_x * q_x + q_y * q_y) > _UPRIGHT
        (south, north), (west, east), _ = self.vehicle.limits.geofence_m
        if not (upright and south <= x <= north and west <= y <= east):
            return self.start
        yaw = math.atan2(2.0 * (q_w * q_z + q_x * q_y), 1.0 - 2.0 * (q_y * q_y + q_z * q_z))
        return Place((x, y, 0.0), yaw)
