"""What the flight MCU does about trouble: one row a condition.

A condition holds for its timeout, then its event goes to the supervisor, and where that leads into FAILSAFE
its action is taken. Actions are ordered: once one is under way only a higher one replaces it.

| condition | what counts | why this action |
|---|---|---|
| tilt | tilt beyond FS_TILT_DEG | control is lost; rotors that turn make the fall worse |
| mocap lost | no pose used by the estimator | position is a guess after a second, attitude is not |
| link lost | no message from the host but poses | position is known: land where it is |
| reference ended | the last node has been passed | no failure: hold, then land |
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from firmware_model.supervisor import Event


class Action(IntEnum):
    """What is done, by rank."""

    NONE = 0
    HOLD = 1
    LAND_IN_PLACE = 2
    LEVEL_DESCENT = 3
    MOTORS_OFF = 4


class Failsafe(IntEnum):
    """Which failure ended the flight; the values travel in FC_STATUS and stay until the next arming."""

    NONE = 0
    MOCAP_LOST = 1
    LINK_LOST = 2
    TILT = 3
    BATTERY_LOW = 4
    SATURATED = 5
    IMU_STUCK = 6
    LOOP_OVERRUN = 7
    GEOFENCE = 8


@dataclass(frozen=True, kw_only=True)
class Condition:
    """One row of the table: the parameter (seconds) that times it, the event it raises, what is then done."""

    failsafe: Failsafe
    event: Event
    timeout: str | None
    action: Action
    text: str


CONDITIONS: tuple[Condition, ...] = (
    Condition(
        failsafe=Failsafe.TILT,
        event=Event.TILTED,
        timeout="FS_TILT_S",
        action=Action.MOTORS_OFF,
        text="tilted too far: motors off",
    ),
    Condition(
        failsafe=Failsafe.MOCAP_LOST,
        event=Event.MOCAP_LOST,
        timeout="FS_MOCAP_S",
        action=Action.LEVEL_DESCENT,
        text="mocap lost: descending level",
    ),
    Condition(
        failsafe=Failsafe.LINK_LOST,
        event=Event.LINK_LOST,
        timeout="FS_LINK_S",
        action=Action.LAND_IN_PLACE,
        text="link lost: landing in place",
    ),
    Condition(
        failsafe=Failsafe.NONE,
        event=Event.SETPOINTS_LOST,
        timeout="FS_OFFB_S",
        action=Action.HOLD,
        text="setpoints lost: holding, then landing",
    ),
    Condition(
        failsafe=Failsafe.NONE,
        event=Event.REFERENCE_ENDED,
        timeout=None,
        action=Action.HOLD,
        text="reference ended: holding, then landing",
    ),
)

BY_EVENT: dict[Event, Condition] = {row.event: row for row in CONDITIONS}


def escalate(current: Action, condition: Condition) -> Action:
    """The action to take when `condition` strikes while `current` is under way: the higher of the two."""
    return max(current, condition.action)
