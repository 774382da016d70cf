"""The references of section VI-B: four paths of twenty waypoints at four paces, and three faster paths.

The paper prints statistics of its references, no waypoints, room or decay rates. Room, legs and paces are
chosen for means and standard deviations near the paper's.
"""

from __future__ import annotations

import numpy as np

from trimtab.host.apps.paper.chance import number
from trimtab.host.apps.paper.paths import Course, Room, draw_path
from trimtab.host.vehicle import Vehicle

ROOM = Room(
    box_m=(3.5, 3.5, 1.2), middle_ned=(0.0, 0.0, -1.6), leg_m=(1.2, 2.5), turn_deg=60.0, duration_s=15.0
)
PACES = (1.25, 0.92, 0.7, 0.5)
"""Decay rates of the trajectory's time: each path's four flights take 12 to 30 s."""
OOD_ROOM = Room(
    box_m=(4.5, 4.5, 1.2), middle_ned=(0.0, 0.0, -1.6), leg_m=(1.8, 3.4), turn_deg=60.0, duration_s=15.0
)
OOD_PACES = (1.15, 0.95, 0.7)
"""Of the three paths out of distribution, whose legs are longer."""
PATHS = 4


def draw_courses(vehicle: Vehicle, seed: int) -> list[Course]:
    """Return the paths in distribution at every pace, and those out of it.

    Raises ValueError if no drawn path may be flown by the vehicle.
    """
    rng = np.random.default_rng(seed)
    paces = dict(zip("abcd", PACES, strict=True))
    courses: list[Course] = []
    for k in range(PATHS):
        courses += draw_path(rng, vehicle, ROOM, f"path-{k}", paces, out_of_distribution=False)
    for k, pace in enumerate(OOD_PACES):
        courses += draw_path(rng, vehicle, OOD_ROOM, f"ood-{k}", {"": pace}, out_of_distribution=True)
    return courses


def draw(seed: int, purpose: str, world: int) -> int:
    """Return a number for a purpose in a world, from the study's seed."""
    return number(f"trimtab study paper-flight, {purpose} of world {world}, seed {seed}")
