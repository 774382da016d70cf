"""What the flight MCU does about trouble: one row a condition.

A condition lasts for its time, then its event goes to the supervisor, and where that leads into FAILSAFE its
action is taken. Actions are ordered: once one is under way only a higher one replaces it. On the floor the
same conditions refuse arming or disarm.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from trimtab.firmware_model.flight.supervisor import Event


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
    """One row of the table.

    what: the condition; bound, timeout: the parameters it is judged by and timed by (seconds); lasting: it
    must last that long, else the time is what it is measured over. event is raised, action taken because of
    why; clears: who or what ends it. text: what people read.
    """

    failsafe: Failsafe
    event: Event
    what: str
    bound: str | None = None
    timeout: str | None = None
    lasting: bool = True
    action: Action
    why: str
    clears: str
    text: str


_NEXT_ARMING = "the next arming"

CONDITIONS: tuple[Condition, ...] = (
    Condition(
        failsafe=Failsafe.TILT,
        event=Event.TILTED,
        what="tilt beyond the bound",
        bound="FS_TILT_DEG",
        timeout="FS_TILT_S",
        action=Action.MOTORS_OFF,
        why="control is lost; rotors that turn make the fall worse",
        clears=_NEXT_ARMING,
        text="tilted too far: motors off",
    ),
    Condition(
        failsafe=Failsafe.IMU_STUCK,
        event=Event.IMU_STUCK,
        what="gyro and accelerometer repeat the same sample",
        timeout="FS_IMU_S",
        action=Action.MOTORS_OFF,
        why="without body rates no attitude is held; it tips within tenths of a second and would fly off",
        clears=_NEXT_ARMING,
        text="IMU stuck: motors off",
    ),
    Condition(
        failsafe=Failsafe.MOCAP_LOST,
        event=Event.MOCAP_LOST,
        what="no pose used by the estimator",
        timeout="FS_MOCAP_S",
        action=Action.LEVEL_DESCENT,
        why="position is a guess after a second, attitude is not",
        clears="a pose before that; then the next arming",
        text="mocap lost: descending level",
    ),
    Condition(
        failsafe=Failsafe.MOCAP_LOST,
        event=Event.MOCAP_LATE,
        what="newest pose used older than the bound",
        bound="FS_AGE_S",
        timeout="FS_LATE_S",
        action=Action.LAND_IN_PLACE,
        why="position is known, but late: a gap is flown through, a link that stays late is not",
        clears="a fresh pose before that; then the next arming",
        text="mocap late: landing in place",
    ),
    Condition(
        failsafe=Failsafe.GEOFENCE,
        event=Event.FENCE_LEFT,
        what="estimated position outside FENCE_* by more than the bound",
        bound="FS_FENCE_M",
        timeout="FS_FENCE_S",
        action=Action.LAND_IN_PLACE,
        why="whatever took it there may take it further; a way back is a way through people",
        clears="being back before that; then the next arming",
        text="outside the fence: landing in place",
    ),
    Condition(
        failsafe=Failsafe.SATURATED,
        event=Event.SATURATED,
        what="motors saturated on nine of ten ticks or more",
        timeout="FS_SAT_S",
        action=Action.LAND_IN_PLACE,
        why="what is asked for cannot be had; a descent asks for less",
        clears="motors that suffice before that; then the next arming",
        text="motors saturated: landing in place",
    ),
    Condition(
        failsafe=Failsafe.BATTERY_LOW,
        event=Event.BATTERY_LOW,
        what="smoothed voltage below this share between BAT_EMPTY_V and BAT_FULL_V",
        bound="FS_BAT_SHARE",
        timeout="FS_BAT_S",
        lasting=False,
        action=Action.LAND_IN_PLACE,
        why="there is charge for a landing, not for much more",
        clears="the next arming, with a fuller battery",
        text="battery low: landing in place",
    ),
    Condition(
        failsafe=Failsafe.LOOP_OVERRUN,
        event=Event.LOOP_OVERRUN,
        what="late ticks, as many as the bound",
        bound="FS_LOOP_MAX",
        timeout="FS_LOOP_S",
        lasting=False,
        action=Action.LAND_IN_PLACE,
        why="the law is not computed at its rate; a single late tick does no harm",
        clears=_NEXT_ARMING,
        text="ticks too late: landing in place",
    ),
    Condition(
        failsafe=Failsafe.LINK_LOST,
        event=Event.LINK_LOST,
        what="no message from a host but poses",
        timeout="FS_LINK_S",
        action=Action.LAND_IN_PLACE,
        why="position is known: land where it is",
        clears="a message before that; then the next arming",
        text="link lost: landing in place",
    ),
    Condition(
        failsafe=Failsafe.NONE,
        event=Event.SETPOINTS_LOST,
        what="no setpoint in OFFBOARD",
        timeout="FS_OFFB_S",
        action=Action.HOLD,
        why="no failure of the vehicle: it stops and lands after FS_OFFB_HOLD_S",
        clears="the operator: hold, or offboard once setpoints come again",
        text="setpoints lost: holding, then landing",
    ),
    Condition(
        failsafe=Failsafe.NONE,
        event=Event.REFERENCE_ENDED,
        what="the last node has been passed",
        action=Action.HOLD,
        why="no failure: it lands after HOLD_S",
        clears="the operator: hold, or offboard",
        text="reference ended: holding, then landing",
    ),
)

BY_EVENT: dict[Event, Condition] = {row.event: row for row in CONDITIONS}


def escalate(current: Action, condition: Condition) -> Action:
    """Return the action to take when `condition` strikes while `current` is under way: the higher of the
    two.
    """
    return max(current, condition.action)
