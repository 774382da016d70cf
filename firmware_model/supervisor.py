"""What the vehicle is doing, as one table: every state times event moves it or is refused with a reason.

The table is data, `update` is pure, and the table checks itself when it is built: no pair is missing, only
power leads into BOOT, and a failure in the air leads into FAILSAFE or nowhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from types import MappingProxyType


class State(IntEnum):
    """States of the flight MCU; the values travel in FC_STATUS."""

    BOOT = 0
    STANDBY = 1
    ARMED = 2
    TAKEOFF = 3
    TRACKING = 4
    HOLD = 5
    LANDING = 6
    FAILSAFE = 7


class Event(IntEnum):
    """What can happen to the vehicle: commands, ends of phases, failures."""

    BOOTED = 0
    ARM = 1
    START = 2
    LAND = 3
    DISARM = 4
    KILL = 5
    CLIMBED = 6
    REFERENCE_ENDED = 7
    HELD = 8
    TOUCHDOWN = 9
    IDLED = 10
    MOCAP_LOST = 11
    LINK_LOST = 12
    TILTED = 13


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What an event did: the state afterwards, and why nothing happened where it was refused."""

    state: State
    refusal: str | None = None


_BOOTING = "still booting"
_DISARMED = "not armed"
_ON_FLOOR = "still on the floor"
_IN_FLIGHT = "in flight: land first, or force it"
_NOT_CLIMBING = "no climb under way"
_NOT_TRACKING = "no reference is being flown"
_NOT_HOLDING = "not holding"
_NOT_LANDING = "not landing"
_BOOTED = "booted already"
_NOT_IDLE = "not waiting on the floor"
_GROUNDED = "motors are off"
_ENDING = "the flight is being ended by a failsafe"

