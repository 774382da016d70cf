"""Flights of a simulated vehicle, with the sealed truth beside their logs."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trimtab.host.base.artefacts import content_id, write_atomic
from trimtab.host.base.parts import PartFile
from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.fly import fly_lockstep
from trimtab.host.link.summary import FlightResult
from trimtab.host.link.vehicle import vehicle_class

TRUTH_SUFFIX = ".truth.json"


@dataclass(frozen=True, kw_only=True)
class Simulation:
    """What is simulated. No artefact but the sealed truth may hold any of it.

    world, plant_options: name or path; None for the default. plant: path.py:Class, in the world, if any.
    plant_trusted: whether the plant's code may run although others can change its file. realtime: whether it
    keeps to the wall clock.
    """

    world: str | Path | None
    world_seed: int
    plant: str | None
    plant_options: str | Path | None
    realtime: bool
    plant_trusted: bool = False

    @property
    def is_default(self) -> bool:
        """Whether no option chooses anything."""
        return not (self.world or self.world_seed or self.plant or self.plant_options or self.realtime)


def fly_simulated(
    request: FlightRequest,
    simulation: Simulation,
    flight: int,
    on_phase: Callable[[str], None],
    on_late: Callable[[str], None],
) -> FlightResult:
    """Fly a simulated vehicle from below the reference's first node. Write its truth beside the log.

    The request has the part of its log. Raises the same errors as `fly_lockstep`. The truth is written also
    then, if the log was.
    """
    assert request.log_part is not None
    first = request.reference.nodes_ned()[0].state
    world, options = simulation.world, simulation.plant_options
    simulated = vehicle_class().create(
        request.vehicle,
        world=None if world is None else str(world),
        world_seed=simulation.world_seed,
        flight=flight,
        plant=simulation.plant,
        plant_options=None if options is None else str(options),
        plant_trusted=simulation.plant_trusted,
        start_ned=(first[0], first[1], 0.0),
        start_yaw=request.reference.yaw_nodes()[0].yaw,
        key=None if request.key is None else request.key.key,
    )
    flown = simulated if request.autopilot is None else simulated.as_autopilot(request.autopilot.name)
    with closing(simulated):
        try:
            return fly_lockstep(
                request, flown, realtime=simulation.realtime, on_phase=on_phase, on_late=on_late
            )
        finally:
            write_truth(request.log_part, simulated.truth())


def write_truth(log: PartFile, truth: Mapping[str, Any]) -> None:
    """Write the sealed truth beside a log, with the log's id, if it was published. Only checks open it."""
    if log.published:
        record = {**truth, "log": content_id(log.content())}
        text = json.dumps(record, indent=2, sort_keys=True) + "\n"
        write_atomic(log.target.with_name(log.target.name + TRUTH_SUFFIX), text, force=True)
