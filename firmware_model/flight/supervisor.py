"""Supervisor of the flight: a table of transitions.

In every state, every event is either accepted and gives the next state (possibly the same) or refused.
The table is data and `update` is a pure function. The table is checked when it is built: no pair is missing,
only a power-up leads into BOOT, and a failure in the air leads into FAILSAFE or is refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from types import MappingProxyType


class State(IntEnum):
    """States of the flight MCU. FC_STATUS reports the values."""

    BOOT = 0
    STANDBY = 1
    ARMED = 2
    TAKEOFF = 3  # climb, or way to the first node
    TRACKING = 4
    HOLD = 5
    LANDING = 6
    FAILSAFE = 7
    OFFBOARD = 8


class Event(IntEnum):
    """Events of the supervisor: commands, ends of phases, failures."""

    BOOTED = 0
    # Commands.
    ARM = 1
    START = 2  # fly the live reference
    TAKEOFF = 3
    HOLD = 4
    OFFBOARD = 5
    LAND = 6
    DISARM = 7
    KILL = 8
    # Ends of phases.
    START_REACHED = 9  # at the first node of the reference
    HEIGHT_REACHED = 10  # at the height of a takeoff
    REFERENCE_ENDED = 11
    SETPOINTS_LOST = 12
    HELD = 13  # end of a limited hold
    TOUCHDOWN = 14
    IDLED = 15  # armed for IDLE_S
    # Failures.
    TILTED = 16
    IMU_STUCK = 17
    MOCAP_LOST = 18
    MOCAP_LATE = 19
    LINK_LOST = 20
    BATTERY_LOW = 21
    SATURATED = 22
    LOOP_OVERRUN = 23
    FENCE_LEFT = 24
    FENCE_AHEAD = 25  # the predicted stopping point is outside


COMMANDS = tuple(event for event in Event if Event.ARM <= event <= Event.KILL)
FAILURES = tuple(event for event in Event if event >= Event.TILTED)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Outcome of an event: the next state, and the reason of a refusal."""

    state: State
    refusal: str | None = None


_BOOTING = "still booting"
_DISARMED = "not armed"
_ON_FLOOR = "still on the floor"
_ARM_FIRST = "arm first"
_IN_AIR = "in the air already"
_IN_FLIGHT = "in flight: land first, or force it"
_LANDING = "landing"
_LANDING_ALREADY = "landing in place already"
_GROUNDED = "motors are off"
_ENDING = "a failsafe ends the flight"

_S, _E = State, Event
_Row = dict[Event, State | str]
_NO_PHASE: _Row = {
    _E.BOOTED: "booted already",
    _E.START_REACHED: "no climb under way",
    _E.HEIGHT_REACHED: "no climb under way",
    _E.REFERENCE_ENDED: "no reference is being flown",
    _E.SETPOINTS_LOST: "no setpoints are being followed",
    _E.HELD: "not holding",
    _E.TOUCHDOWN: "not landing",
    _E.IDLED: "not waiting on the floor",
}
"""By default every end-of-phase event is refused; each state overrides the events of its own phase."""
_FAILURES_IGNORED: _Row = dict.fromkeys(FAILURES, _GROUNDED)
_FAILURES_TO_FAILSAFE: _Row = dict.fromkeys(FAILURES, _S.FAILSAFE)

