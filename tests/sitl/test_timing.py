"""The flight processor's ticks: drawn as set, missed where work runs over, counted, told, flown through."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trimtab.host.vehicle import Vehicle, load_vehicle
from trimtab.protocol.messages import FcControl, FcEstimate, FcStatus
from trimtab.protocol.telemetry import IntervalDecoder
from trimtab.sitl.timing import TickTimes
from trimtab.sitl.vehicle import SimulatedVehicle
from trimtab.sitl.world import TimingSettings

TRACKING = 4


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("research")


def run(times: TickTimes, ticks: int) -> list[int]:
    """Times of the ticks missed, asked as a vehicle does."""
    return [t for t in range(0, ticks * 1000, 1000) if t >= times.due_us and times.missed(t)]


def test_ticks_take_and_vary_as_set() -> None:
    times = TickTimes(TimingSettings(work_us=300, work_spread_us=40, jitter_us=20), np.random.default_rng(1))
    assert run(times, 10_000) == []
    read = times.read(10_000_000)
    assert read.mean_us == pytest.approx(300, abs=2)
    assert 420 < read.longest_us < 500  # 3 to 5 sigma
    assert read.jitter_us == 20
    again = times.read(10_000_000)
    assert again == (0, 0, 0)


def test_reading_often_tells_the_same_as_reading_once() -> None:
    settings = TimingSettings(overrun=0.01)
    often, once = (TickTimes(settings, np.random.default_rng(2)) for _ in range(2))
    reads = []
    for t in range(0, 5_000_000, 1000):
        for times in (often, once):
            if t >= times.due_us:
                times.missed(t)
        if t % 70_000 == 0:
            reads.append(often.read(t))
    reads.append(often.read(5_000_000))
    assert max(read.longest_us for read in reads) == once.read(5_000_000).longest_us


def test_long_work_misses_the_ticks_that_fall_into_it() -> None:
    settings = TimingSettings(work_us=1500, work_spread_us=0)
    assert run(TickTimes(settings, np.random.default_rng(0)), 3000) == list(range(1000, 3_000_000, 2000))
    settings = TimingSettings(overrun=0.02, overrun_us=4000)
    times = TickTimes(settings, np.random.default_rng(3))
    missed = run(times, 50_000)
    # A tick in fifty runs over by 0 to 3 ms: it misses 2 ticks on average.
    assert len(missed) == pytest.approx(50_000 * 0.02 * 2, rel=0.1)
    read = times.read(50_000_000)
    assert 3900 < read.longest_us <= 4000
    assert read.jitter_us == 3000


def fly_world(tmp_path: Path, vehicle: Vehicle, tools: Any, text: str, flight: int = 0) -> Any:
    figure_eight, put_on_board, fly = tools
    world = tmp_path / "world.toml"
    world.write_text(f'description = "x"\ntolerances = false\n[radio]\nloss = 0.0\n{text}')
    simulated = SimulatedVehicle.create(vehicle, world=str(world), world_seed=8401)
    reference = figure_eight(vehicle)
    put_on_board(simulated, reference, flight)
    return simulated, fly(simulated)


def test_vehicle_that_misses_ticks_flies_counts_and_tells(
    tmp_path: Path, vehicle: Vehicle, session_tools: Any
) -> None:
    flown = {}
    for name, text in (("calm", ""), ("late", "[timing]\noverrun = 0.01\noverrun_us = 3000\n")):
        simulated, session = fly_world(tmp_path, vehicle, session_tools, text)
        assert session.states[-1] == 1
        assert TRACKING in session.states
        flown[name] = simulated, session
    simulated, session = flown["late"]
    statuses = [m for m in session.messages if isinstance(m, FcStatus)]
    overruns = statuses[-1].loop_overruns
    assert overruns == pytest.approx(0.01 * statuses[-1].tick, rel=0.3)
    assert overruns <= simulated._flight_mcu.late_ticks
    assert 2500 < max(m.loop_us for m in statuses) <= 3000
    assert max(m.jitter_us for m in statuses) == 2000
    assert 320 < np.mean([m.loop_mean_us for m in statuses]) < 370
    # Sums stay whole: a mean over ten ticks has ten ticks in it, where two of a hundred were missed.
    forces = []
    for _, session in flown.values():
        decoder = IntervalDecoder()
        intervals = [decoder.push(m) for m in session.messages if isinstance(m, FcControl)]
        forces.append(np.mean([i.force_mean[2] for i in intervals if i is not None]))
    assert forces[1] == pytest.approx(forces[0], rel=0.005)
    paths = [np.array(flown[name][1].tracked_ned) for name in flown]
    rows = min(map(len, paths))
    assert np.abs(paths[0][:rows] - paths[1][:rows]).max() < 0.1


def test_timing_without_late_ticks_changes_nothing_but_what_status_says_of_it(
    tmp_path: Path, vehicle: Vehicle, session_tools: Any
) -> None:
    told, statuses = [], []
    for text in ("", "[timing]\nwork_us = 700.0\njitter_us = 50.0\n"):
        _, session = fly_world(tmp_path, vehicle, session_tools, text)
        told.append([m.get_msgbuf() for m in session.messages if isinstance(m, FcControl | FcEstimate)])
        statuses.append([m for m in session.messages if isinstance(m, FcStatus)])
    assert told[0] == told[1]
    assert [s[-1].loop_overruns for s in statuses] == [0, 0]
    assert statuses[0][-1].loop_mean_us == pytest.approx(320, abs=10)
    assert statuses[1][-1].loop_mean_us == pytest.approx(700, abs=10)
    assert statuses[1][-1].jitter_us in range(40, 51)


def test_status_tells_the_greatest_age_of_a_pose(
    tmp_path: Path, vehicle: Vehicle, session_tools: Any
) -> None:
    text = "[mocap]\ndropout = 0.0\ngaps_s = [[4.0, 0.15]]\n"
    _, session = fly_world(tmp_path, vehicle, session_tools, text)
    ages_ms = {m.tick: 0.1 * m.mocap_age_max for m in session.messages if isinstance(m, FcStatus)}
    gap = [age for tick, age in ages_ms.items() if 4000 <= tick < 4400]
    assert 160 < max(gap) < 180  # the gap, the period and the way
    rest = [age for tick, age in ages_ms.items() if tick > 4400]
    assert max(rest) < 30


def test_ticks_are_drawn_from_the_flight() -> None:
    reads = []
    for seed in (1, 1, 2):
        times = TickTimes(TimingSettings(), np.random.default_rng(seed))
        run(times, 100)
        reads.append(times.read(100_000))
    assert reads[0] == reads[1] != reads[2]
