"""Bins of whole flights."""

from __future__ import annotations

import numpy as np

from trimtab.host.trace.flight_fit.recording import FLIGHT_BIN_S, bins_of_times


def test_time_just_before_the_end_of_a_flight_is_in_its_last_bin() -> None:
    for bins in range(1, 3000):
        last_s = np.nextafter(bins * FLIGHT_BIN_S, 0.0)
        assert bins_of_times(np.array([0.0, last_s]), bins).tolist() == [0, bins - 1]


def test_times_are_in_the_bin_that_holds_them() -> None:
    t_s = np.array([0.0, 0.039, 0.041, 0.1])
    assert bins_of_times(t_s, 10).tolist() == [0, 0, 1, 2]
