"""Which logs hold the same flight."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from trimtab.host.log import (
    FLIGHT_TOPICS,
    Flight,
    LogWriter,
    Provenance,
    is_same_flight,
    log_parents,
    read_flight,
)
from trimtab.host.log.writer import Stamps
from trimtab.host.vehicle import Vehicle

Write = Callable[..., Flight]
SESSION = {"session_uid": "00000000000000a1", "arm_host_us": "5000000"}


@pytest.fixture
def write(tmp_path: Path, vehicle: Vehicle) -> Write:
    """Writes a flight of noisy poses at 100 Hz and reads it; poses before `first` are left out."""

    def make(
        name: str, *, session: dict[str, str], noise: int = 1, first: int = 0, east_m: float = 0.0
    ) -> Flight:
        path = tmp_path / f"{name}.mcap"
        poses = np.random.default_rng(noise).normal(size=(300, 3))
        poses[200:, 1] += east_m
        with LogWriter(path, Provenance(vehicle=vehicle, session=session), FLIGHT_TOPICS) as log:
            for k in range(first, len(poses)):
                t_us = 10_000 * k
                log.pose(Stamps(t_us + 4000, t_us, t_us), t_us, poses[k].tolist(), (1.0, 0.0, 0.0, 0.0))
        return read_flight(path)

    return make


def test_logs_of_equal_content_hold_the_same_flight(tmp_path: Path, log_path: Path) -> None:
    copy = read_flight(Path(shutil.copy(log_path, tmp_path / "copy.mcap")))
    assert is_same_flight(read_flight(log_path), copy)


def test_copies_with_other_metadata_or_fewer_poses_hold_the_same_flight(write: Write) -> None:
    one = write("one", session=SESSION)
    edited = write("edited", session={**SESSION, "command": "trimtab fly", "flight_index": "7"})
    shorter = write("shorter", session=SESSION, first=100)
    without_poses = write("bare", session=SESSION, first=300)
    for copy in (edited, shorter, without_poses):
        assert one.id != copy.id
        assert is_same_flight(one, copy)
        assert is_same_flight(copy, one)


def test_logs_of_other_sessions_or_arm_times_hold_different_flights(write: Write) -> None:
    one = write("one", session=SESSION)
    assert not is_same_flight(one, write("uid", session={**SESSION, "session_uid": "00000000000000a2"}))
    assert not is_same_flight(one, write("armed", session={**SESSION, "arm_host_us": "5000001"}))
    assert not is_same_flight(one, write("no-session", session={}))


def test_imports_of_one_source_hold_the_same_flight(write: Write) -> None:
    one = write("one", session={"source_id": "abc", "source_file": "a.csv"})
    renamed = write("renamed", session={"source_id": "abc", "source_file": "b.csv"})
    other_axes = write("axes", session={"source_id": "abc"}, east_m=1.0)
    for again in (renamed, other_axes):
        assert one.id != again.id
        assert is_same_flight(one, again)
    assert not is_same_flight(one, write("other", session={"source_id": "abd"}))
    assert not is_same_flight(one, write("bare", session={}))
    assert not is_same_flight(write("bare-1", session={}, noise=1), write("bare-2", session={}, noise=2))


def test_parents_of_a_model_are_the_logs_used_and_those_held_out(write: Write) -> None:
    one, two, three = (write(name, session={"source_id": name}) for name in ("a", "b", "c"))
    expected = {"log 0": one.id, "log 1": two.id, "held-out log 0": three.id}
    assert log_parents([one, two], [three]) == expected
    assert log_parents([one]) == {"log 0": one.id}


def test_simulated_flights_of_one_seed_that_part_in_the_air_are_different(write: Write) -> None:
    """They share session, time of arming and the poses until their references part."""
    assert not is_same_flight(write("one", session=SESSION), write("other", session=SESSION, east_m=0.1))
