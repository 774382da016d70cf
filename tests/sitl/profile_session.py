"""Where a session's time goes, without a compiler and with one; run by hand:
`python tests/sitl/profile_session.py`.

A session is plant, two processors, two radios, the air, the host's client and the flight log, in lock-step.
The figures are CPU time, each the least of ROUNDS runs that take turns, so that other work on the machine
shows little; the timers themselves are left out of the total, which comes from runs without them.
"""

from __future__ import annotations

import importlib.util
import os
import tempfile
import time
from pathlib import Path
from typing import Any

from trimtab.host.codegen import find_compiler
from trimtab.host.codegen.compiler import ENGINE_VARIABLE
from trimtab.host.link.flight import FlightOrder
from trimtab.host.link.fly import fly_lockstep
from trimtab.host.link.upload import upload_lockstep
from trimtab.host.vehicle import load_vehicle
from trimtab.sitl.vehicle import SimulatedVehicle

LAPS = 3
ROUNDS = 5
WHOLE = "whole session"
REST = "host client, log, clock loop"


def load_tools() -> Any:
    """The flights of this folder's conftest.py."""
    spec = importlib.util.spec_from_file_location("sitl_tools", Path(__file__).with_name("conftest.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    import sys

    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def run(*, timed: bool) -> tuple[float, int, dict[str, float]]:
    """CPU seconds, ticks and seconds by part of one logged flight."""
    vehicle = load_vehicle("research")
    reference = load_tools().figure_eight(vehicle, laps=LAPS)
    simulated = SimulatedVehicle.create(vehicle, world="empty", world_seed=1)
    upload_lockstep(reference, simulated)
    simulated.power_cycle(1)
    if timed:
        simulated.start_profile()
    with tempfile.TemporaryDirectory() as folder:
        order = FlightOrder(vehicle=vehicle, reference=reference, log_path=Path(folder) / "flight.mcap")
        begin = time.process_time()
        fly_lockstep(order, simulated)
        spent = time.process_time() - begin
    return spent, simulated.now_us // 1000, simulated.profile()


def measure() -> dict[str, dict[str, float]]:
    """Microseconds a tick by engine ("vm", "c" where there is a compiler) and part, `whole session` last."""
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
    """Nothing comes back; prints the table."""
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
