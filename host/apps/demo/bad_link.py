"""Tracking error of the demo's routes over a bad link against a clean one.

    python -m trimtab.host.apps.demo.bad_link SEED...

Each demo seed gives three of its routes (one held out, two to learn from) and its world's seed. Each route
is flown over a link without loss, and over `bad-link` with bursts of five frames and with single losses.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from trimtab.host.apps.demo.plans import plan_first
from trimtab.host.apps.demo.routes import draw_routes
from trimtab.host.apps.demo.seeds import host_seed, world_seed
from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.fly import FlightEnded, fly_lockstep
from trimtab.host.link.summary import FlightResult
from trimtab.host.link.vehicle import vehicle_class
from trimtab.host.vehicle import Vehicle, load_vehicle
from trimtab.protocol.blobs import Reference

LINKS = {
    "clean": ("empty", {"loss": 0.0}),
    "bursts of 5": ("bad-link", {"burst_frames": 5.0}),
    "single": ("bad-link", {"burst_frames": 1.0}),
}


def fly(vehicle: Vehicle, reference: Reference, seed: int, link: str, log: Path) -> FlightResult:
    """Fly the reference over a link and return the result, also of a flight that ended early."""
    world, radio = LINKS[link]
    north, east = reference.nodes_ned()[0].state[:2]
    simulated = vehicle_class().create(
        vehicle,
        world=world,
        world_seed=world_seed(seed),
        radio=radio,
        start_ned=(north, east, 0.0),
        start_yaw=reference.yaw_nodes()[0].yaw,
    )
    try:
        request = FlightRequest(vehicle=vehicle, reference=reference, log_path=log, upload=True)
        return fly_lockstep(request, simulated)
    except FlightEnded as ended:
        return ended.result


def main(seeds: list[int]) -> None:
    """Print a row for each flight, and the ratios with their standard errors."""
    vehicle = load_vehicle("research")
    ratios: dict[str, list[float]] = {link: [] for link in LINKS}
    for seed in seeds:
        routes = draw_routes(host_seed(seed), vehicle.limits)
        for route in (routes.held_out[0], routes.learning[0], routes.learning[2]):
            reference = plan_first(route, vehicle).plan.reference
            clean_m = None
            for link in LINKS:
                with tempfile.TemporaryDirectory() as folder:
                    result = fly(vehicle, reference, seed, link, Path(folder) / "flight.mcap")
                error_m = result.tracking_rmse_m
                clean_m = error_m if link == "clean" else clean_m
                failsafe = None if result.end is None else result.end.failsafe
                print(seed, route.name, link, error_m, result.tracking_max_m, failsafe, flush=True)
                if error_m is not None and clean_m is not None:
                    ratios[link].append(error_m / clean_m)
    for link, values in ratios.items():
        spread = float(np.std(values, ddof=1)) if len(values) > 1 else float("nan")
        error = spread / len(values) ** 0.5
        print(f"{link}: {len(values)} flights, ratio {np.mean(values):.3f} +- {error:.3f}, ", end="")
        print(f"{min(values):.2f} to {max(values):.2f}")


if __name__ == "__main__":
    main([int(word) for word in sys.argv[1:]])