_ROWS: dict[State, _Row] = {
    _S.BOOT: {
        **_NO_PHASE,
        **dict.fromkeys(COMMANDS, _BOOTING),
        **_FAILURES_IGNORED,
        _E.BOOTED: _S.STANDBY,
    },
    _S.STANDBY: {
        **_NO_PHASE,
        **_FAILURES_IGNORED,
        _E.ARM: _S.ARMED,
        _E.START: _ARM_FIRST,
        _E.TAKEOFF: _ARM_FIRST,
        _E.HOLD: _DISARMED,
        _E.OFFBOARD: _DISARMED,
        _E.LAND: _DISARMED,
        _E.DISARM: _S.STANDBY,
        _E.KILL: _S.STANDBY,
    },
    _S.ARMED: {
        **_NO_PHASE,
        **dict.fromkeys(FAILURES, _S.STANDBY),
        _E.ARM: _S.ARMED,
        _E.START: _S.TAKEOFF,
        _E.TAKEOFF: _S.TAKEOFF,
        _E.HOLD: _ON_FLOOR,
        _E.OFFBOARD: _S.OFFBOARD,
        _E.LAND: _ON_FLOOR,
        _E.DISARM: _S.STANDBY,
        _E.KILL: _S.STANDBY,
        _E.IDLED: _S.STANDBY,
    },
    _S.TAKEOFF: {
        **_NO_PHASE,
        **_FAILURES_TO_FAILSAFE,
        _E.ARM: _S.TAKEOFF,
        _E.START: _S.TAKEOFF,
        _E.TAKEOFF: _S.TAKEOFF,
        _E.HOLD: _S.HOLD,
        _E.OFFBOARD: _S.OFFBOARD,
        _E.LAND: _S.LANDING,
        _E.DISARM: _IN_FLIGHT,
        _E.KILL: _S.STANDBY,
        _E.START_REACHED: _S.TRACKING,
        _E.HEIGHT_REACHED: _S.HOLD,
    },
    _S.TRACKING: {
        **_NO_PHASE,
        **_FAILURES_TO_FAILSAFE,
        _E.ARM: _S.TRACKING,
        _E.START: _S.TRACKING,
        _E.TAKEOFF: _IN_AIR,
        _E.HOLD: _S.HOLD,
        _E.OFFBOARD: _S.OFFBOARD,
        _E.LAND: _S.LANDING,
        _E.DISARM: _IN_FLIGHT,
        _E.KILL: _S.STANDBY,
        _E.REFERENCE_ENDED: _S.HOLD,
    },
    _S.HOLD: {
        **_NO_PHASE,
        **_FAILURES_TO_FAILSAFE,
        _E.ARM: _S.HOLD,
        _E.START: _S.TAKEOFF,
        _E.TAKEOFF: _IN_AIR,
        _E.HOLD: _S.HOLD,
        _E.OFFBOARD: _S.OFFBOARD,
        _E.LAND: _S.LANDING,
        _E.DISARM: _IN_FLIGHT,
        _E.KILL: _S.STANDBY,
        _E.HELD: _S.LANDING,
    },
    _S.OFFBOARD: {
        **_NO_PHASE,
        **_FAILURES_TO_FAILSAFE,
        _E.ARM: _S.OFFBOARD,
        _E.START: "following setpoints: hold first",
        _E.TAKEOFF: _IN_AIR,
        _E.HOLD: _S.HOLD,
        _E.OFFBOARD: _S.OFFBOARD,
        _E.LAND: _S.LANDING,
        _E.DISARM: _IN_FLIGHT,
        _E.KILL: _S.STANDBY,
        _E.SETPOINTS_LOST: _S.HOLD,
    },
    _S.LANDING: {
        **_NO_PHASE,
        **_FAILURES_TO_FAILSAFE,
        _E.ARM: _LANDING,
        _E.START: _LANDING,
        _E.TAKEOFF: _LANDING,
        _E.HOLD: _LANDING,
        _E.OFFBOARD: _LANDING,
        _E.LAND: _S.LANDING,
        _E.DISARM: _IN_FLIGHT,
        _E.KILL: _S.STANDBY,
        _E.TOUCHDOWN: _S.STANDBY,
        # A landing continues where the action would be a landing in place.
        _E.MOCAP_LATE: _LANDING_ALREADY,
        _E.LINK_LOST: _LANDING_ALREADY,
        _E.BATTERY_LOW: _LANDING_ALREADY,
        _E.SATURATED: _LANDING_ALREADY,
        _E.LOOP_OVERRUN: _LANDING_ALREADY,
        _E.FENCE_LEFT: _LANDING_ALREADY,
        _E.FENCE_AHEAD: _LANDING_ALREADY,
    },
    _S.FAILSAFE: {
        **_NO_PHASE,
        **dict.fromkeys(COMMANDS, _ENDING),
        **_FAILURES_TO_FAILSAFE,
        _E.DISARM: _IN_FLIGHT,
        _E.KILL: _S.STANDBY,
        _E.TOUCHDOWN: _S.STANDBY,
    },
}

FLYING = frozenset(State) - {State.BOOT, State.STANDBY, State.ARMED}
"""States in which the rotors may turn."""


def _checked(rows: Mapping[State, Mapping[Event, State | str]]) -> Mapping[tuple[State, Event], Outcome]:
    """Return the table by (state, event) after a check of its invariants."""
    table: dict[tuple[State, Event], Outcome] = {}
    for state in State:
        for event in Event:
            cell = rows[state][event]  # a missing pair raises KeyError on import
            if isinstance(cell, str):
                table[state, event] = Outcome(state=state, refusal=cell)
                continue
            table[state, event] = Outcome(state=cell)
            assert cell is not State.BOOT, "only a power-up leads into boot"
            if cell is State.FAILSAFE:
                assert state in FLYING, "failsafe is a flying state: on the floor a failure disarms"
                assert event in FAILURES, "only a failure leads into failsafe"
            elif state in FLYING:
                assert event not in FAILURES, "an accepted failure in the air leads into failsafe"
    return MappingProxyType(table)


TRANSITIONS = _checked(_ROWS)
"""Outcome of every event in every state."""


def update(state: State, event: Event) -> Outcome:
    """Return the outcome of `event` in `state`: the next state, or the same state with a refusal."""
    return TRANSITIONS[state, event]
