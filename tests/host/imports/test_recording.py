"""What a recording may hold, times and repeated rows."""

from __future__ import annotations

from typing import Any, get_args

import numpy as np
import pytest

from trimtab.host.imports import ImportFormatError, Recording
from trimtab.host.imports.recording import Unknown, first_of_equal, fresh, since_first_us
from trimtab.host.trace.parameters import UNKNOWN as TRACED_AS_NUISANCE

T_US = np.arange(0, 50_000, 10_000, dtype=np.int64)


def recording(**changes: Any) -> Recording:
    given: dict[str, Any] = {
        "source": "log",
        "pose_us": T_US,
        "p_ned": np.zeros((5, 3)),
        "q_ned_frd": np.tile([1.0, 0.0, 0.0, 0.0], (5, 1)),
        "unknown": (),
    }
    return Recording(**{**given, **changes})


def test_everything_a_profile_may_leave_unknown_is_known_to_tracing() -> None:
    # Tracing adds "thrust" by itself for logs that hold no inputs at all.
    assert set(get_args(Unknown)) == set(TRACED_AS_NUISANCE) - {"thrust"}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"pose_us": T_US[::-1]}, "fewer than two different poses at increasing times"),
        ({"p_ned": np.full((5, 3), np.nan)}, "position is not finite at row 0"),
        (
            {"imu_us": T_US, "gyro": np.vstack([np.zeros((4, 3)), np.full(3, np.inf)])},
            "gyro is not finite at row 4",
        ),
        ({"battery_us": T_US[:1], "battery_v": np.ones(1)}, "fewer than two different battery voltages"),
        (
            {"input_us": T_US, "motor_command": np.full((5, 4), 47.0)},
            "values of zero and full command",
        ),
        ({"input_us": T_US, "motor_command": np.full((5, 4), -0.2)}, "from -0.2 to -0.2 of full"),
        ({"p_ned": np.full((5, 3), 2e6)}, "position reaches 2e+06; is its unit right?"),
        ({"mass_kg": 0.0}, "mass 0.0 kg"),
        ({"mass_kg": float("nan")}, "mass nan kg"),
    ],
)
def test_recording_that_cannot_be_true_is_refused(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(ImportFormatError) as caught:
        recording(**changes)
    assert said in str(caught.value)


@pytest.mark.parametrize(
    "changes",
    [
        {"unknown": ("weather",)},
        {"p_ned": np.zeros((4, 3))},
        {"gyro": np.zeros((5, 3))},
        {"input_us": T_US, "motor_command": np.zeros((5, 4)), "thrust_n": np.zeros(5)},
    ],
)
def test_recording_built_wrongly_is_the_readers_mistake(changes: dict[str, Any]) -> None:
    with pytest.raises(ValueError) as caught:  # noqa: PT011 (the type is the point)
        recording(**changes)
    assert not isinstance(caught.value, ImportFormatError)


def test_times_count_whole_microseconds_from_the_first() -> None:
    seconds = 1772660536.302306890 + np.array([0.0, 0.01, 0.02])
    assert np.abs(since_first_us(seconds, 1e6, "log") - [0, 10_000, 20_000]).max() <= 1
    assert since_first_us(np.array([7.0, 9.0]), 1000.0, "log").tolist() == [0, 2000]


@pytest.mark.parametrize(
    ("times", "said"),
    [
        ([0.0, 1.0, 0.5, 2.0], "decreases after row 1"),
        ([0.0, 1.0, 90_000.0], "longer than a day; check the unit"),
        ([0.0, 1e300, 1e301], "longer than a day"),
        ([-1e308, 1e308], "longer than a day"),
        ([0.0, 1e300, 1.0], "longer than a day"),
        ([1.0, 0.0], "decreases after row 0"),
    ],
)
def test_times_that_run_back_or_in_another_unit_are_refused(times: list[float], said: str) -> None:
    with pytest.raises(ImportFormatError, match=said):
        since_first_us(np.array(times), 1e6, "log")


def test_first_row_of_equal_times_is_kept() -> None:
    assert first_of_equal(np.array([0, 0, 5, 5, 5, 9])).tolist() == [True, False, True, False, False, True]


def test_row_repeated_to_the_bit_is_not_fresh() -> None:
    p = np.array([[1.0, 2.0], [1.0, 2.0], [1.0, 2.0], [1.5, 2.0], [1.0, 2.0]])
    q = np.array([[1.0], [1.0], [0.9], [0.9], [0.9]])
    assert fresh(p, q).tolist() == [True, False, True, True, True]
