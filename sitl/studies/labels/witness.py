"""Simulated vehicles that also record the true motion of the plant, for labels as the paper's.

The plant is recorded where it steps, so that a flight has the same bytes with and without the record.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np

from trimtab.host.apps.demo.flights import Airfield
from trimtab.host.log import Flight
from trimtab.host.log.prepare import Prepared
from trimtab.protocol.blobs import Reference
from trimtab.protocol.telemetry import TICK_US
from trimtab.sitl.plant import Plant
from trimtab.sitl.plant_model import STATE
from trimtab.sitl.vehicle import SimulatedVehicle

GRID_TICKS = 5
"""Ticks of a millisecond between two records."""

_AT = {block.name: sum(each.size for each in STATE[:k]) for k, block in enumerate(STATE)}
_ACCELERATION = slice(_AT["acceleration_ned"], _AT["acceleration_ned"] + 3)
_POSITION = slice(0, 3)
"""In `Plant.pose`: of the vehicle's origin, which the cameras see."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """True motion of a flight, NED, at times since power-up.

    `p`: of the origin, m. `a`: of the centre of mass, m/s^2, with everything that acts on it.
    """

    t_s: Annotated[np.ndarray, "samples"]
    p: Annotated[np.ndarray, "samples 3"]
    a: Annotated[np.ndarray, "samples 3"]

    def positions(self, t_s: Annotated[np.ndarray, "times"]) -> Annotated[np.ndarray, "times 3"]:
        """Return the positions at times, between records in a straight line."""
        return self._at(t_s, self.p)

    def accelerations(self, t_s: Annotated[np.ndarray, "times"]) -> Annotated[np.ndarray, "times 3"]:
        """Return the accelerations at times, between records in a straight line."""
        return self._at(t_s, self.a)

    def _at(self, t_s: np.ndarray, rows: np.ndarray) -> np.ndarray:
        if t_s[0] < self.t_s[0] or t_s[-1] > self.t_s[-1]:
            raise ValueError(
                f"times {t_s[0]:.3f} to {t_s[-1]:.3f} s, recorded {self.t_s[0]:.3f} to {self.t_s[-1]:.3f} s"
            )
        return np.column_stack([np.interp(t_s, self.t_s, column) for column in rows.T])


class RecordedPlant(Plant):
    """A plant that records its motion every GRID_TICKS ticks."""

    def reset(self, p_ned: Sequence[float], q_ned_frd: Sequence[float]) -> None:
        """Put the vehicle at rest at a pose, and forget what was recorded."""
        super().reset(p_ned, q_ned_frd)
        self._ticks = 0
        self._records: list[tuple[float, ...]] = []

    def step(self, motor_command: Sequence[float]) -> None:
        """Advance by one millisecond, and record where a record is due."""
        super().step(motor_command)
        self._ticks += 1
        if self._ticks % GRID_TICKS == 0:
            self._records.append((*self.pose[_POSITION], *self.state[_ACCELERATION]))

    def motion(self) -> Motion:
        """Return what was recorded since the reset."""
        rows = np.array(self._records).reshape(-1, 6)
        t_s = 1e-6 * TICK_US * GRID_TICKS * np.arange(1, len(rows) + 1)
        return Motion(t_s=t_s, p=rows[:, :3], a=rows[:, 3:])


class WitnessedVehicle(SimulatedVehicle):
    """A simulated vehicle whose plant records its motion. It has no foreign plant."""

    plant: RecordedPlant

    def _build_plant(self, flight: int) -> RecordedPlant:
        self.plant = RecordedPlant(self._setting.vehicle, self._setting.world, flight)
        return self.plant


@dataclass(frozen=True, kw_only=True)
class WitnessedField(Airfield):
    """A site of flights that keeps the vehicles it powered up, by flight index."""

    vehicles: dict[int, WitnessedVehicle] = field(default_factory=dict)

    def simulator(self) -> Any:
        """Return the class of the simulated vehicles."""
        return WitnessedVehicle

    def power_up(self, reference: Reference, flight: int) -> WitnessedVehicle:
        """Return a simulated vehicle below the reference's first node, and keep it."""
        self.vehicles[flight] = super().power_up(reference, flight)
        return self.vehicles[flight]


def vehicle_s(prepared: Prepared) -> Annotated[np.ndarray, "samples"]:
    """Return the times of a flight's samples since the vehicle's power-up, s.

    The log counts from arm on the host's clock, from which the vehicle's differs by an offset in the log.
    """
    flight: Flight = prepared.flight
    assert flight.link is not None  # a flight that was tracked has records of its link
    offset_us = int(flight.metadata["arm_host_us"]) + float(flight.link.clock_offset_us[-1])
    return prepared.at_s + 1e-6 * offset_us
