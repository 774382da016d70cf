"""The failsafe table and what notices its conditions."""

import math

import pytest

from trimtab.firmware_model.flight.condition_monitor import SURE_TOUCH_US, ConditionMonitor, Observation
from trimtab.firmware_model.flight.failsafe import BY_EVENT, CONDITIONS, Action, Failsafe, escalate
from trimtab.firmware_model.flight.parameters import ParameterValues
from trimtab.firmware_model.flight.supervisor import FAILURES, FLYING, Event, State, update
from trimtab.protocol.messages import mavlink
from trimtab.protocol.parameters import BY_NAME, DEFAULTS

ROWS = [row for row in CONDITIONS if row.failsafe is not Failsafe.NONE]


def test_table_has_one_row_an_event_and_its_timeouts_are_parameters_in_seconds():
    assert len(BY_EVENT) == len(CONDITIONS)
    for row in CONDITIONS:
        if row.timeout is not None:
            assert BY_NAME[row.timeout].unit == "s"
        assert row.bound is None or row.bound in BY_NAME
        assert len(row.text.encode()) <= 50


def test_numbers_on_the_wire_are_the_dialects():
    for failsafe in Failsafe:
        assert getattr(mavlink, f"TRIMTAB_FAILSAFE_{failsafe.name}") == failsafe
    for state in State:
        assert getattr(mavlink, f"TRIMTAB_STATE_{state.name}") == state


def test_every_failure_has_a_row_and_every_failsafe_one_that_leads_to_it():
    assert {row.event for row in ROWS} == set(FAILURES)
    assert {row.failsafe for row in ROWS} == set(Failsafe) - {Failsafe.NONE}


def test_reference_ended_is_no_failure():
    row = BY_EVENT[Event.REFERENCE_ENDED]
    assert row.failsafe is Failsafe.NONE
    assert update(State.TRACKING, row.event).state is State.HOLD
    assert update(State.HOLD, Event.HELD).state is State.LANDING


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.event.name)
def test_every_failure_does_something_in_every_state_of_flight(row):
    for state in FLYING:
        outcome = update(state, row.event)
        assert outcome.state is State.FAILSAFE or outcome.refusal == "landing in place already"


def test_escalate_never_goes_back():
    for row in CONDITIONS:
        for action in Action:
            assert escalate(action, row) == max(action, row.action)
    assert max(Action) is Action.MOTORS_OFF


START_US = 1_000_000
FINE = Observation(
    cos_tilt=1.0,
    age_us=10_000,
    p=(0.0, 0.0, -1.0),
    battery_v=16.0,
    imu=(),
    flight_ticks=0,
    saturated_ticks=0,
)


class Looks:
    """A monitor that is updated every 10 ms; everything is fine but what a test changes."""

    def __init__(self, **parameters):
        self.monitor = ConditionMonitor(ParameterValues(parameters))
        self.monitor.start(START_US)
        self.now_us = START_US
        self.monitor.pose_us = self.monitor.host_us = START_US
        self.stale = frozenset()
        self.ticks = self.saturated = 0
        self.look()

    def look(self, saturated=0, **changes):
        """Events of the conditions that hold at this look."""
        monitor, now = self.monitor, self.now_us
        for name in ("pose_us", "host_us", "setpoint_us"):
            if name not in self.stale:
                setattr(monitor, name, now)
        self.ticks, self.saturated = self.ticks + 10, self.saturated + saturated
        seen = FINE._replace(flight_ticks=self.ticks, saturated_ticks=self.saturated, imu=(float(now),))
        monitor.observe(now, seen._replace(**changes))
        self.now_us += 10_000
        return [row.event for row in monitor.active_conditions()]

    def until(self, event, most_s=20.0, **changes):
        """Seconds of looks until the event alone holds."""
        start = self.now_us
        while self.now_us - start < 1e6 * most_s:
            found = self.look(**changes)
            assert found in ([], [event])
            if found:
                return 1e-6 * (self.now_us - start)
        raise AssertionError(f"{event.name} never held")


