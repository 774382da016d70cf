"""Where a session's time goes; run by hand: `TRIMTAB_ENGINE=vm python tests/sitl/profile_session.py`.

A session is plant, two processors, two radios, the air, the host's client and the flight log, in lock-step.
The figures are CPU time, so that other work on the machine shows little; the timers themselves are left out
of the total, which comes from a run without them.
"""

from __future__ import annotations

import importlib.util
import tempfile
import time
from pathlib import Path
from typing import Any

from host.link.flight import FlightOrder
from host.link.fly import fly_lockstep
from host.link.upload import upload_lockstep
from host.vehicle import load_vehicle
from sitl.vehicle import SimulatedVehicle

LAPS = 3


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


def main() -> None:
    """Nothing comes back; prints the table."""
    spent, ticks, _ = min(run(timed=False) for _ in range(3))
    _, _, parts = run(timed=True)
    for part, seconds in sorted(parts.items(), key=lambda item: -item[1]):
        print(f"{part:32s} {1e6 * seconds / ticks:6.2f} us a tick")
    rest = spent - sum(parts.values())
    print(f"{'host client, log, clock loop':32s} {1e6 * rest / ticks:6.2f} us a tick")
    print(
        f"{'whole session':32s} {1e6 * spent / ticks:6.2f} us a tick, {1e-3 * ticks / spent:.1f} x real time"
    )


if __name__ == "__main__":
    main()
