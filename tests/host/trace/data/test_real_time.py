"""Which parts of a flight are left out since time ran late."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from trimtab.host.log import Flight, read_flight
from trimtab.host.log.tracks import Timing
from trimtab.host.trace.data.audit import audit
from trimtab.host.trace.data.real_time import is_too_late, late_share, late_spans
from trimtab.host.trace.data.signals import FlightData
from trimtab.host.trace.decision.findings import Code
from trimtab.host.trace.decision.rules import RULES

DATA = Path(__file__).parents[3] / "data"


@pytest.fixture(scope="module")
def flight() -> Flight:
    """A flight at a port, in time."""
    flight = read_flight(DATA / "a1.mcap")
    t_us = np.arange(0, 20_000_000, 100_000)
    none = np.zeros_like(t_us)
    timing = Timing(
        t_us=t_us, poses=none + 10, late_poses=none, pose_late_us=none, runs_late=none > 0, clock_steps=none
    )
    return replace(flight, timing=timing)


def spoiled(flight: Flight, length_s: float, *, late_s: float = 0.0, wrong_s: float = 0.0) -> Flight:
    """The flight with poses that are late, or wrongly stamped for the vehicle, from 2 s of tracking on."""
    assert flight.tracking is not None
    mocap = flight.mocap
    assert mocap is not None
    begin_us = flight.tracking[0] + 2_000_000
    where = (mocap.t_us >= begin_us) & (mocap.t_us < begin_us + 1e6 * length_s)
    late_us, wrong_us = (np.where(where, round(1e6 * size_s), 0) for size_s in (late_s, wrong_s))
    changed = replace(mocap, t_arrival_us=mocap.t_arrival_us + late_us, forwarded_us=mocap.t_us + wrong_us)
    return replace(flight, mocap=changed)


LATE_S, WRONG_S = 1.1 * RULES.late_pose_s, 1.1 * RULES.clock_jump_s


def test_flight_in_time_is_used_whole(flight: Flight) -> None:
    assert late_spans(flight) == []
    assert late_share(flight) == 0.0


@pytest.mark.parametrize("sizes", [{"late_s": LATE_S}, {"wrong_s": WRONG_S}, {"wrong_s": -WRONG_S}])
def test_late_or_wrongly_stamped_poses_are_left_out_with_the_recovery(
    flight: Flight, sizes: dict[str, float]
) -> None:
    late = spoiled(flight, 0.2, **sizes)
    assert flight.tracking is not None
    ((begin_s, end_s),) = late_spans(late)
    assert begin_s == pytest.approx(1e-6 * flight.tracking[0] + 2.0, abs=0.02)
    assert end_s - begin_s == pytest.approx(0.2 + RULES.late_recovery_s, abs=0.05)
    stretches = [each for each in audit(FlightData.of(late)).stretches if each.code is Code.LATE_POSES]
    assert len(stretches) == 1


@pytest.mark.parametrize(
    "sizes", [{"late_s": 0.9 * RULES.late_pose_s}, {"wrong_s": 0.9 * RULES.clock_jump_s}]
)
def test_less_than_the_bounds_is_used(flight: Flight, sizes: dict[str, float]) -> None:
    assert late_spans(spoiled(flight, 0.2, **sizes)) == []


def test_log_without_timing_is_used_whole(flight: Flight) -> None:
    assert late_spans(replace(spoiled(flight, 0.2, late_s=LATE_S), timing=None)) == []


def test_flight_that_is_late_for_long_is_not_judged_and_loses_no_segment(flight: Flight) -> None:
    late = spoiled(flight, 4.0, wrong_s=WRONG_S)
    assert is_too_late(late)
    assert late_share(late) > RULES.late_share
    assert late_spans(late) == []
    codes = {each.code for each in audit(FlightData.of(late)).stretches}
    assert not codes & {Code.LATE_POSES, Code.CLOCK_JUMP}