LASTING = {
    Event.TILTED: ("FS_TILT_S", {"cos_tilt": math.cos(math.radians(86.0))}),
    Event.MOCAP_LATE: ("FS_LATE_S", {"age_us": 101_000}),
    Event.FENCE_LEFT: ("FS_FENCE_S", {"p": (0.0, 10.51, -1.0)}),
    Event.SATURATED: ("FS_SAT_S", {"saturated": 9}),
    Event.IMU_STUCK: ("FS_IMU_S", {"imu": (0.25,) * 6}),
}


@pytest.mark.parametrize("event", LASTING)
def test_watch_condition_must_last_for_its_time_without_a_break(event):
    timeout, changes = LASTING[event]
    looks = Looks()
    for _ in range(round(100 * DEFAULTS[timeout])):
        assert looks.look(**changes) == []
    looks.look()
    if event is Event.IMU_STUCK:
        looks.look(**changes)  # the first of its kind is a change too
    assert looks.until(event, **changes) == pytest.approx(DEFAULTS[timeout] + 0.015, abs=0.011)
    assert looks.look() == []


@pytest.mark.parametrize(
    ("name", "event", "timeout"),
    [
        ("pose_us", Event.MOCAP_LOST, "FS_MOCAP_S"),
        ("host_us", Event.LINK_LOST, "FS_LINK_S"),
        ("setpoint_us", Event.SETPOINTS_LOST, "FS_OFFB_S"),
    ],
)
def test_watch_what_is_no_longer_heard_is_lost_after_its_time(name, event, timeout):
    looks = Looks()
    looks.stale = frozenset([name])
    assert looks.until(event) == pytest.approx(DEFAULTS[timeout] + 0.005, abs=0.011)
    looks.stale = frozenset()
    assert looks.look() == []


@pytest.mark.parametrize(
    "changes",
    [
        {"cos_tilt": math.cos(math.radians(84.0))},
        {"age_us": 99_000},
        {"age_us": None},
        {"p": (-10.49, 10.49, -6.49)},
        {"saturated": 8},
        {"battery_v": 13.6},
    ],
)
def test_watch_what_is_within_its_bound_never_holds(changes):
    looks = Looks()
    for _ in range(1_000):
        assert looks.look(**changes) == []


def test_watch_battery_is_smoothed_before_it_is_judged():
    looks = Looks()
    low = DEFAULTS["BAT_EMPTY_V"] + DEFAULTS["FS_BAT_SHARE"] * 3.6
    for _ in range(20):
        looks.look(battery_v=12.0)  # a moment of full thrust
        assert [looks.look() for _ in range(100)] == [[]] * 100
    expected = DEFAULTS["FS_BAT_S"] * math.log((16.0 - 12.0) / (low - 12.0))
    assert Looks().until(Event.BATTERY_LOW, battery_v=12.0) == pytest.approx(expected, rel=0.02)


def test_watch_battery_and_imu_can_be_switched_off():
    looks = Looks(FS_BAT_SHARE=0.0, FS_IMU_S=0.0)
    for _ in range(1_000):
        assert looks.look(battery_v=0.0, imu=()) == []


def test_watch_late_ticks_hold_where_there_are_many_within_the_time():
    looks = Looks(FS_LOOP_MAX=5, FS_LOOP_S=1.0)
    for _ in range(8):
        looks.monitor.record_late_tick(looks.now_us)
        for _ in range(30):
            assert looks.look() == []
    found: list[Event] = []
    for _ in range(5):
        looks.monitor.record_late_tick(looks.now_us)
        found = looks.look()
    assert found == [Event.LOOP_OVERRUN]
    for _ in range(98):
        looks.look()
    assert looks.look() == []


def test_watch_tilt_that_is_not_a_number_counts_as_tilted():
    assert Looks().until(Event.TILTED, cos_tilt=math.nan) == pytest.approx(0.315, abs=0.011)


@pytest.fixture
def monitor():
    monitor = ConditionMonitor(ParameterValues({}))
    monitor.start(START_US)
    return monitor


