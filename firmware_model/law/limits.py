"""Airframe and limits that a reference is checked against."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from trimtab.firmware_model.law.allocation import allocation_matrix, invert4


@dataclass(frozen=True, kw_only=True)
class Airframe:
    """Mass, inertia and rotors, which determine the rotor thrusts along a reference.

    inertia_kg_m2: about x, y, z of FRD. allocation_inverse: 16 values, row-major, maps [T, tau] to rotor
    thrusts.
    """

    mass_kg: float
    inertia_kg_m2: tuple[float, float, float]
    allocation_inverse: tuple[float, ...]
    thrust_max_n: float

    def __post_init__(self) -> None:
        if len(self.inertia_kg_m2) != 3 or len(self.allocation_inverse) != 16:
            raise ValueError("an airframe has 3 moments of inertia and a 4 x 4 inverse allocation")
        for value in (self.mass_kg, self.thrust_max_n, *self.inertia_kg_m2):
            if not 0.0 < value < math.inf:
                raise ValueError(f"mass, inertia and greatest thrust must be positive, not {value!r}")


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of a reference.

    thrust_headroom: bounds of a rotor's thrust as shares of its greatest thrust. geofence_m: (low, high) of
    north, east and down. end_height_m: least height of both ends above the floor z = 0.
    """

    speed_max_m_s: float
    tilt_max_deg: float
    body_rate_max_rad_s: tuple[float, float, float]
    jerk_max_m_s3: float
    thrust_headroom: tuple[float, float]
    geofence_m: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
    end_height_m: float = 0.5

    def __post_init__(self) -> None:
        if len(self.body_rate_max_rad_s) != 3 or len(self.geofence_m) != 3:
            raise ValueError("limits have 3 body rates and 3 geofence intervals")
        for name, intervals in (("thrust share", (self.thrust_headroom,)), ("geofence", self.geofence_m)):
            for low, high in intervals:
                if not low < high:
                    raise ValueError(f"{name} {low:.6g} to {high:.6g} is not an interval")


def from_parameters(table: Mapping[str, float]) -> tuple[Airframe, Limits]:
    """Return airframe and limits from values of the protocol's parameter table, by name.

    Raises KeyError for a missing name and ValueError for inconsistent values.
    """
    rotors = ("ROTOR1", "ROTOR2", "ROTOR3", "ROTOR4")
    positions = [(table[f"{rotor}_X"], table[f"{rotor}_Y"]) for rotor in rotors]
    spins = [table[f"{rotor}_SPIN"] for rotor in rotors]
    airframe = Airframe(
        mass_kg=table["MASS"],
        inertia_kg_m2=(table["INERTIA_X"], table["INERTIA_Y"], table["INERTIA_Z"]),
        allocation_inverse=invert4(allocation_matrix(positions, spins, table["TORQUE_PER_N"])),
        thrust_max_n=table["THRUST_MAX"],
    )
    limits = Limits(
        speed_max_m_s=table["LIM_SPEED"],
        tilt_max_deg=table["LIM_TILT_DEG"],
        body_rate_max_rad_s=(table["LIM_RATE_X"], table["LIM_RATE_Y"], table["LIM_RATE_Z"]),
        jerk_max_m_s3=table["LIM_JERK"],
        thrust_headroom=(table["LIM_THR_LO"], table["LIM_THR_HI"]),
        geofence_m=(
            (table["FENCE_N_MIN"], table["FENCE_N_MAX"]),
            (table["FENCE_E_MIN"], table["FENCE_E_MAX"]),
            (table["FENCE_D_MIN"], table["FENCE_D_MAX"]),
        ),
        end_height_m=table["END_HEIGHT"],
    )
    return airframe, limits
