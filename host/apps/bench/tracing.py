"""Time of a trace: of a few flights, and of many."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

from trimtab.host.apps.demo.flights import Airfield
from trimtab.host.effects import load_effects
from trimtab.host.log import read_flight
from trimtab.host.plan import plan
from trimtab.host.route import load_route
from trimtab.host.trace.run import run
from trimtab.host.vehicle import Vehicle

ROUTES = ("pretzel", "figure-eight", "speed-sweep", "circuit")
WORLD = "paper-drag"


@dataclass(frozen=True, kw_only=True)
class Size:
    """Number of flights traced; many: 100, or 0 to leave them out."""

    few: int = 8
    many: int = 100

    @property
    def steps(self) -> int:
        """Number of calls of `on_progress`."""
        return 2 if self.many else 1


QUICK = Size(many=0)


def measure(
    vehicle: Vehicle,
    seed: int,
    on_progress: Callable[[str], None] = lambda step: None,
    *,
    size: Size | None = None,
) -> dict[str, Any]:
    """Return processor and wall time of a trace of a few flights, and wall time per log of many.

    The flights are simulated with seeds, on shipped routes in turn, in a sealed world with drag. A trace
    reads its logs and uses all cores. The few flights are traced twice and the second time counts, so that
    nothing is compiled in it. `on_progress` is called `size.steps` times, as each step begins.
    """
    size = size or Size()
    on_progress(f"trace of {size.few} flights")
    with tempfile.TemporaryDirectory(prefix="trimtab-bench-") as folder:
        logs = flown(vehicle, seed, Path(folder), range(size.few))
        traced(logs)
        cpu_s, wall_s = traced(logs)
        per_log = None
        if size.many:
            on_progress(f"trace of {size.many} logs")
            logs += flown(vehicle, seed, Path(folder), range(size.few, size.many))
            per_log = traced(logs)[1] / len(logs)
    return {"cpu_s": cpu_s, "wall_s": wall_s, "logs_100_per_log": per_log}


def flown(vehicle: Vehicle, seed: int, folder: Path, flights: Sequence[int]) -> list[Path]:
    """Return logs of the flights with these indices."""
    field = Airfield(
        vehicle=vehicle,
        world=WORLD,
        world_seed=seed,
        session={"seed": str(seed), "command": "trimtab bench"},
    )
    references = [plan(load_route(route), vehicle, kind="min-snap").reference for route in ROUTES]
    logs = [folder / f"flight-{flight}.mcap" for flight in flights]
    for flight, log in zip(flights, logs, strict=True):
        field.fly(references[flight % len(references)], flight, log)
    return logs


def traced(logs: Sequence[Path]) -> tuple[float, float]:
    """Return processor time and wall time, s, of a trace of the logs."""
    cpu_s, wall_s = process_time(), perf_counter()
    run([read_flight(log) for log in logs], (), load_effects())
    return process_time() - cpu_s, perf_counter() - wall_s
