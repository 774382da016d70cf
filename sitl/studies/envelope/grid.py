"""How far flights get that a careless client steers by attitude and velocity, or that lose their poses."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

from trimtab.firmware_model.flight.supervisor import State
from trimtab.host.vehicle import to_parameters
from trimtab.sitl.studies.envelope.watched import Sample, WatchedFlight, beyond, impacts

STREAM_US = 20_000
"""Interval of the setpoints."""
HOVER_S, MOVE_S = 2.0, 0.8
"""Times of hover and of motion before the poses are lost."""
LONGEST_S = 120.0
"""Time from the first setpoint after which a flight is given up."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a flight came to.

    above_m, past_m: greatest distance above the ceiling and past the walls; negative inside. impact_m_s:
    speed at the hardest touch of the floor. motors_off_m: greatest height at which the rotors stopped.
    down_s: time from the failsafe, or from the last setpoint without one, to the floor; None if it was not
    reached.
    failsafe: whether a failsafe ended the flight.
    """

    above_m: float
    past_m: float
    impact_m_s: float
    motors_off_m: float
    down_s: float | None
    failsafe: bool


def fly_attitude(world: str, *, height_m: float, thrust: float, tilt_deg: float, stream_s: float) -> Outcome:
    """Hover at a height, stream a thrust with a pitch for a time, and return the outcome.

    thrust: share of the greatest thrust.
    """
    flight = WatchedFlight(world)
    flight.hover(height_m)
    half = math.radians(tilt_deg) / 2.0
    q = (math.cos(half), 0.0, -math.sin(half), 0.0)
    return _streamed(flight, stream_s, lambda: flight.attitude(thrust, q))


def fly_velocity(
    world: str,
    *,
    height_m: float,
    velocity: tuple[float, float, float],
    stream_s: float,
    offboard_s: float,
) -> Outcome:
    """Hover, stream a velocity (m/s, NED) for a time under FS_OFFB_S, and return the outcome."""
    flight = WatchedFlight(world)
    flight.hover(height_m, FS_OFFB_S=offboard_s)
    return _streamed(flight, stream_s, lambda: flight.velocity(velocity))


def fly_blind(
    world: str,
    *,
    height_m: float,
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    world_seed: int = 0,
    vehicle: str = "research",
) -> Outcome:
    """Hover, follow a velocity (m/s, NED) for MOVE_S, lose the poses, and return the outcome."""
    flight = WatchedFlight(world, world_seed=world_seed, flight=world_seed + 1, vehicle=vehicle)
    flight.hover(height_m)
    flight.run(HOVER_S)
    if any(velocity):
        flight.velocity(velocity)
        flight.mode(6)
        for _ in range(round(1e6 * MOVE_S / STREAM_US)):
            flight.velocity(velocity)
            flight.run(1e-6 * STREAM_US)
    flight.cameras = False
    return _landed(flight, len(flight.samples), flight.now_us)


def _streamed(flight: WatchedFlight, stream_s: float, send: Callable[[], None]) -> Outcome:
    """Stream setpoints for a time, wait for the floor, and return the outcome."""
    start_us, first = flight.now_us, len(flight.samples)
    end_us = start_us + round(1e6 * stream_s)
    while flight.now_us < end_us and flight.samples[-1].state is not State.STANDBY:
        if (flight.now_us - start_us) % STREAM_US == 0:
            send()
            if flight.now_us == start_us:
                flight.mode(6)
        flight.step()
    return _landed(flight, first, end_us)


def _landed(flight: WatchedFlight, first: int, end_us: int) -> Outcome:
    """Wait for the floor, and return the outcome from the sample `first` on."""
    landed = flight.run_to(State.STANDBY, seconds=LONGEST_S)
    down_us = flight.now_us if landed else None
    flight.run(0.5)
    return _outcome(flight, flight.samples[first:], end_us, down_us)


def _outcome(flight: WatchedFlight, samples: list[Sample], end_us: int, down_us: int | None) -> Outcome:
    fence = to_parameters(flight.vehicle)
    distances = [beyond(sample, fence) for sample in samples]
    failsafe_us = next((each.t_us for each in samples if each.state is State.FAILSAFE), None)
    from_us = end_us if failsafe_us is None else failsafe_us
    return Outcome(
        above_m=max(above for above, _ in distances),
        past_m=max(past for _, past in distances),
        impact_m_s=max((math.hypot(*each.v) for each in impacts(samples)), default=0.0),
        motors_off_m=max(
            (b.height_m for a, b in pairwise(samples) if a.rotors_on and not b.rotors_on), default=0.0
        ),
        down_s=None if down_us is None else 1e-6 * (down_us - from_us),
        failsafe=failsafe_us is not None,
    )
