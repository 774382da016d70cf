"""Bins of whole flights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.narrowing import not_none
from trimtab.host.log import read_flight
from trimtab.host.trace.data.signals import FlightData, states_of
from trimtab.host.trace.flight_fit.recording import (
    FLIGHT_BIN_S,
    Recording,
    bins_of_times,
    limited_share,
    record,
)

A1 = Path(__file__).parents[3] / "data" / "a1.mcap"
ABOUT = 3
"""Bins before and after a limited integral that are not compared either."""


def test_time_just_before_the_end_of_a_flight_is_in_its_last_bin() -> None:
    for bins in range(1, 3000):
        last_s = np.nextafter(bins * FLIGHT_BIN_S, 0.0)
        assert bins_of_times(np.array([0.0, last_s]), bins).tolist() == [0, bins - 1]


def test_times_are_in_the_bin_that_holds_them() -> None:
    t_s = np.array([0.0, 0.039, 0.041, 0.1])
    assert bins_of_times(t_s, 10).tolist() == [0, 0, 1, 2]


def recorded(integral: Sequence[float] = ()) -> Recording:
    """Return the recording of a flight with this rate integral, the same about x and y, in its first bins."""
    flight = read_flight(A1)
    control = not_none(flight.control)
    data = FlightData.of(flight)
    rate_integral = np.zeros_like(control.rate_integral)
    start = data.signals.span_s[0]
    bins = ((control.sensed_us[:, 1] * 1e-6 - start) / FLIGHT_BIN_S).astype(int)
    for frame, index in enumerate(bins):
        if 0 <= index < len(integral):
            rate_integral[frame, :2] = integral[index]
    flight = replace(flight, control=replace(control, rate_integral=rate_integral))
    data = FlightData.of(flight)
    return record(data, states_of([data], 0.0)[0])


@pytest.mark.parametrize(
    ("levels", "limited"),
    [
        pytest.param([0.0] * 60, (0, 0), id="far-from-the-limit"),
        pytest.param([39.0] * 60, (0, 0), id="near-it"),
        pytest.param([40.0] * 60 + [39.9] * 60, (0, 0), id="at-it-all-the-time"),
        pytest.param([0.0] * 30 + [40.0] * 30, (30, 60), id="reaches-and-leaves-it"),
        pytest.param([0.0] * 30 + [-40.0] * 30, (30, 60), id="of-either-sign"),
    ],
)
def test_bins_about_a_limited_rate_integral_are_not_compared(
    levels: list[float], limited: tuple[int, int]
) -> None:
    whole = recorded().known
    always = limited == (0, 0)
    levels = levels + [levels[-1] if always else 0.0] * (len(whole) - len(levels))
    first, end = limited
    left_out = set() if always else set(range(first - ABOUT, end + ABOUT))
    found = recorded(levels).known
    assert set(np.flatnonzero(whole & ~found).tolist()) == left_out & set(np.flatnonzero(whole).tolist())
    assert not (found & ~whole).any()


@pytest.mark.parametrize(
    ("levels", "share"),
    [
        pytest.param([39.0, 0.0], 0.0, id="inside-its-limits"),
        pytest.param([40.0, 0.0], 0.5, id="at-the-limit-half-the-time"),
        pytest.param([40.0, -40.0], 0.0, id="at-it-all-the-time"),
    ],
)
def test_share_of_the_tracking_time_with_a_limited_rate_integral(levels: list[float], share: float) -> None:
    flight = read_flight(A1)
    control = not_none(flight.control)
    start, end = FlightData.of(flight).signals.span_s
    early = control.sensed_us[:, 1] * 1e-6 < 0.5 * (start + end)
    integral = np.zeros_like(control.rate_integral)
    integral[:, 1] = np.where(early, *levels)
    flight = replace(flight, control=replace(control, rate_integral=integral))
    assert limited_share(FlightData.of(flight)) == pytest.approx(share, abs=0.02)
    assert limited_share(FlightData.of(replace(flight, control=None))) == 0.0
