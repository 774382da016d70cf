"""Checks before arming another autopilot: each returns what is wrong, in one sentence with the remedy."""

from __future__ import annotations

import math
from collections.abc import Iterator

from trimtab.host.autopilot.kinds import AutopilotKind
from trimtab.host.autopilot.situation import Situation
from trimtab.host.base.errors import Refused
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import Reference
from trimtab.protocol.messages import mavlink

START_M = 1.0
"""Greatest horizontal distance from the vehicle on the floor to the first node."""
POSE_AGE_US = 200_000
"""Greatest age of the newest pose."""
ESTIMATE_AGE_US = 500_000
"""Greatest age of the autopilot's position and attitude."""
STILL_M_S = 0.15
"""Greatest speed of the estimate on the floor."""
AGREE_M, AGREE_RAD = 0.15, 0.2
"""Greatest difference between the autopilot's estimate and the cameras' pose, on the floor."""
SILENT_US = 3_500_000
"""Greatest age of the newest heartbeat."""
_AXES = ("north", "east")


def check_limits(reference: Reference, vehicle: Vehicle) -> None:
    """Raise Refused if the reference breaks a limit of the vehicle file, its geofence included.

    The host checks this in place of the vehicle: another autopilot does not.
    """
    from trimtab.host.plan.judge import on_board_verdict

    verdict = on_board_verdict(reference, vehicle)
    if not verdict.ok:
        raise Refused(
            f"the reference breaks a limit of {vehicle.name}, {verdict.message}; plan it for this vehicle, "
            "or give the right --vehicle"
        )


def problems(
    situation: Situation, reference: Reference, vehicle: Vehicle, now_us: int, *, arming: bool = False
) -> Iterator[str]:
    """Yield what speaks against arming now, the most basic problem first.

    arming: whether the command to arm may have been sent, so that an armed autopilot is no problem.
    """
    kind = situation.kind
    if situation.heartbeat_us is None or now_us - situation.heartbeat_us > SILENT_US:
        yield "no heartbeat arrives; check the link"
    if situation.pose_age_us(now_us) > POSE_AGE_US or situation.pose is None:
        yield "no poses arrive from the cameras; check that the body is tracked"
        return
    if situation.armed and not arming:
        yield "it is armed already; disarm it"
    if situation.landed not in (None, mavlink.MAV_LANDED_STATE_ON_GROUND, mavlink.MAV_LANDED_STATE_UNDEFINED):
        yield "it does not report that it is on the ground; put it on the floor"
    yield from _estimate(situation, kind, now_us)
    yield from _place(situation, reference, vehicle)
    if situation.health is not None and not situation.armed and not _ready(situation):
        yield "its own pre-arm check fails; see its ground station for the reason"


def _estimate(situation: Situation, kind: AutopilotKind, now_us: int) -> Iterator[str]:
    """Yield what is wrong with the autopilot's estimate of its own pose."""
    apart, position = situation.disagreement(), situation.position
    if apart is None or position is None or situation.estimate_age_us(now_us) > ESTIMATE_AGE_US:
        yield f"it sends no fresh local position or attitude; {kind.pose_advice}"
        return
    if not apart[0] <= AGREE_M:
        yield (
            f"its position differs from the cameras' by {1e3 * apart[0]:.0f} mm; {kind.pose_advice}, and "
            "check that the poses are NED and their origin is the autopilot's"
        )
    elif not apart[1] <= AGREE_RAD:
        yield (
            f"its yaw differs from the cameras' by {math.degrees(apart[1]):.0f} deg; {kind.pose_advice}, "
            "and check the axes of the tracked body"
        )
    elif not math.hypot(position.vx, position.vy, position.vz) <= STILL_M_S:
        yield "its estimate moves on the floor; keep it still until the estimate has settled"


def _place(situation: Situation, reference: Reference, vehicle: Vehicle) -> Iterator[str]:
    """Yield what is wrong with the place where the vehicle stands."""
    assert situation.pose is not None
    first, p = reference.nodes_ned()[0].state[:3], situation.pose.p_ned
    for axis, value, (low, high) in zip(_AXES, p, vehicle.limits.geofence_m, strict=False):
        if not low <= value <= high:
            yield f"it stands outside the geofence, {axis} {value:.2f} m ({low:g} to {high:g})"
    apart_m = math.dist(first[:2], p[:2])
    if apart_m > START_M:
        yield (
            f"it stands {apart_m:.1f} m from the start of the reference; put it below "
            f"north {first[0]:.2f} m, east {first[1]:.2f} m"
        )
    if first[2] > p[2]:
        yield "the reference starts below it; plan the reference above the floor"


def _ready(situation: Situation) -> bool:
    """Return whether the autopilot's own pre-arm check passes, or is not reported."""
    health, bit = situation.health, mavlink.MAV_SYS_STATUS_PREARM_CHECK
    assert health is not None
    reported = health.onboard_control_sensors_present & bit
    return not reported or bool(health.onboard_control_sensors_health & bit)
