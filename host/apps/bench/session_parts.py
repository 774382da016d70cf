"""Time spent in the parts of a simulated session, with and without a compiler.

    python -m trimtab.host.apps.bench.session_parts

A session consists of plant, flight processor, two radios, channel, the host's client and the flight log, in
lock-step. The figures are CPU time, each the minimum of ROUNDS alternating runs, so that other work on the
machine has little influence. The total comes from runs without timers.
"""

from __future__ import annotations

import math
import os
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.interpolate import make_interp_spline

from trimtab.host.codegen import find_compiler
from trimtab.host.codegen.compiler import ENGINE_VARIABLE
from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.fly import fly_lockstep
from trimtab.host.link.upload import upload_lockstep
from trimtab.host.link.vehicle import vehicle_class
from trimtab.host.vehicle import Vehicle, load_vehicle
from trimtab.protocol.blobs import Node, Reference

LAPS = 3
ROUNDS = 5
WHOLE = "whole session"
REST = "host client, log, clock loop"


def figure_eight(
    vehicle: Vehicle, *, size_m: float = 2.4, omega: float = 1.35, height_m: float = 1.2, laps: int = 1
) -> Reference:
    """Return a lemniscate that starts and ends smoothly at rest, with a node every 0.1 s."""
    ramp = 2.0
    duration = round((laps * 2 * math.pi / omega + ramp) * 10) / 10
    t = np.linspace(0.0, duration, 201)
    fine = np.linspace(0.0, duration, 20_001)
    x = np.clip(np.minimum(fine, duration - fine) / ramp, 0.0, 1.0)
    rate = x**5 * (126 - 420 * x + 540 * x**2 - 315 * x**3 + 70 * x**4)
    phase = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]))])[::100]
    phase *= laps * 2 * math.pi / phase[-1]
    path = np.stack(
        [
            size_m * np.sin(phase),
            0.5 * size_m * np.sin(2 * phase),
            -height_m - 0.08 * size_m * (1 - np.cos(phase)),
        ],
        axis=1,
    )
    spline = make_interp_spline(t, path, k=9)
    times = np.arange(0.0, duration + 1e-9, 0.1)
    rows = np.hstack([spline(times, k) for k in range(4)])
    rows[0, 3:] = rows[-1, 3:] = 0.0
    nodes = [Node(round(s * 1e6), tuple(map(float, row))) for s, row in zip(times, rows, strict=True)]
    return Reference(vehicle_id=vehicle.id, origin_ned=(0.0, 0.0, 0.0), nodes=tuple(nodes))


def run(*, timed: bool) -> tuple[float, int, dict[str, float]]:
    """Fly once with a log and return CPU seconds, ticks, and seconds by part (empty unless timed)."""
    vehicle = load_vehicle("research")
    reference = figure_eight(vehicle, laps=LAPS)
    simulated = vehicle_class().create(vehicle, world="empty", world_seed=1)
    upload_lockstep(reference, simulated)
    simulated.power_cycle(1)
    if timed:
        simulated.start_profile()
    with tempfile.TemporaryDirectory() as folder:
        request = FlightRequest(vehicle=vehicle, reference=reference, log_path=Path(folder) / "flight.mcap")
        begin = time.process_time()
        fly_lockstep(request, simulated)
        spent = time.process_time() - begin
    return spent, simulated.now_us // 1000, simulated.profile()


def measure() -> dict[str, dict[str, float]]:
    """Return microseconds a tick by engine ("vm", and "c" where there is a compiler) and part."""
    engines = ["vm", "c"] if find_compiler() else ["vm"]
    found: dict[str, dict[str, float]] = {engine: {} for engine in engines}
    for _ in range(ROUNDS):
        for engine, least in found.items():
            os.environ[ENGINE_VARIABLE] = engine
            spent, ticks, _ = run(timed=False)
            _, _, parts = run(timed=True)
            for part, seconds in (*parts.items(), (WHOLE, spent)):
                least[part] = min(least.get(part, float("inf")), 1e6 * seconds / ticks)
    return found


def main() -> None:
    """Print the table."""
    found = measure()
    for column in found.values():
        whole = column.pop(WHOLE)
        column[REST] = whole - sum(column.values())
        column[WHOLE] = whole
        column["times real time"] = 1000.0 / whole
    print(f"{'us of CPU time a tick':32s}" + "".join(f"{engine:>8s}" for engine in found))
    for part in next(iter(found.values())):
        print(f"{part:32s}" + "".join(f"{column[part]:8.1f}" for column in found.values()))


if __name__ == "__main__":
    main()
