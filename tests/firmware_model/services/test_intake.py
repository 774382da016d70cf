"""Bounds on the messages of a station that are handled."""

from __future__ import annotations

import pytest

from trimtab.firmware_model.services.intake import BURST_S, LIST_COST, OTHERS_HZ, RATE_HZ, Intake
from trimtab.protocol import messages as m


def sent_by(station, message):
    message._header.srcSystem, message._header.srcComponent = station
    return message


def admitted(intake, station, seconds, *, rate_hz=1000, other=False, make=lambda: m.Timesync(0, 1)):
    step_us = 1_000_000 // rate_hz
    times = range(0, round(1e6 * seconds), step_us)
    return sum(intake.admit(sent_by(station, make()), now_us, other=other) for now_us in times)


def test_flooding_station_is_heard_at_the_bound_and_does_not_cost_another_one():
    intake = Intake()
    handled = admitted(intake, (77, 1), 10.0)
    assert handled == pytest.approx(RATE_HZ * (10 + BURST_S), abs=1)
    assert intake.dropped == 10_000 - handled
    assert admitted(intake, (255, 190), 1.0, rate_hz=RATE_HZ) == RATE_HZ


def test_stations_without_a_part_in_the_flight_share_one_bound():
    intake = Intake()
    found = [admitted(intake, (system, 1), 1.0, other=True) for system in range(1, 6)]
    assert sum(found) <= OTHERS_HZ * (1 + BURST_S)


def test_setpoints_and_chunks_are_not_counted_except_in_flight_from_others():
    intake = Intake()

    def make():
        return m.SetAttitudeTarget(0, 1, 1, 0, (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, 0.5)

    assert admitted(intake, (255, 190), 1.0, make=make) == 1000
    assert admitted(intake, (77, 1), 1.0, make=make, other=True) < 100


def test_lists_of_parameters_count_for_their_answers():
    intake = Intake()
    lists = admitted(intake, (77, 1), 10.0, make=lambda: m.ParamRequestList(1, 1))
    assert lists == pytest.approx(RATE_HZ * (10 + BURST_S) / LIST_COST, abs=1)


def test_station_without_a_part_in_the_flight_may_ask_for_all_parameters():
    intake = Intake()
    assert admitted(intake, (77, 1), 0.02, other=True) == 20  # what a client asks first
    assert intake.admit(sent_by((77, 1), m.ParamRequestList(1, 1)), 20_000, other=True)


def test_many_stations_cost_little_memory():
    intake = Intake()
    for system in range(1, 250):
        intake.admit(sent_by((system, 1), m.Timesync(0, 1)), 0, other=False)
    assert len(intake._buckets) == 16
