"""Elapsed and remaining time, on a clock of the test."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from trimtab.host.base import progress
from trimtab.host.base.progress import Progress, WorkTimes

QUARTER = 0.25


class Clock:
    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


def ratios(
    pieces_s: Sequence[float], *, setup_s: float = 0.0, found: int = 0, workers: int = 1
) -> list[float]:
    """Shown over true remaining time, from a quarter of the work on, halfway to each next count too.

    The pieces take `pieces_s` after `setup_s`, beside `found` that an earlier run left; `workers` at a time.
    """
    clock = Clock()
    times = WorkTimes(None, clock)
    total = found + len(pieces_s)
    clock.now_s += setup_s
    times.count(found, total)
    rounds = [pieces_s[k : k + workers] for k in range(0, len(pieces_s), workers)]
    left_s, done, shown = sum(max(each) for each in rounds), 0, []
    for each in rounds:
        for part in (0.5, 0.5):
            if left_s > 0.0 and done >= QUARTER * len(pieces_s):
                assert times.remaining_s is not None
                shown.append(times.remaining_s / left_s)
            clock.now_s += part * max(each)
            left_s -= part * max(each)
        for _ in each:
            done += 1
            times.count(found + done, total)
    assert times.remaining_s == pytest.approx(0.0)
    assert times.elapsed_s == pytest.approx(setup_s + sum(max(each) for each in rounds))
    return shown


@pytest.mark.parametrize(
    ("pieces_s", "more"),
    [
        pytest.param([2.0] * 20, {}, id="even"),
        pytest.param([2.0] * 20, {"setup_s": 100.0}, id="after a long preparation"),
        pytest.param([2.0] * 20, {"found": 80}, id="resumed"),
        pytest.param([2.0] * 32, {"workers": 8}, id="by eight workers"),
        pytest.param([1.0, 3.0] * 10, {}, id="short and long in turn"),
        pytest.param([0.5, 0.5, 8.0] * 8, {}, id="one in three much longer"),
        pytest.param([1.0 + 0.04 * k for k in range(40)], {}, id="slower and slower"),
        pytest.param([2.4 - 0.03 * k for k in range(40)], {}, id="faster and faster"),
    ],
)
def test_remaining_time_is_right_within_a_factor_of_two_after_a_quarter(
    pieces_s: Sequence[float], more: dict[str, float]
) -> None:
    shown = ratios(pieces_s, **more)  # type: ignore[arg-type]
    last = max(1, len(shown) // 10)  # the end of one piece is not known from the others
    assert all(0.5 <= ratio <= 2.0 for ratio in shown[:-last])


def test_remaining_time_of_uncounted_work_is_not_shown() -> None:
    clock = Clock()
    assert str(WorkTimes(None, clock)) == str(WorkTimes(8.0, clock)) == "0:00 elapsed"


def test_times_have_a_word_each() -> None:
    clock = Clock()
    times = WorkTimes(4.0, clock)
    clock.now_s += 65.0
    times.count(1.0)
    assert str(times) == "1:05 elapsed, 3:15 remaining"
    clock.now_s += 30.0
    assert str(times) == "1:35 elapsed, 2:45 remaining"
    clock.now_s += 7200.0
    assert str(times).startswith("2:01:35 elapsed")


def test_bar_shows_both_times_each_with_its_word(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Clock()
    monkeypatch.setattr(progress, "WorkTimes", lambda total: WorkTimes(total, clock))
    monkeypatch.setenv("FORCE_COLOR", "1")  # rich takes the captured stream for a terminal
    monkeypatch.setenv("COLUMNS", "120")
    with Progress("planning", total=4, enabled=True) as bar:
        clock.now_s += 65.0
        bar.advance(detail="min-snap")
    shown = capsys.readouterr().err
    assert "1:05 elapsed, 3:15 remaining" in shown
    assert "left" not in shown
