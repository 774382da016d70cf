"""The transition table: its whole product, and the paths a flight takes through it."""

import itertools

import pytest

from trimtab.firmware_model.flight.invariants import Moment, Transition, broken
from trimtab.firmware_model.flight.supervisor import (
    COMMANDS,
    FAILURES,
    FLYING,
    TRANSITIONS,
    Event,
    State,
    update,
)
from trimtab.firmware_model.services.handlers import TEXT_BYTES
from trimtab.protocol.parameters import DEFAULTS


def test_update_every_state_and_event_moves_or_refuses_with_a_reason():
    for state, event in itertools.product(State, Event):
        where, outcome = f"{state.name}, {event.name}", update(state, event)
        assert isinstance(outcome.state, State), where
        if outcome.refusal is not None:
            assert outcome.state is state, where
            assert outcome.refusal.strip(), where
            if event in COMMANDS:
                assert len(f"{event.name.lower()} refused: {outcome.refusal}") <= TEXT_BYTES, where


def test_table_covers_the_product_and_nothing_else():
    assert set(TRANSITIONS) == set(list(itertools.product(State, Event)))


def test_flight_as_planned_visits_the_phases_in_order():
    state, seen = State.BOOT, []
    for event in (
        Event.BOOTED,
        Event.ARM,
        Event.START,
        Event.START_REACHED,
        Event.REFERENCE_ENDED,
        Event.HELD,
        Event.TOUCHDOWN,
    ):
        outcome = update(state, event)
        assert outcome.refusal is None
        state = outcome.state
        seen.append(state.name)
    assert seen == ["STANDBY", "ARMED", "TAKEOFF", "TRACKING", "HOLD", "LANDING", "STANDBY"]


@pytest.mark.parametrize("state", sorted(FLYING))
def test_kill_in_flight_always_stops(state):
    assert update(state, Event.KILL).state is State.STANDBY


@pytest.mark.parametrize("state", sorted(FLYING))
def test_disarm_in_flight_is_refused(state):
    assert update(state, Event.DISARM).refusal is not None


def test_accepted_events_break_no_invariant():
    for (state, event), outcome in TRANSITIONS.items():
        if outcome.refusal is None:
            moment = Moment(parameters=DEFAULTS, transitions=(Transition(state, event, outcome.state),))
            assert broken(moment) == [], f"{state.name}, {event.name}"


def test_failure_in_the_air_never_returns_to_normal_flight():
    for state, event in itertools.product(sorted(FLYING), FAILURES):
        assert update(state, event).state in (State.FAILSAFE, State.LANDING), f"{state.name}, {event.name}"


def test_armed_is_reached_from_standby_alone():
    sources = {s for (s, _), o in TRANSITIONS.items() if o.state is State.ARMED and o.refusal is None}
    assert sources == {State.STANDBY, State.ARMED}


def test_every_state_is_reached_from_boot():
    reached, frontier = {State.BOOT}, [State.BOOT]
    while frontier:
        state = frontier.pop()
        for event in Event:
            target = update(state, event).state
            if target not in reached:
                reached.add(target)
                frontier.append(target)
    assert reached == set(State)
