"""Clock comparison over links with delay, jitter and loss: the two least delays give the offset."""

from __future__ import annotations

import numpy as np
import pytest

from host.link.clock import BUCKETS, ClockSync, LeastDelay


def exchange(clock: ClockSync, now_us: int, offset_us: float, up_us: float, down_us: float) -> int:
    """One exchange begun at `now_us`; when its answer arrived."""
    arrived = round(now_us + up_us + down_us)
    clock.answer(now_us, round(now_us + up_us + offset_us), arrived)
    return arrived


@pytest.mark.parametrize("seed", range(5))
def test_clock_sync_over_jitter_is_within_a_tenth_of_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    clock = ClockSync()
    for k in range(100):
        up, down = 5000 + rng.uniform(0, 4000, 2)[0], 5000 + rng.uniform(0, 4000)
        exchange(clock, 100_000 * k, 1e9, up, down)
    assert clock.offset_us == pytest.approx(1e9, abs=200)
    assert clock.sd_us < 400
    assert 10_000 < clock.rtt_us < 18_000


def test_clock_sync_quick_ways_need_not_meet_in_one_exchange() -> None:
    clock = ClockSync()
    exchange(clock, 0, 500.0, 3000.0, 9000.0)
    exchange(clock, 100_000, 500.0, 9000.0, 3000.0)
    assert clock.offset_us == 500.0


def test_clock_sync_drift_is_followed() -> None:
    clock = ClockSync()
    for k in range(1200):
        exchange(clock, 100_000 * k, 50e-6 * 100_000 * k, 4000.0, 4000.0)
    # 50 ppm over half of the window of 30 s.
    assert clock.offset_us == pytest.approx(50e-6 * 120e6, abs=50e-6 * BUCKETS * 1e6)


@pytest.mark.parametrize("step_us", [-30_000.0, 30_000.0])
def test_clock_sync_begins_anew_where_the_other_clock_jumps(step_us: float) -> None:
    clock = ClockSync()
    for k in range(60):
        exchange(clock, 100_000 * k, 0.0 if k < 40 else step_us, 4000.0, 4000.0)
    assert clock.steps == 1
    assert clock.offset_us == pytest.approx(step_us)


def test_clock_sync_absurd_answers_are_left_out() -> None:
    clock = ClockSync()
    clock.answer(1_000_000, 5, 900_000)
    clock.answer(0, 5, 60_000_000)
    assert clock.exchanges == 0
    assert clock.offset_us == 0.0
    assert not clock.settled


def test_least_delay_forgets_what_is_too_old() -> None:
    least = LeastDelay()
    least.add(1.0, 0)
    for second in range(1, BUCKETS + 2):
        least.add(5.0, second * 1_000_000)
    assert least.value == 5.0
