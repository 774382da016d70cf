"""`python -m trimtab.sitl.studies.envelope`: fly the grids and print the worst of each figure."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import product

from trimtab.sitl.studies.envelope.grid import Outcome, fly_attitude, fly_blind, fly_velocity

WORLDS = ("empty", "draughty", "rich")
HEIGHTS_M = (0.5, 1.0, 3.0, 6.0)
THRUSTS, TILTS_DEG, STREAMS_S = (0.0, 0.2, 0.5, 0.9, 1.0), (0.0, 30.0, 60.0), (0.1, 0.4, 1.0, 5.0)
VELOCITIES = ((4.0, 0.0, 0.0), (0.0, -6.0, 0.0), (0.0, 0.0, 2.5), (3.0, -3.0, 1.0), (0.0, 0.0, -3.0))
TIMEOUTS_S = (0.2, 2.0, 5.0, 60.0)
BLIND_HEIGHTS_M = (0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
BLIND_VELOCITIES = ((0.0, 0.0, 0.0), (3.0, 0.0, 0.0), (0.0, 0.0, -2.0), (0.0, 0.0, 1.5))
VEHICLES, BLIND_SEEDS = ("research", "nano"), range(20, 22)


def main() -> None:
    """Fly the grids in two processes and print a table."""
    attitude = [
        partial(fly_attitude, world, height_m=height, thrust=thrust, tilt_deg=tilt, stream_s=stream)
        for world, height, thrust, tilt, stream in product(WORLDS, HEIGHTS_M, THRUSTS, TILTS_DEG, STREAMS_S)
    ]
    velocity = [
        partial(fly_velocity, world, height_m=height, velocity=v, stream_s=1.0, offboard_s=timeout)
        for world, height, v, timeout in product(WORLDS, (1.0, 3.0), VELOCITIES, TIMEOUTS_S)
    ]
    blind = [
        partial(fly_blind, world, height_m=height, velocity=v, world_seed=seed, vehicle=vehicle)
        for world, height, v, seed, vehicle in product(
            WORLDS, BLIND_HEIGHTS_M, BLIND_VELOCITIES, BLIND_SEEDS, VEHICLES
        )
    ]
    for name, flights in (("attitude", attitude), ("velocity", velocity), ("blind", blind)):
        with ProcessPoolExecutor(2) as pool:
            outcomes = list(pool.map(_fly, flights, chunksize=4))
        print(
            f"{name}: {len(outcomes)} flights; at most {max(each.above_m for each in outcomes):.2f} m above "
            f"the ceiling, {max(each.past_m for each in outcomes):.2f} m past a wall; impact "
            f"{max(each.impact_m_s for each in outcomes):.2f} m/s; motors off at "
            f"{max(each.motors_off_m for each in outcomes):.2f} m; "
            f"on the floor after {_longest_s(outcomes)} s"
        )


def _fly(flight: Callable[[], Outcome]) -> Outcome:
    return flight()


def _longest_s(outcomes: list[Outcome]) -> str:
    times = [each.down_s for each in outcomes]
    return "more than 120" if None in times else f"{max(each for each in times if each is not None):.1f}"


if __name__ == "__main__":
    main()
