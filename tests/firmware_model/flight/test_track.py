"""Tracks: continuity, limits and timing, by polynomials evaluated here and not by the law."""

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest

from trimtab.firmware_model.flight.braking import Brakes, Room, seconds_us
from trimtab.firmware_model.flight.track import Track, climb, hold, land, level_descent, stop, track

REST = (0.0,) * 9
WIDE = Room((-99.0, -99.0, -99.0), (99.0, 99.0, 99.0))
LAB = Room((-5.0, -5.0, -5.0), (5.0, 5.0, -0.2))


def septic(block: memoryview, s: float) -> list[np.ndarray]:
    """p, v, a, j at `s` seconds into the block: its polynomials, term by term."""
    coefficients = np.array(block[1:]).reshape(8, 3)
    return [
        sum((math.perm(k, order) * s ** (k - order) * coefficients[k] for k in range(order, 8)), np.zeros(3))
        for order in range(4)
    ]


def durations(t: Track):
    return [1e-6 * (end - start) for start, end in pairwise((*t.starts_us, t.end_us))]


def sampled(t: Track, count: int = 40) -> Iterator[list[np.ndarray]]:
    for block, duration in zip(t.blocks, durations(t), strict=True):
        for s in np.linspace(0.0, duration, count):
            yield septic(block, s)


def assert_pieces_join(t: Track):
    for (a, b), duration in zip(pairwise(t.blocks), durations(t), strict=False):
        np.testing.assert_allclose(septic(a, duration), septic(b, 0.0), atol=1e-10)
    np.testing.assert_allclose(septic(t.blocks[0], 0.0)[0], t.start_ned, atol=1e-12)
    np.testing.assert_allclose(septic(t.blocks[-1], durations(t)[-1])[0], t.end_ned, atol=1e-12)


def test_climb_straight_up_reaches_the_node_within_the_speed():
    t = climb((1.0, 2.0, 0.0), 0.1, (1.1, 2.0, -1.5), 0.1, speed=1.0, clear=0.5, hover_us=1_000_000)
    assert_pieces_join(t)
    assert len(t.blocks) == 2
    assert max(np.linalg.norm(v) for _, v, *_ in sampled(t)) == pytest.approx(1.0, rel=5e-3)
    p, v, *_ = septic(t.blocks[-1], 0.5)
    np.testing.assert_allclose(p, [1.1, 2.0, -1.5], atol=1e-12)
    np.testing.assert_allclose(v, 0.0, atol=1e-12)


def test_climb_to_a_far_node_goes_up_before_it_goes_aside():
    t = climb((0.0, 0.0, 0.0), 0.0, (3.0, 0.0, -1.0), 0.0, speed=1.0, clear=0.5, hover_us=1_000_000)
    assert_pieces_join(t)
    assert tuple(t.blocks[1][1:4]) == (0.0, 0.0, -1.0)
    assert tuple(t.blocks[2][1:4]) == (3.0, 0.0, -1.0)
    assert durations(t)[0] == pytest.approx(35 / 16, abs=1e-3)


def test_climb_turns_the_short_way_and_ends_at_the_yaw_of_the_reference():
    t = climb((0.0, 0.0, 0.0), -3.0, (0.0, 0.0, -1.0), 3.0, speed=1.0, clear=0.5, hover_us=1_000_000)
    assert (t.start_yaw, t.end_yaw) == (pytest.approx(2.0 * math.pi - 3.0), 3.0)
    assert t.yaw_blocks[0][1] == t.start_yaw
    assert tuple(t.yaw_blocks[-1]) == (0.0, 3.0, 0.0, 0.0, 0.0)


def test_hold_stays():
    t = hold((1.0, 2.0, -3.0), 0.4, 1_000_000)
    assert t.end_us == 1_000_000
    for p, v, *_ in sampled(t):
        np.testing.assert_allclose(p, [1.0, 2.0, -3.0])
        np.testing.assert_allclose(v, 0.0, atol=1e-12)


def brakes(gentle):
    """Decelerations of a stop, twice as hard as gentle at most."""
    return Brakes(gentle=gentle, sideways=2.0 * gentle, rising=7.0, sinking=2.0 * gentle, tilt=10.0)


def test_land_from_rest_goes_straight_down_through_the_floor():
    t = land((1.0, 2.0, -1.5, *REST), (0.3, 0.0), floor=0.0, speed=0.5, brakes=brakes(5.0), room=WIDE)
    assert_pieces_join(t)
    end, v, *_ = septic(t.blocks[-1], durations(t)[-1])
    np.testing.assert_allclose(end, [1.0, 2.0, 1.0], atol=1e-3)
    np.testing.assert_allclose(v, [0.0, 0.0, 0.5], atol=1e-9)
    heights = [p[2] for p, *_ in sampled(t)]
    assert heights == sorted(heights)


