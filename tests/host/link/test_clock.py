"""Clock comparison over links with delay, jitter and loss: the two least delays give the offset."""

from __future__ import annotations

import numpy as np
import pytest

from trimtab.host.link.clock import BUCKETS, CAMERA_AGREEING, CameraClock, ClockSync, LeastDelay


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


def test_clock_sync_one_message_a_tick_quicker_than_all_others_hardly_counts() -> None:
    clock = ClockSync()
    for k in range(200):
        exchange(clock, 97_000 * k, 500.0, 8000.0 if k == 50 else 9000.0, 9000.0)
    assert clock.offset_us == pytest.approx(500.0, abs=30.0)


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


@pytest.mark.parametrize("answers", [1, 5, 11, 19, 25])
def test_clock_sync_vehicle_that_boots_again_is_followed_however_few_answers_there_were(answers: int) -> None:
    rng = np.random.default_rng(answers)
    clock, offset_us = ClockSync(), 5e9
    for k in range(answers + 10):
        if k == answers:
            offset_us = -97_000.0 * k
        exchange(clock, 97_000 * k, offset_us, 4000.0 + 5000.0 * rng.random(), 4000.0 + 5000.0 * rng.random())
        assert clock.offset_us == pytest.approx(offset_us, abs=3000.0)
    assert clock.steps == 1


def test_clock_sync_answer_from_before_a_boot_does_not_last() -> None:
    clock = ClockSync()
    for k in range(40):
        exchange(clock, 97_000 * k, 5e9 if k < 20 or k == 22 else -2e6, 5000.0, 5000.0)
    assert clock.offset_us == pytest.approx(-2e6)


def test_clock_sync_absurd_answers_are_left_out() -> None:
    clock = ClockSync()
    clock.answer(1_000_000, 5, 900_000)
    clock.answer(0, 5, 60_000_000)
    assert clock.exchanges == 0
    assert clock.offset_us == 0.0
    assert not clock.settled


def poses(camera: CameraClock, first: int, count: int, *, shift_us: int = 0) -> list[bool]:
    """What becomes of poses 10 ms apart that arrive 4 to 4.5 ms late, from the host's `first` x 10 ms on."""
    return [
        camera.pose(10_000 * k + shift_us, 10_000 * k + 4_000 + (k * 37) % 500)
        for k in range(first, first + count)
    ]


WRONG_STAMPS = [2**64 - 1, 2**63 - 1, 62_000_000, 2_060_000, 1_990_000, 0]


@pytest.mark.parametrize("delay_us", [None, 4_000])
@pytest.mark.parametrize("stamp_us", WRONG_STAMPS)
def test_camera_clock_one_wrong_stamp_changes_nothing(delay_us: int | None, stamp_us: int) -> None:
    camera = CameraClock(delay_us)
    assert all(poses(camera, 0, 200))
    assert not camera.pose(stamp_us, 2_001_000)
    assert all(poses(camera, 200, 50))
    assert camera.offset_us == 0.0


@pytest.mark.parametrize("shift_us", [-60_000_000, -70_000, 70_000, 60_000_000, 2**61])
def test_camera_clock_that_was_set_is_followed(shift_us: int) -> None:
    camera = CameraClock(4_000)
    assert all(poses(camera, 6_000, 200))
    after = poses(camera, 6_200, 100, shift_us=shift_us)
    assert after == [False] * (CAMERA_AGREEING - 1) + [True] * (101 - CAMERA_AGREEING)
    assert camera.offset_us == pytest.approx(shift_us, abs=50)


def test_camera_clock_after_a_wrong_first_stamp_finds_the_right_ones() -> None:
    camera = CameraClock(4_000)
    assert camera.pose(3_600_000_000, 1_000)
    assert poses(camera, 1, 20)[CAMERA_AGREEING - 1 :] == [True] * (21 - CAMERA_AGREEING)
    assert camera.offset_us == pytest.approx(0.0, abs=50)


def test_camera_clock_on_the_hosts_own_time_is_never_set() -> None:
    camera = CameraClock(None)
    assert all(poses(camera, 0, 10))
    assert not any(poses(camera, 10, 50, shift_us=60_000_000))


def test_camera_clock_poses_that_come_twice_or_late_are_no_set_clock() -> None:
    camera = CameraClock(4_000)
    for k in range(100):
        assert camera.pose(10_000 * k, 10_000 * k + 4_000)
        assert not camera.pose(10_000 * k, 10_000 * k + 5_000)
    # A second's silence, then all of it at once: late, and as it was.
    late = [camera.pose(10_000 * k, 2_000_000 + k) for k in range(100, 200)]
    assert all(late)
    assert camera.offset_us == 0.0


def test_least_delay_forgets_what_is_too_old() -> None:
    least = LeastDelay()
    least.add(1.0, 0)
    for second in range(1, BUCKETS + 2):
        least.add(5.0, second * 1_000_000)
    assert least.value == 5.0