def test_landed_needs_all_signs_for_their_time(monitor):
    signs = {"height": 0.05, "v": (0.0, 0.0, 0.02), "reference_below": True, "carried": True}
    assert not monitor.update_touchdown(1_100_000, **signs)
    assert not monitor.update_touchdown(1_150_000, **{**signs, "height": 0.5})
    assert not monitor.update_touchdown(1_340_000, **signs)
    assert monitor.update_touchdown(1_350_000, **signs)
    assert not monitor.update_touchdown(1_360_000, **{**signs, "v": (0.3, 0.0, 0.0)})
    assert not monitor.update_touchdown(1_600_000, **{**signs, "reference_below": False})
    assert not monitor.update_touchdown(1_900_000, **{**signs, "carried": False})


def test_landed_on_the_floor_it_took_off_from_is_at_once(monitor):
    assert monitor.update_touchdown(
        1_000_000, height=0.02, v=(0.0, 0.0, 0.5), reference_below=False, carried=False
    )
    assert not monitor.update_touchdown(
        1_010_000, height=0.035, v=(0.0, 0.0, 0.5), reference_below=True, carried=True
    )


LOW = {"learn": True, "near": True, "stopped": True}
"""A descent that has stopped near the floor, while dead reckoning is reliable."""


def test_carried_allows_for_the_thrust_seen_aloft(monitor):
    for _ in range(4_000):
        monitor.update_thrust_ratio(force=9.81, thrust=7.0)
    assert monitor.thrust_ratio == pytest.approx(9.81 / 7.0, rel=1e-6)
    assert not monitor.update_support(1_100_000, force=9.81, thrust=7.0, expected_excess=4.2, **LOW)
    assert not monitor.update_support(1_350_000, force=9.81, thrust=7.0, expected_excess=4.2, **LOW)
    assert monitor.update_support(1_550_000, force=9.81, thrust=5.0, expected_excess=4.2, **LOW)


def test_carried_takes_what_comes_on_slowly_for_thrust_and_a_step_for_the_floor(monitor):
    now_us = 1_000_000
    for k in range(300):  # thrust is worth half as much again within 3 s
        now_us += 10_000
        assert not monitor.update_support(
            now_us, force=9.81, thrust=9.81 / (1.0 + 0.15e-2 * k), expected_excess=4.2, **LOW
        )
    thrust = 9.81 / monitor.thrust_ratio
    stepped_us = now_us
    while not monitor.update_support(now_us, force=9.81, thrust=thrust - 2.5, expected_excess=4.2, **LOW):
        now_us += 10_000
    assert now_us - stepped_us <= 250_000


@pytest.mark.parametrize(
    ("floor", "excess", "noticed"), [(1.5, 0.9, False), (1.5, 1.2, True), (3.0, 1.2, False), (9.0, 2.2, True)]
)
def test_carried_asks_for_half_of_what_a_floor_gives_within_bounds(monitor, floor, excess, noticed):
    signs = {"force": 9.81, "thrust": 9.81 - excess, "expected_excess": floor, **LOW, "learn": False}
    assert not monitor.update_support(1_000_000, **signs)
    assert monitor.update_support(1_210_000, **signs) is noticed


def test_carried_high_above_the_floor_is_air(monitor):
    signs = {"force": 9.81, "thrust": 6.0, "expected_excess": 4.2, **LOW, "learn": False, "near": False}
    assert not any(monitor.update_support(now_us, **signs) for now_us in range(1_000_000, 9_000_000, 10_000))


def test_carried_while_it_seems_to_sink_must_last_longer(monitor):
    signs = {"force": 9.81, "thrust": 6.0, "expected_excess": 4.2, **LOW, "learn": False, "stopped": False}
    carried_us = [
        now_us for now_us in range(1_000_000, 3_000_000, 10_000) if monitor.update_support(now_us, **signs)
    ]
    assert carried_us[0] - START_US == SURE_TOUCH_US


def test_defaults_give_mocap_less_time_than_the_link():
    assert DEFAULTS["FS_MOCAP_S"] < DEFAULTS["FS_LINK_S"]