def test_land_at_speed_brakes_within_its_deceleration_first():
    state = (0.0, 0.0, -2.0, 5.0, 0.0, 0.0, *(0.0,) * 6)
    t = land(state, (0.0, 0.0), floor=0.0, speed=0.5, brakes=brakes(5.0), room=WIDE)
    assert_pieces_join(t)
    accelerations = [np.linalg.norm(a) for _, _, a, _ in sampled(t)]
    assert max(accelerations) == pytest.approx(5.0, rel=1e-2)
    ends = [septic(block, each) for block, each in zip(t.blocks[:3], durations(t)[:3], strict=True)]
    assert ends[2][0][0] == pytest.approx(5.0 * 5.0 / (2.0 * 5.0) + 5.0 * 0.3 / 2.0, rel=5e-3)
    np.testing.assert_allclose(ends[2][1], 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("height", "velocity", "acceleration"),
    [
        (1.5, (4.5, 0.0, 1.7), (0.0,) * 3),
        (2.2, (6.0, 0.0, 2.5), (2.0, 0.0, 1.0)),
        (1.0, (0, 0, 1), (0, 0, -6)),
    ],
)
def test_stop_out_of_a_dive_ends_above_the_floor(height, velocity, acceleration):
    state = (-4.5, 0.0, -height, *velocity, *acceleration, 0.0, 0.0, 0.0)
    t = stop(state, (0.0, 0.0), brakes=brakes(4.0), room=LAB)
    assert_pieces_join(t)
    assert max(p[2] for p, *_ in sampled(t)) <= -0.2
    np.testing.assert_allclose(list(sampled(t))[-1][1], 0.0, atol=1e-9)
    down = land(state, (0.0, 0.0), floor=0.0, speed=0.5, brakes=brakes(4.0), room=LAB)
    assert_pieces_join(down)
    assert down.blocks[0] == t.blocks[0]


def test_stop_towards_the_fence_brakes_harder_and_one_without_room_as_hard_as_it_may():
    def run(velocity):
        state = (0.0, 0.0, -2.0, velocity, 0.0, 0.0, *(0.0,) * 6)
        t = stop(state, (0.0, 0.0), brakes=brakes(4.0), room=LAB, hold_us=1_000_000)
        return t.end_ned[0], max(np.linalg.norm(a) for _, _, a, _ in sampled(t))

    assert run(4.0) == (pytest.approx(16.0 / 8.0 + 0.6, abs=0.01), pytest.approx(4.0, rel=0.01))
    assert run(6.0) == (pytest.approx(36.0 / 9.6 + 0.9, abs=0.01), pytest.approx(4.8, rel=0.01))
    assert run(9.0) == (pytest.approx(81.0 / 16.0 + 1.35, rel=0.02), pytest.approx(8.0, rel=0.01))


def descent(p, velocity, *, floor=0.0, speed=0.7, damped_us=12_000_000, end_us=15_000_000, room=LAB):
    return level_descent(
        (*p, *velocity, *(0.0,) * 6),
        0.2,
        floor=floor,
        speed=speed,
        brakes=brakes(4.0),
        room=room,
        damped_us=damped_us,
        end_us=end_us,
    )


def test_level_descent_is_smooth_down_to_the_open_loop_part():
    t = descent((0.0, 0.0, -2.0), (4.0, 0.0, -1.0), speed=0.8, damped_us=4_000_000, end_us=8_000_000)
    assert_pieces_join(t)
    assert t.end_us == 8_000_000
    states = list(sampled(t))
    assert max(np.linalg.norm(a) for _, _, a, _ in states) < 5.7
    _, v, a, _ = septic(t.blocks[-1], 1.0)
    np.testing.assert_allclose(a, [0.0, 0.0, 1.5], atol=1e-6)
    assert v[2] == pytest.approx(0.8 + 1.5 * 1.5, abs=1e-6)
    speeds = [v[2] for _, v, *_ in sampled(t) if v[0] < 1e-9]
    assert all(b >= a - 1e-9 for a, b in pairwise(speeds))


