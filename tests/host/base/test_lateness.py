"""What is said of time that runs late, on a clock of the test."""

from __future__ import annotations

import pytest

from trimtab.host.base.lateness import LATE_US, Lateness

STEP_US = 10_000


def told(late_ms: list[float]) -> tuple[list[str], Lateness]:
    """The lines about measurements 10 ms apart, and what measured."""
    lines: list[str] = []
    lateness = Lateness("poses arrive", "close other programs", lines.append)
    for number, late in enumerate(late_ms):
        lateness.add(1e3 * late, STEP_US * number)
    return lines, lateness


@pytest.mark.parametrize(
    "late_ms",
    [
        pytest.param([0.0] * 1000, id="in time"),
        pytest.param([1e-3 * LATE_US] * 1000, id="at the bound"),
        pytest.param(([20.0] + [0.0] * 99) * 10, id="now and then"),
        pytest.param([20.0] * 30 + [0.0] * 500, id="one short delay"),
        pytest.param([-50.0] * 1000, id="early"),
    ],
)
def test_lateness_of_an_idle_computer_is_not_told(late_ms: list[float]) -> None:
    lines, lateness = told(late_ms)
    assert lines == []
    assert not lateness.running


def test_lateness_that_comes_often_is_told_with_its_size_and_remedy() -> None:
    lines, lateness = told([0.0] * 100 + [0.0, 12.0] * 10)
    assert lines == ["poses arrive up to 12 ms late: close other programs"]
    assert lateness.running
    assert lateness.worst_us == 12_000


def test_one_long_delay_is_told_at_once() -> None:
    lines, _ = told([0.0, 51.0])
    assert lines == ["poses arrive up to 51 ms late: close other programs"]


def test_lateness_that_lasts_is_told_again_with_since_when_and_at_its_end() -> None:
    lines, lateness = told([0.0, 12.0] * 600 + [30.0] + [0.0] * 300)
    begin, *lasting, end = lines
    assert begin.startswith("poses arrive up to 12 ms late: ")
    assert lasting == [
        "poses arrive up to 12 ms late, for 5 s now",
        "poses arrive up to 12 ms late, for 10 s now",
    ]
    assert end == "poses arrive in time again, after 12.0 s of up to 30 ms late"
    assert not lateness.running


def test_lateness_measures_without_a_listener_and_past_one_that_raises() -> None:
    calls = []

    def broken(line: str) -> None:
        calls.append(line)
        raise OSError

    for listener in (None, broken):
        lateness = Lateness("poses arrive", "", listener)
        for number in range(2000):
            lateness.add(60_000.0 * (number % 2), STEP_US * number)
        assert lateness.running
    assert len(calls) == 1
