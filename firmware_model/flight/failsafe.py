"""The failsafe table: one row for each condition.

If a condition lasts for its time, its event goes to the supervisor. If that leads into FAILSAFE, the vehicle
takes the action of the row. Actions are ranked: an active action is replaced only by a higher one. On the
floor the conditions disarm an armed vehicle; most of them also refuse arming (`readiness.CHECKS`).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from trimtab.firmware_model.flight.supervisor import Event


class Action(IntEnum):
    """Actions of the failsafes, by rank."""

    NONE = 0
    HOLD = 1
    LAND_IN_PLACE = 2
    LEVEL_DESCENT = 3
    MOTORS_OFF = 4


class Failsafe(IntEnum):
    """Failures, as FC_STATUS reports the last one that disarmed the vehicle or led into FAILSAFE.

    FC_STATUS reports its value until the next arming.
    """

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

    Parameters
    ----------
    failsafe, event, action
        Reported failure, event for the supervisor, and action. For HOLD the vehicle enters the state HOLD,
        not FAILSAFE.
    description
        The condition.
    bound, timeout
        Names of the parameters with its bound and its time (s).
    lasting
        True: the condition must hold for `timeout`. False: `timeout` is the filter time or counting window,
        and the event follows at once.
    rationale
        Reason for the action.
    clears
        Who or what ends the condition.
    text
        Message for people.
    """

    failsafe: Failsafe
    event: Event
    description: str
    bound: str | None = None
    timeout: str | None = None
    lasting: bool = True
    action: Action
    rationale: str
    clears: str
    text: str


_NEXT_ARMING = "the next arming"

CONDITIONS: tuple[Condition, ...] = (
    Condition(
        failsafe=Failsafe.TILT,
        event=Event.TILTED,
        description="tilt beyond the bound",
        bound="FS_TILT_DEG",
        timeout="FS_TILT_S",
        action=Action.MOTORS_OFF,
        rationale="control is lost; spinning rotors make a crash worse",
        clears=_NEXT_ARMING,
        text="tilted too far: motors off",
    ),
    Condition(
        failsafe=Failsafe.IMU_STUCK,
        event=Event.IMU_STUCK,
        description="gyro and accelerometer repeat the same sample",
        timeout="FS_IMU_S",
        action=Action.MOTORS_OFF,
        rationale="without body rates the vehicle tips over within tenths of a second and would fly off",
        clears=_NEXT_ARMING,
        text="IMU stuck: motors off",
    ),
    Condition(
        failsafe=Failsafe.MOCAP_LOST,
        event=Event.MOCAP_LOST,
        description="no pose used by the estimator",
        timeout="FS_MOCAP_S",
        action=Action.LEVEL_DESCENT,
        rationale="the position estimate is unreliable after a second, the attitude estimate is not",
        clears="before the timeout: a pose; after it: the next arming",
        text="mocap lost: descending level",
    ),
    Condition(
        failsafe=Failsafe.MOCAP_LOST,
        event=Event.MOCAP_LATE,
        description="the newest pose used is older than the bound",
        bound="FS_AGE_S",
        timeout="FS_LATE_S",
        action=Action.LAND_IN_PLACE,
        rationale="position is known, but late: short gaps are harmless, a permanent delay is not",
        clears="before the timeout: a recent pose; after it: the next arming",
        text="mocap late: landing in place",
    ),
    Condition(
        failsafe=Failsafe.GEOFENCE,
        event=Event.FENCE_LEFT,
        description="estimated position outside FENCE_* by more than the bound",
        bound="FS_FENCE_M",
        timeout="FS_FENCE_S",
        action=Action.LAND_IN_PLACE,
        rationale="the cause may take the vehicle further; the way back may lead through people",
        clears="before the timeout: a return; after it: the next arming",
        text="outside the fence: landing in place",
    ),
    Condition(
        failsafe=Failsafe.GEOFENCE,
        event=Event.FENCE_AHEAD,
        description="a stop would meet the floor too fast, or end outside FENCE_* (attitude commanded), or "
        "outside by more than the bound (far from the reference)",
        bound="FS_FENCE_M",
        action=Action.LAND_IN_PLACE,
        rationale="beyond this point even a full stop ends outside",
        clears=_NEXT_ARMING,
        text="fence or floor ahead: landing in place",
    ),
    Condition(
        failsafe=Failsafe.SATURATED,
        event=Event.SATURATED,
        description="motors saturated on nine of ten ticks or more",
        timeout="FS_SAT_S",
        action=Action.LAND_IN_PLACE,
        rationale="the rotors cannot meet the demand; a descent demands less",
        clears="before the timeout: an end of the saturation; after it: the next arming",
        text="motors saturated: landing in place",
    ),
    Condition(
        failsafe=Failsafe.BATTERY_LOW,
        event=Event.BATTERY_LOW,
        description="smoothed voltage below BAT_EMPTY_V + bound (BAT_FULL_V - BAT_EMPTY_V)",
        bound="FS_BAT_SHARE",
        timeout="FS_BAT_S",
        lasting=False,
        action=Action.LAND_IN_PLACE,
        rationale="the charge suffices for a landing, but not for much more",
        clears="the next arming, with a charged battery",
        text="battery low: landing in place",
    ),
    Condition(
        failsafe=Failsafe.LOOP_OVERRUN,
        event=Event.LOOP_OVERRUN,
        description="number of late ticks at the bound",
        bound="FS_LOOP_MAX",
        timeout="FS_LOOP_S",
        lasting=False,
        action=Action.LAND_IN_PLACE,
        rationale="the control law does not run at its rate; a single late tick is harmless",
        clears=_NEXT_ARMING,
        text="ticks too late: landing in place",
    ),
    Condition(
        failsafe=Failsafe.LINK_LOST,
        event=Event.LINK_LOST,
        description="no message from any ground station, poses excepted",
        timeout="FS_LINK_S",
        action=Action.LAND_IN_PLACE,
        rationale="position is known, so a landing in place is safe",
        clears="before the timeout: a message; after it: the next arming",
        text="link lost: landing in place",
    ),
    Condition(
        failsafe=Failsafe.NONE,
        event=Event.SETPOINTS_LOST,
        description="no setpoint in OFFBOARD",
        timeout="FS_OFFB_S",
        action=Action.HOLD,
        rationale="not a failure of the vehicle: it stops and lands after FS_OFFB_HOLD_S",
        clears="the operator: hold, or offboard once setpoints arrive again",
        text="setpoints lost: holding, then landing",
    ),
    Condition(
        failsafe=Failsafe.NONE,
        event=Event.REFERENCE_ENDED,
        description="end of the reference",
        action=Action.HOLD,
        rationale="not a failure: the vehicle lands after HOLD_S",
        clears="the operator: hold, or offboard",
        text="reference ended: holding, then landing",
    ),
)

BY_EVENT: dict[Event, Condition] = {row.event: row for row in CONDITIONS}


def escalate(current: Action, condition: Condition) -> Action:
    """Return the higher of the active action and that of `condition`."""
    return max(current, condition.action)
