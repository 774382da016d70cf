"""Ownership of a flight: whose poses are used, who keeps the link alive, and who may arm."""

from __future__ import annotations

import pytest

from trimtab.firmware_model.flight.supervisor import Event, State
from trimtab.firmware_model.services import ownership
from trimtab.firmware_model.services.ownership import Ownership

HOST, STRANGER, FORWARDER = (255, 190), (77, 190), (254, 190)
POSE_US = 10_000


class Case:
    """A flight on the floor with its ownership; `run` passes time with poses and messages of stations."""

    def __init__(self, rig):
        self.rig, self.flight = rig, rig.flight
        rig.host = False
        self.texts = []
        self.ownership = Ownership(flight=rig.flight, text=lambda severity, text: self.texts.append(text))

    def run(self, seconds, *, heard=(HOST,), posing=()):
        end_us = self.rig.now_us + round(1e6 * seconds)
        while self.rig.now_us < end_us:
            now_us = self.rig.now_us
            if now_us % POSE_US == 0:
                for station in posing:
                    self.ownership.admit_pose(station, now_us)
            if now_us % 100_000 == 0:
                for station in heard:
                    self.ownership.hear(station, now_us)
            self.rig.tick()

    def arm(self, station):
        reason = self.ownership.refusal(Event.ARM, station, self.rig.now_us)
        return reason or self.flight.handle_event(Event.ARM, self.rig.now_us, by=station)


@pytest.fixture
def case(make_rig):
    return Case(make_rig())


def test_messages_of_a_stranger_do_not_keep_the_link_of_a_flight_alive(case):
    case.run(3.0, heard=(HOST,), posing=(HOST,))
    assert case.arm(HOST) is None
    assert case.flight.handle_event(Event.START, case.rig.now_us, by=HOST) is None
    case.run(4.0, heard=(STRANGER,), posing=(HOST,))
    assert case.flight.state is State.FAILSAFE


def test_forwarder_of_the_poses_keeps_the_link_alive(case):
    case.run(3.0, heard=(HOST, FORWARDER), posing=(FORWARDER,))
    assert case.arm(HOST) is None
    assert case.flight.handle_event(Event.START, case.rig.now_us, by=HOST) is None
    case.run(4.0, heard=(FORWARDER,), posing=(FORWARDER,))
    assert case.flight.state is not State.FAILSAFE


def test_first_station_to_send_poses_is_used_until_it_is_silent(case):
    assert case.ownership.admit_pose(STRANGER, 0)
    assert not case.ownership.admit_pose(HOST, 10_000)
    lost_us = case.flight.parameters.us("FS_MOCAP_S")
    assert not case.ownership.admit_pose(HOST, lost_us)
    assert case.ownership.admit_pose(HOST, lost_us + 1)
    assert not case.ownership.admit_pose(STRANGER, lost_us + 2)


def test_station_that_arms_and_sends_poses_is_their_source(case):
    case.run(3.0, posing=(STRANGER, HOST))
    assert case.arm(HOST) == "poses of another station were in use"
    assert case.arm(HOST) != "poses of another station were in use"  # the estimate is to settle again
    case.run(3.0, posing=(STRANGER, HOST))
    assert case.arm(HOST) is None
    assert not case.ownership.admit_pose(STRANGER, case.rig.now_us)
    assert case.ownership.admit_pose(HOST, case.rig.now_us)


def test_arming_is_refused_while_two_other_stations_send_poses(case):
    case.run(3.0, posing=(STRANGER, FORWARDER))
    assert case.arm(HOST) == "poses of two stations: 77:190 and 254:190"
    case.run(1.0, posing=(FORWARDER,))
    assert case.arm(HOST) is None


def test_poses_of_another_station_are_refused_in_flight_even_after_the_source_fell_silent(case):
    case.run(3.0, posing=(HOST,))
    assert case.arm(HOST) is None
    case.run(2.0)
    assert not case.ownership.admit_pose(STRANGER, case.rig.now_us)
    assert case.texts == ["poses of station 77:190 refused: not the owner"]


def test_offboard_follows_setpoints_of_the_owner_only(case):
    case.run(3.0, posing=(HOST,))
    assert case.ownership.admit_setpoint(STRANGER)
    assert case.arm(HOST) is None
    assert not case.ownership.admit_setpoint(STRANGER)
    refusal = case.ownership.refusal(Event.OFFBOARD, HOST, case.rig.now_us)
    assert refusal == "no setpoints of yours: stream them first"
    assert case.ownership.admit_setpoint(HOST)
    assert case.ownership.refusal(Event.OFFBOARD, HOST, case.rig.now_us) is None


def test_owner_is_the_station_that_armed_until_the_vehicle_disarms(case):
    case.run(3.0, posing=(HOST,))
    assert case.ownership.owner is None
    assert case.arm(HOST) is None
    assert case.ownership.owner == HOST
    assert case.ownership.refusal(Event.DISARM, STRANGER, case.rig.now_us) is not None
    assert case.flight.handle_event(Event.DISARM, case.rig.now_us, by=HOST) is None
    assert case.ownership.owner is None
    assert case.ownership.refusal(Event.DISARM, STRANGER, case.rig.now_us) is None


def test_many_strangers_cost_few_texts_and_little_memory(case):
    case.run(3.0, posing=(HOST,))
    assert case.arm(HOST) is None
    for system in range(1, 200):
        case.ownership.hear((system, 1), case.rig.now_us)
        assert not case.ownership.admit_pose((system, 1), case.rig.now_us)
    assert len(case.texts) == ownership.REPORTS_MAX
    assert len(case.ownership._heard_us) == ownership.STATIONS_MAX
    assert len(case.ownership._pose_us) == ownership.STATIONS_MAX
