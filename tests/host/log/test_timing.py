"""How a log tells of real time that ran late."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from trimtab.host.log import FLIGHT_TOPICS, Flight, LogWriter, Provenance, read_flight
from trimtab.host.log.export import csv_tables, file_name
from trimtab.host.log.link_report import to_lines
from trimtab.host.log.topics import HOST_TIMING, TIMING_TOPICS
from trimtab.host.log.writer import Stamps
from trimtab.protocol.generated import flight_pb2
from trimtab.protocol.generated.timing_pb2 import Timing

ARM_US = 5_000_000
CAMERA_US = 3_000_000
"""Clock of cameras and vehicle at arming."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A second of poses. The clock of cameras and vehicle stands still for `stop_us` in its middle."""

    timed: bool = True
    stop_us: int = 0
    wrong_us: int = 0
    """By how much the stamps that the vehicle was told are wrong after that, for a tenth of a second."""


@pytest.fixture
def flown(tmp_path: Path, provenance: Provenance) -> Callable[[Case], Flight]:
    """Return the flight of a case."""

    def write(case: Case) -> Flight:
        path = tmp_path / "a.mcap"
        channels = FLIGHT_TOPICS + (TIMING_TOPICS if case.timed else ())
        with LogWriter(path, provenance, channels) as log:
            for ms in range(0, 1000, 10):
                stopped_us = case.stop_us * (ms >= 500)
                host_us, source_us = 1000 * ms + stopped_us, CAMERA_US + 1000 * ms
                wrong_us = case.wrong_us * (500 <= ms < 600)
                stamps = Stamps(host_us + 4000, host_us, source_us)
                log.pose(stamps, source_us + wrong_us, (0.0, 0.0, -1.0), (1.0, 0.0, 0.0, 0.0))
                if ms % 100 == 0:
                    offset_us = CAMERA_US - ARM_US - stopped_us
                    link = flight_pb2.Link(clock_offset_us=offset_us, camera_offset_us=offset_us)
                    log.write("/link", link, host_us, host_us)
                    if case.timed:
                        late = ms in (300, 400)
                        message = Timing(
                            poses=10,
                            late_poses=3 * late,
                            pose_late_us=8000,
                            runs_late=late,
                            clock_steps=4 + (ms >= 500),
                        )
                        log.write(HOST_TIMING, message, host_us, host_us)
        return read_flight(path)

    return write


def test_timing_is_read_back_and_summarised(flown: Callable[[Case], Flight]) -> None:
    flight = flown(Case())
    assert flight.timing is not None
    assert flight.timing.runs_late.sum() == 2
    link = flight.to_dict()["link"]
    assert (round(link["late_s"], 9), link["poses_late"], link["pose_late_ms_max"], link["clock_steps"]) == (
        0.2,
        6,
        8.0,
        1,
    )
    lines = to_lines(link)
    assert "time ran late for 0.2 s: poses arrived up to 8 ms late" in lines
    assert "the vehicle's clock jumped against the host's: 1 times" in lines


def test_log_without_timing_reads_as_before(flown: Callable[[Case], Flight]) -> None:
    flight = flown(Case(timed=False))
    link = flight.to_dict()["link"]
    assert flight.timing is None
    assert link["late_s"] is link["poses_late"] is link["pose_late_ms_max"] is link["clock_steps"] is None
    assert not any("late" in line or "jumped" in line for line in to_lines(link))


def test_timing_can_be_exported(flown: Callable[[Case], Flight], tmp_path: Path) -> None:
    flown(Case())
    rows, text = csv_tables(tmp_path / "a.mcap")[file_name(HOST_TIMING)]
    assert rows == 10
    assert text.splitlines()[1] == "0,0,10,0,8000,False,4"


def test_poses_of_a_clock_that_stood_still_keep_the_vehicles_time(flown: Callable[[Case], Flight]) -> None:
    mocap = flown(Case(stop_us=30_000)).mocap
    assert mocap is not None
    assert mocap.forwarded_us is not None
    np.testing.assert_array_equal(mocap.forwarded_us, mocap.t_us)
    assert set(np.diff(mocap.t_us).tolist()) == {10_000}


def test_wrong_stamps_for_the_vehicle_show(flown: Callable[[Case], Flight]) -> None:
    mocap = flown(Case(wrong_us=6000)).mocap
    assert mocap is not None
    assert mocap.forwarded_us is not None
    assert (mocap.forwarded_us - mocap.t_us).tolist() == [0] * 50 + [6000] * 10 + [0] * 40


def test_lateness_is_that_over_the_promptest_pose_around(flown: Callable[[Case], Flight]) -> None:
    mocap = flown(Case(stop_us=30_000)).mocap
    assert mocap is not None
    assert mocap.late_us.min() == 0
    assert mocap.late_us.max() == 30_000
