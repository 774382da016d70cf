"""Ways to setpoints, whatever stream of them comes: within the bounds, and there in the end."""

from __future__ import annotations

import math
import random

import pytest

from trimtab.firmware_model.flight.braking import Brakes, Room
from trimtab.firmware_model.flight.setpoints import Bounds, PositionTarget, towards

BOUNDS = Bounds(
    room=Room((-10.0, -10.0, -5.0), (10.0, 10.0, -0.2)),
    speed=5.0,
    accel=4.0,
    brakes=Brakes(gentle=4.0, sideways=8.0, rising=7.0, sinking=8.0, tilt=1.7),
    yaw_rate=3.0,
    turn_rate=1.5,
)
EVERY_US = 50_000
AT_2_M = (0.0, 0.0, -2.0, *(0.0,) * 9)
NONE = (None, None, None)


def targets(rng: random.Random) -> dict[str, PositionTarget]:
    """One of each kind, some that lead out of the room."""

    def three(side: float, up: float) -> tuple[float, float, float]:
        return rng.uniform(-side, side), rng.uniform(-side, side), rng.uniform(-up, up)

    p = (*three(12.0, 0.0)[:2], -rng.uniform(-0.5, 6.0))
    return {
        "position": PositionTarget(p=p, v=NONE),
        "velocity": PositionTarget(p=NONE, v=three(6.0, 3.0)),
        "acceleration": PositionTarget(p=NONE, v=three(3.0, 2.0), a=three(5.0, 5.0)),
        "height": PositionTarget(p=(None, None, p[2]), v=(*three(6.0, 0.0)[:2], None)),
        "all": PositionTarget(p=p, v=three(4.0, 2.0), a=three(2.0, 2.0)),
    }


@pytest.mark.parametrize("seed", range(8))
def test_stream_of_any_setpoints_stays_within_its_bounds(seed: int) -> None:
    rng = random.Random(seed)
    state, yaw = (0.0, 0.0, -rng.uniform(0.5, 3.0), *(0.0,) * 9), (0.0, 0.0)
    for _ in range(12):
        target = rng.choice(list(targets(rng).values()))
        for _ in range(rng.choice((1, 3, 10, 30))):
            way, _ = towards(target, state, yaw, BOUNDS)
            for share in (2, 1):
                found = way.state_at(EVERY_US // share)
                assert BOUNDS.room.beyond(found) < 0.01
                assert math.hypot(*found[3:6]) < 1.2 * BOUNDS.speed
                assert max(math.hypot(*found[6:8]), abs(found[8])) < 1.3 * BOUNDS.accel
            state, yaw = found[:12], (found[12], found[13])


@pytest.mark.parametrize("seed", range(8))
def test_one_change_of_position_in_full_flight_leads_there(seed: int) -> None:
    rng = random.Random(1000 + seed)
    first, second = (targets(rng)["position"] for _ in range(2))
    way, _ = towards(first, (0.0, 0.0, -2.0, *(0.0,) * 9), (0.0, 0.0), BOUNDS)
    state = way.state_at(round(1e6 * rng.uniform(0.2, 2.0)))
    way, _ = towards(second, state[:12], (0.0, 0.0), BOUNDS)
    asked = [min(max(x or 0.0, a), b) for x, a, b in zip(second.p, *BOUNDS.room, strict=True)]
    assert way.state_at(20_000_000)[:3] == pytest.approx(asked)
    lowest = max(way.state_at(10_000 * k)[2] for k in range(1000))
    assert lowest < BOUNDS.room.high[2] + 0.01


@pytest.mark.parametrize(
    ("target", "state"),
    [
        (
            PositionTarget(p=(-0.6, -0.5, -0.5), v=(0.8, 1.9, 1.6), a=(-3.1, -4.0, -4.9)),
            (-0.3, 0.4, -1.1, -0.3, 0.1, 0.2, 0.1, -0.2, 0.7, 3.1, 3.3, -23.6),
        ),
        (  # it turns before the wall
            PositionTarget(p=(9.925, 0.0, -2.0), v=(-1.0, 0.0, 0.0), a=(4.0, 0.0, 0.0)),
            (9.925, 0.0, -2.0, -1.0, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        ),
    ],
)
def test_sample_of_a_trajectory_that_speeds_up_towards_a_wall_stops_inside(target, state) -> None:
    way, _ = towards(target, state, (0.0, 0.0), BOUNDS)
    assert max(BOUNDS.room.beyond(way.state_at(20_000 * k)) for k in range(500)) < 0.06


@pytest.mark.parametrize(
    "velocity", [(3.0, 0.0, 0.0), (0.0, -2.0, 0.0), (0.0, 0.0, 1.5), (2.0, 3.0, -1.0), (0.1, 0.0, 0.0)]
)
def test_velocity_without_a_newer_setpoint_stops_at_the_wall(velocity: tuple[float, float, float]) -> None:
    way, _ = towards(PositionTarget(p=NONE, v=velocity), AT_2_M, (0.0, 0.0), BOUNDS)
    states = [way.state_at(20_000 * k) for k in range(8_000)]
    assert max(BOUNDS.room.beyond(state) for state in states) < 0.01
    assert states[-1][3:6] == pytest.approx((0.0, 0.0, 0.0), abs=1e-4)
    walls = [
        x if not v else (high if v > 0.0 else low)
        for v, x, low, high in zip(velocity, AT_2_M, *BOUNDS.room, strict=False)
    ]
    assert states[-1][:3] == pytest.approx(walls, abs=0.02)