_S, _E = State, Event
_ROWS: dict[State, dict[Event, State | str]] = {
    _S.BOOT: {
        _E.BOOTED: _S.STANDBY,
        _E.ARM: _BOOTING,
        _E.START: _BOOTING,
        _E.LAND: _BOOTING,
        _E.DISARM: _BOOTING,
        _E.KILL: _BOOTING,
        _E.CLIMBED: _NOT_CLIMBING,
        _E.REFERENCE_ENDED: _NOT_TRACKING,
        _E.HELD: _NOT_HOLDING,
        _E.TOUCHDOWN: _NOT_LANDING,
        _E.IDLED: _NOT_IDLE,
        _E.MOCAP_LOST: _GROUNDED,
        _E.LINK_LOST: _GROUNDED,
        _E.TILTED: _GROUNDED,
    },
    _S.STANDBY: {
        _E.BOOTED: _BOOTED,
        _E.ARM: _S.ARMED,
        _E.START: "arm first",
        _E.LAND: _DISARMED,
        _E.DISARM: _S.STANDBY,
        _E.KILL: _S.STANDBY,
        _E.CLIMBED: _NOT_CLIMBING,
        _E.REFERENCE_ENDED: _NOT_TRACKING,
        _E.HELD: _NOT_HOLDING,
        _E.TOUCHDOWN: _NOT_LANDING,
        _E.IDLED: _NOT_IDLE,
        _E.MOCAP_LOST: _GROUNDED,
        _E.LINK_LOST: _GROUNDED,
        _E.TILTED: _GROUNDED,
    },
    _S.ARMED: {
        _E.BOOTED: _BOOTED,
        _E.ARM: _S.ARMED,
        _E.START: _S.TAKEOFF,
        _E.LAND: _ON_FLOOR,
        _E.DISARM: _S.STANDBY,
        _E.KILL: _S.STANDBY,
        _E.CLIMBED: _NOT_CLIMBING,
        _E.REFERENCE_ENDED: _NOT_TRACKING,
        _E.HELD: _NOT_HOLDING,
        _E.TOUCHDOWN: _NOT_LANDING,
        _E.IDLED: _S.STANDBY,
        _E.MOCAP_LOST: _S.STANDBY,
        _E.LINK_LOST: _S.STANDBY,
        _E.TILTED: _S.STANDBY,
    },
    _S.TAKEOFF: {
        _E.BOOTED: _BOOTED,
        _E.ARM: _S.TAKEOFF,
        _E.START: _S.TAKEOFF,
        _E.LAND: _S.LANDING,
        _E.DISARM: _IN_FLIGHT,
        _E.KILL: _S.STANDBY,
        _E.CLIMBED: _S.TRACKING,
        _E.REFERENCE_ENDED: _NOT_TRACKING,
        _E.HELD: _NOT_HOLDING,
        _E.TOUCHDOWN: _NOT_LANDING,
        _E.IDLED: _NOT_IDLE,
        _E.MOCAP_LOST: _S.FAILSAFE,
        _E.LINK_LOST: _S.FAILSAFE,
        _E.TILTED: _S.FAILSAFE,
    },
    _S.TRACKING: {
        _E.BOOTED: _BOOTED,
        _E.ARM: _S.TRACKING,
        _E.START: _S.TRACKING,
        _E.LAND: _S.LANDING,
        _E.DISARM: _IN_FLIGHT,
        _E.KILL: _S.STANDBY,
        _E.CLIMBED: _NOT_CLIMBING,
        _E.REFERENCE_ENDED: _S.HOLD,
        _E.HELD: _NOT_HOLDING,
        _E.TOUCHDOWN: _NOT_LANDING,
        _E.IDLED: _NOT_IDLE,
        _E.MOCAP_LOST: _S.FAILSAFE,
        _E.LINK_LOST: _S.FAILSAFE,
        _E.TILTED: _S.FAILSAFE,
    },
    _S.HOLD: {
        _E.BOOTED: _BOOTED,
        _E.ARM: _S.HOLD,
        _E.START: "the reference has been flown: land, then arm again",
        _E.LAND: _S.LANDING,
        _E.DISARM: _IN_FLIGHT,
        _E.KILL: _S.STANDBY,
        _E.CLIMBED: _NOT_CLIMBING,
        _E.REFERENCE_ENDED: _NOT_TRACKING,
        _E.HELD: _S.LANDING,
        _E.TOUCHDOWN: _NOT_LANDING,
        _E.IDLED: _NOT_IDLE,
        _E.MOCAP_LOST: _S.FAILSAFE,
        _E.LINK_LOST: _S.FAILSAFE,
        _E.TILTED: _S.FAILSAFE,
    },
    _S.LANDING: {
        _E.BOOTED: _BOOTED,
        _E.ARM: "landing",
        _E.START: "landing",
        _E.LAND: _S.LANDING,
        _E.DISARM: _IN_FLIGHT,
        _E.KILL: _S.STANDBY,
        _E.CLIMBED: _NOT_CLIMBING,
        _E.REFERENCE_ENDED: _NOT_TRACKING,
        _E.HELD: _NOT_HOLDING,
        _E.TOUCHDOWN: _S.STANDBY,
        _E.IDLED: _NOT_IDLE,
        _E.MOCAP_LOST: _S.FAILSAFE,
        _E.LINK_LOST: "landing in place already",
        _E.TILTED: _S.FAILSAFE,
    },
    _S.FAILSAFE: {
        _E.BOOTED: _BOOTED,
        _E.ARM: _ENDING,
        _E.START: _ENDING,
        _E.LAND: _ENDING,
        _E.DISARM: _IN_FLIGHT,
        _E.KILL: _S.STANDBY,
        _E.CLIMBED: _NOT_CLIMBING,
        _E.REFERENCE_ENDED: _NOT_TRACKING,
        _E.HELD: _NOT_HOLDING,
        _E.TOUCHDOWN: _S.STANDBY,
        _E.IDLED: _NOT_IDLE,
        _E.MOCAP_LOST: _S.FAILSAFE,
        _E.LINK_LOST: _S.FAILSAFE,
        _E.TILTED: _S.FAILSAFE,
    },
}

FLYING = frozenset({State.TAKEOFF, State.TRACKING, State.HOLD, State.LANDING, State.FAILSAFE})
"""States in which the rotors may turn."""


def _checked(rows: Mapping[State, Mapping[Event, State | str]]) -> Mapping[tuple[State, Event], Outcome]:
    """The table by (state, event), after its own identities have been checked."""
    table: dict[tuple[State, Event], Outcome] = {}
    failures = {Event.MOCAP_LOST, Event.LINK_LOST, Event.TILTED}
    for state in State:
        for event in Event:
            cell = rows[state][event]  # a missing pair is a KeyError on import
            if isinstance(cell, str):
                table[state, event] = Outcome(state=state, refusal=cell)
                continue
            table[state, event] = Outcome(state=cell)
            assert cell is not State.BOOT, "only power leads into boot"
            if cell is State.FAILSAFE:
                assert state in FLYING, "a failsafe flies the vehicle: on the floor it disarms"
                assert event in failures, "only a failure leads into failsafe"
            elif state in FLYING:
                assert event not in failures, "a failure in the air leads nowhere else"
    return MappingProxyType(table)


TRANSITIONS = _checked(_ROWS)
"""Outcome of every event in every state."""


def update(state: State, event: Event) -> Outcome:
    """The outcome of `event` in `state`: the next state, or the same state with the reason of the refusal."""
    return TRANSITIONS[state, event]
