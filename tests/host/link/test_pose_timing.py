"""How late poses arrive, on clocks of the test."""

from __future__ import annotations

from trimtab.host.link.pose_timing import Arrivals, PoseTiming

CAMERA_AHEAD_US = 7_000_000


def test_pose_timing_counts_what_is_later_than_the_promptest() -> None:
    timing = PoseTiming()
    for number, delay_us in enumerate([4_000, 3_000, 9_000, 3_500, 43_000]):
        now_us = 10_000 * number + delay_us
        timing.pose(10_000 * number + CAMERA_AHEAD_US, now_us)
    assert timing.take() == Arrivals(5, 2, 40_000)
    assert timing.take() == Arrivals()


def test_pose_timing_begins_anew_after_a_clock_jumped() -> None:
    timing = PoseTiming()
    timing.pose(0, 3_000)
    timing.clear()
    timing.pose(10_000, 63_000)
    assert timing.take() == Arrivals(2, 0, 0)


def test_pose_timing_tells_of_lateness_while_it_lasts() -> None:
    lines: list[str] = []
    timing = PoseTiming(lines.append)
    for number in range(200):
        timing.pose(10_000 * number, 10_000 * number + 3_000 + 20_000 * (number % 2))
    assert timing.lateness.running
    (line,) = lines
    assert line.startswith("poses arrive up to 20 ms late: ")
