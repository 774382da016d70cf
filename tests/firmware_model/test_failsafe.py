"""The failsafe table and what notices its conditions."""

import math

import pytest

from firmware_model.failsafe import BY_EVENT, CONDITIONS, Action, Failsafe, escalate
from firmware_model.parameters import ParameterValues
from firmware_model.supervisor import FLYING, Event, State, update
from firmware_model.watch import Watch
from protocol.messages import mavlink
from protocol.parameters import BY_NAME, DEFAULTS

FAILURES = [row for row in CONDITIONS if row.failsafe is not Failsafe.NONE]


def test_table_has_one_row_an_event_and_its_timeouts_are_parameters_in_seconds():
    assert len(BY_EVENT) == len(CONDITIONS)
    for row in CONDITIONS:
        if row.timeout is not None:
            assert BY_NAME[row.timeout].unit == "s"
        assert len(row.text.encode()) <= 50


def test_numbers_on_the_wire_are_the_dialects():
    for failsafe in Failsafe:
        assert getattr(mavlink, f"TRIMTAB_FAILSAFE_{failsafe.name}") == failsafe
    for state in State:
        assert getattr(mavlink, f"TRIMTAB_STATE_{state.name}") == state


def test_reference_ended_is_no_failure():
    row = BY_EVENT[Event.REFERENCE_ENDED]
    assert row.failsafe is Failsafe.NONE
    assert update(State.TRACKING, row.event).state is State.HOLD
    assert update(State.HOLD, Event.HELD).state is State.LANDING


@pytest.mark.parametrize("row", FAILURES, ids=lambda row: row.failsafe.name)
def test_every_failure_does_something_in_every_state_of_flight(row):
    for state in FLYING:
        outcome = update(state, row.event)
        assert outcome.state is State.FAILSAFE or outcome.refusal == "landing in place already"


def test_escalate_never_goes_back():
    for row in CONDITIONS:
        for action in Action:
            assert escalate(action, row) == max(action, row.action)
    assert max(Action) is Action.MOTORS_OFF


@pytest.fixture
def watch():
    watch = Watch(
        ParameterValues({"FS_MOCAP_S": 0.5, "FS_LINK_S": 2.0, "FS_TILT_S": 0.3, "FS_TILT_DEG": 60.0})
    )
    watch.start(1_000_000)
    watch.pose_us = watch.host_us = 1_000_000
    return watch


def struck(watch, now_us, cos_tilt=1.0):
    return [row.failsafe for row in watch.struck(now_us, cos_tilt)]


def test_watch_strikes_just_after_each_timeout(watch):
    assert struck(watch, 1_500_000) == []
    assert struck(watch, 1_501_000) == [Failsafe.MOCAP_LOST]
    watch.pose_us = 3_000_000
    assert struck(watch, 3_000_000) == []
    assert struck(watch, 3_001_000) == [Failsafe.LINK_LOST]


def test_watch_tilt_must_last(watch):
    far = math.cos(math.radians(61.0))
    for now_us in range(1_000_000, 1_300_001, 10_000):
        watch.pose_us = watch.host_us = now_us
        assert struck(watch, now_us, far) == []
    assert struck(watch, 1_310_000, far) == [Failsafe.TILT]
    assert struck(watch, 1_320_000, 1.0) == []
    assert struck(watch, 1_330_000, far) == []


def test_watch_tilt_that_is_not_a_number_counts_as_tilted(watch):
    struck(watch, 1_000_000)
    watch.pose_us = watch.host_us = 1_400_000
    assert struck(watch, 1_400_000, math.nan) == [Failsafe.TILT]


def test_landed_needs_all_signs_for_their_time(watch):
    signs = {"height": 0.05, "speed": 0.02, "descending": True}
    assert not watch.landed(1_100_000, **signs)
    assert not watch.landed(1_150_000, **{**signs, "height": 0.5})
    assert not watch.landed(1_340_000, **signs)
    assert watch.landed(1_350_000, **signs)
    assert not watch.landed(1_360_000, **{**signs, "speed": 0.3})
    assert not watch.landed(1_600_000, **{**signs, "descending": False})


def test_landed_on_the_floor_it_took_off_from_is_at_once(watch):
    assert watch.landed(1_000_000, height=0.02, speed=0.5, descending=False)
    assert not watch.landed(1_010_000, height=0.035, speed=0.5, descending=True)


def test_carried_allows_for_the_thrust_seen_aloft(watch):
    for _ in range(1_000):
        watch.aloft(force=9.81, thrust=7.0)
    assert watch.thrust_ratio == pytest.approx(9.81 / 7.0, rel=1e-6)
    assert not watch.carried(1_100_000, force=9.81, thrust=7.0)
    assert not watch.carried(1_350_000, force=9.81, thrust=7.0)
    assert watch.carried(1_550_000, force=9.81, thrust=5.0)


def test_defaults_give_mocap_less_time_than_the_link():
    assert DEFAULTS["FS_MOCAP_S"] < DEFAULTS["FS_LINK_S"]