@pytest.mark.parametrize("velocity", [(0.0, 0.0, 0.0), (3.0, 0.0, -1.0), (0.0, 0.0, 1.5)])
@pytest.mark.parametrize("height", [2.5, 6.0, 12.0])
def test_level_descent_from_a_height_sinks_fast_and_is_slow_near_the_floor(height, velocity):
    room = Room((-9.0, -9.0, -20.0), (9.0, 9.0, 0.7))
    t = descent((0.0, 0.0, 1.0 - height), velocity, floor=1.0, room=room)
    assert_pieces_join(t)
    states = list(sampled(t))
    assert max(np.linalg.norm(a) for _, _, a, _ in states) < 5.7
    stopped = next(k for k, (_, v, *_) in enumerate(states) if np.linalg.norm(v) < 0.06)
    reached = max(v[2] for p, v, *_ in states[stopped:] if p[2] < 0.0)
    left = 1.0 - states[stopped][0][2]
    assert reached == pytest.approx(min(2.0, left - 1.35), abs=0.02)
    slow = [v[2] for p, v, a, _ in states if 0.8 < p[2] < 1.0]
    np.testing.assert_allclose(slow, 0.7, atol=1e-6)


def test_level_descent_from_a_fast_climb_stops_as_hard_as_the_room_needs():
    """A gentle stop from 7.5 m/s had led to a height of 15 m, below a ceiling at 6 m."""
    t = descent((0.0, 0.0, -1.0), (3.0, 3.0, -7.5))
    hardest = brakes(4.0).rising
    assert min(p[2] for p, *_ in sampled(t)) > -1.0 - 7.5**2 / (2.0 * hardest) - 0.7


def test_level_descent_that_is_too_short_to_sink_fast_is_slow_throughout():
    t = descent((0.0, 0.0, -6.0), (0.0, 0.0, 0.0), damped_us=1_000_000, end_us=4_000_000)
    assert max(float(v[2]) for _, v, a, _ in sampled(t) if a[2] < 1e-9) == pytest.approx(0.7, abs=1e-6)


def test_track_holds_yaw_outside_its_nodes():
    nodes = [(0, (0.0,) * 12), (1_000_000, (0.0,) * 12), (3_000_000, (0.0,) * 12)]
    t = track(nodes, [(500_000, 1.0, 0.2), (2_000_000, 2.0, -0.1)])
    assert t.yaw_starts_us == (0, 500_000, 2_000_000)
    first, middle, last = (tuple(block) for block in t.yaw_blocks)
    assert (first, last) == ((0.0, 1.0, 0.0, 0.0, 0.0), (0.0, 2.0, 0.0, 0.0, 0.0))
    assert np.polyval(middle[:0:-1], 1.5) == pytest.approx(2.0)
    assert middle[1:3] == (1.0, 0.2)


def test_track_with_pieces_out_of_order_raises():
    with pytest.raises(ValueError, match="increasing order"):
        track([(0, (0.0,) * 12), (0, (0.0,) * 12), (10, (0.0,) * 12)], [(0, 0.0, 0.0)])
    with pytest.raises(ValueError, match="at least two nodes"):
        track([(0, (0.0,) * 12)], [(0, 0.0, 0.0)])


@pytest.mark.parametrize(("seconds", "us"), [(1.0, 1_000_000), (0.0001, 1_000), (1.2341, 1_235_000)])
def test_seconds_us_rounds_up_to_a_tick(seconds, us):
    assert seconds_us(seconds) == us


@pytest.mark.parametrize(
    ("start", "end", "yaw", "rests"),
    [
        ({}, {}, [(0, 0.3, 0.0)], True),
        ({}, {}, [(0, 0.3, 0.0), (2_000_000, 1.0, 0.0)], True),
        ({3: 3.0}, {}, [(0, 0.3, 0.0)], False),
        ({}, {4: -0.1}, [(0, 0.3, 0.0)], False),
        ({8: 1.0}, {}, [(0, 0.3, 0.0)], False),
        ({}, {}, [(0, 0.3, 0.5), (2_000_000, 1.0, 0.0)], False),
        ({}, {}, [(0, 0.3, 0.0), (2_000_000, 1.0, 0.5)], False),
    ],
)
def test_track_says_whether_it_rests_at_both_ends(start, end, yaw, rests):
    a, b = [0.0, 0.0, -1.0, *REST], [1.0, 0.0, -1.0, *REST]
    for node, changes in ((a, start), (b, end)):
        for place, value in changes.items():
            node[place] = value
    assert track([(0, tuple(a)), (2_000_000, tuple(b))], yaw).ends_at_rest is rests


def test_track_that_ends_inside_a_yaw_piece_ends_at_the_yaw_reached_there():
    nodes = [(t_us, (0.0, 0.0, -1.0, *REST)) for t_us in (0, 2_000_000)]
    t = track(nodes, [(0, 0.0, 0.0), (4_000_000, 1.0, 0.0)])
    assert t.end_yaw == pytest.approx(0.5)  # half-way through a cubic from rest to rest
    assert not t.ends_at_rest
