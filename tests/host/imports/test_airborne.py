"""When a vehicle was in the air, with and without a ground in the log."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from trimtab.host.imports import ImportFormatError, Recording
from trimtab.host.imports.airborne import EDGE_US, UNSEEN_US, airborne

T_US = np.arange(0, 12_000_000, 10_000, dtype=np.int64)
T = T_US * 1e-6


def recording(height: np.ndarray, **changes: Any) -> Recording:
    noise = np.random.default_rng(1).normal(0.0, 1e-3, (len(height), 3))
    p = np.column_stack([np.zeros((len(height), 2)), -height]) + noise
    given: dict[str, Any] = {
        "source": "log",
        "pose_us": T_US,
        "p_ned": p,
        "q_ned_frd": np.tile([1.0, 0.0, 0.0, 0.0], (len(height), 1)),
        "unknown": (),
    }
    return Recording(**{**given, **changes})


def thrust(on: np.ndarray) -> dict[str, np.ndarray]:
    return {"input_us": T_US, "thrust_n": np.where(on, 0.3, 0.0)}


FLIGHT = np.interp(T, [0.0, 2.0, 3.0, 9.0, 10.0, 12.0], [0.05, 0.05, 1.05, 1.05, 0.05, 0.05])
IN_AIR = (2_150_000 + EDGE_US, 9_850_000 - EDGE_US)


@pytest.mark.parametrize("inputs", [{}, thrust((T > 1.5) & (T < 10.5))], ids=["poses only", "with thrust"])
def test_flight_from_the_floor_lasts_from_clear_to_clear(inputs: dict[str, Any]) -> None:
    (span,) = airborne(recording(FLIGHT, **inputs))
    assert span == pytest.approx(IN_AIR, abs=20_000)


def test_flight_over_a_landing_place_lower_than_the_start_is_found() -> None:
    low = np.interp(T, [0.0, 2.0, 3.0, 9.0, 10.0, 12.0], [0.4, 0.4, 1.2, 1.2, 0.0, 0.0])
    ((begin, end),) = airborne(recording(low, **thrust((T > 2.0) & (T < 10.0))))
    assert begin > 1_400_000
    assert end < 10_000_000


def test_one_stray_pose_below_the_floor_moves_nothing() -> None:
    stray = FLIGHT.copy()
    stray[700] = -3.0
    (span,) = airborne(recording(stray))
    assert span == pytest.approx(IN_AIR, abs=20_000)


@pytest.mark.parametrize(
    "height",
    [np.full(len(T), 1.0), 1.0 + 0.05 * np.sin(T), 2.0 + 1.5 * np.sin(2.0 * T)],
    ids=["hover", "nearly level", "up and down"],
)
def test_log_recorded_in_the_air_is_used_whole(height: np.ndarray) -> None:
    assert airborne(recording(height, **thrust(T >= 0.0))) == ((0, int(T_US[-1])),)


def test_level_flight_without_inputs_is_used_whole() -> None:
    found = recording(np.full(len(T), 1.0))
    found.p_ned[:, 0] += np.sin(T)
    assert airborne(found) == ((0, int(T_US[-1])),)


def test_moment_without_thrust_is_no_landing() -> None:
    on = (T > 1.5) & (T < 10.5) & ~((T > 5.0) & (T < 5.1))
    (span,) = airborne(recording(FLIGHT, **thrust(on)))
    assert span == pytest.approx(IN_AIR, abs=20_000)


def test_both_flights_of_a_log_are_taken_but_no_hop_between_them() -> None:
    height = np.interp(
        T,
        [0.0, 0.5, 1.0, 4.5, 5.0, 5.5, 6.0, 6.5, 7.0, 7.5, 11.0, 11.5],
        [0, 0, 1, 1, 0, 0, 1, 0, 0, 1, 1, 0],
    )
    (first, second) = airborne(recording(height))
    assert first == pytest.approx((575_000 + EDGE_US, 4_925_000 - EDGE_US), abs=20_000)
    assert second == pytest.approx((7_075_000 + EDGE_US, 11_425_000 - EDGE_US), abs=20_000)


@pytest.mark.parametrize(
    ("height", "inputs", "said"),
    [
        (np.full(len(T), 0.05), {}, "but 2 s are needed; import a longer flight"),
        (np.full(len(T), 0.05), thrust(T < 0.0), "the motors never run"),
        (np.interp(T, [0.0, 2.0, 2.5, 3.0], [0.0, 0.0, 1.0, 0.0]), {}, "but 2 s are needed"),
        (np.interp(T, [0.0, 2.0, 3.0, 9.0, 10.0], [0.0, 0.0, 1.0, 1.0, 0.0]), thrust(T < 0.0), "never run"),
    ],
    ids=["stands", "stands, motors off", "a hop", "carried by hand"],
)
def test_log_that_hardly_flew_is_refused(height: np.ndarray, inputs: dict[str, Any], said: str) -> None:
    with pytest.raises(ImportFormatError, match=said):
        airborne(recording(height, **inputs))


@pytest.mark.parametrize("jump_us", [UNSEEN_US + 1, 10**15])
def test_flight_ends_where_the_clock_jumps(jump_us: int) -> None:
    t_us = T_US + np.where(T > 7.0, jump_us, 0)
    moving = recording(1.0 + 0.3 * np.sin(3.0 * T), pose_us=t_us)
    (span,) = airborne(moving)
    assert span == pytest.approx((0, 7_000_000 - EDGE_US), abs=20_000)
