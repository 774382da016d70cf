"""A flight by streamed setpoints, without I/O: from arming until the autopilot has disarmed.

The vehicle goes to the first node of the reference on a way of its own, follows the reference, holds and
lands. A setpoint is the reference at the time at which it is expected to act: the uplink's delay, which
`ClockSync.uplink_us` estimates, after it is sent.

The host keeps watching: poses, link, mode, geofence and tracking error. On any doubt it lands the vehicle. If
the autopilot has left the mode in which it follows setpoints, a pilot or a failsafe has taken over. Then the
host sends no more setpoints and no commands. A landing is commanded until the autopilot acknowledges it. If
the autopilot is silent, the host cannot see a pilot: after a few commands it sends nothing, and the
autopilot's own failsafe acts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from enum import Enum

from trimtab.host.autopilot.doubt import DOUBT_WORDS, Doubt
from trimtab.host.autopilot.setpoints import Course, Setpoint, Vector, Way, setpoint_of
from trimtab.host.autopilot.situation import Situation
from trimtab.host.base.errors import LinkError
from trimtab.host.link.client import Client
from trimtab.host.link.control_stream import ALIGNED_RAD, NEAR_M, RESTING_US, SLOW_M_S
from trimtab.host.link.flight_tasks import STRAY_US
from trimtab.host.link.tasks import RETRY_US, Task, command_message
from trimtab.host.vehicle import Vehicle
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Reference
from trimtab.protocol.messages import Message, mavlink

SETPOINT_US = 20_000
"""Interval of setpoints."""
APPROACH_M_S = 0.5
"""Peak speed on the way to the first node."""
APPROACH_MAX_US = 30_000_000
"""Longest time from the end of that way to rest at the first node; also for a take-off on board."""
HOLD_US = 1_000_000
"""Time at the last node before the host commands the landing."""
POSES_MAX_US = 300_000
"""Age of the newest pose above which the host lands the vehicle."""
SILENT_US = 1_500_000
"""Silence of the autopilot after which the host commands a landing."""
BEATS_US = 5_000_000
"""The same for its heartbeats, which come once a second and may be lost."""
BLIND_US = 2_000_000
"""Time for which a landing is commanded, and setpoints are sent, to an autopilot that is silent."""
ACKED_US = 3_000_000
"""Time after an acknowledged landing after which it is commanded again, if the mode does not show it."""
GONE_US = 30_000_000
"""Silence after which the host gives up."""
TAKEOFF_US, TAKEOFF_MAX_US = 1_000_000, 10_000_000
"""Interval of commands to take off without an answer, and the longest time on the floor after them."""
FLOOR_M = 0.15
"""Height above the place of arming below which the vehicle counts as on the floor."""
FAR_M = 1.0
"""Distance between pose and reference above which the host lands the vehicle."""
APART_M, APART_RAD = 0.5, 0.5
"""Distance and yaw between the autopilot's estimate and the pose above which the host lands the vehicle."""
APART_US = 200_000
"""Time for which they must be apart."""
ESTIMATE_AGE_US = 2_000_000
"""Age of that estimate above which the host lands the vehicle."""
FENCE_M = 0.3
"""How far beyond the geofence the vehicle may get: poses are noisy, and the floor is part of it."""


class Stage(Enum):
    """Stages of a flight. In all but LANDING and RELEASED setpoints are streamed."""

    TAKEOFF = "take-off"
    APPROACH = "to the start"
    TRACKING = "tracking"
    HOLD = "hold"
    LANDING = "landing"
    RELEASED = "released"


class StreamedFlight(Task):
    """Flies the reference once the autopilot is armed in the mode in which it follows setpoints.

    The task ends when two heartbeats in a row say that the autopilot is disarmed. It may be begun again after
    an interruption: it goes on where it was. Raises LinkError after a long silence.

    Parameters
    ----------
    situation
        Newest state of autopilot and cameras. Others keep its pose up to date.
    on_stage
        Called with every new stage.
    on_reference
        Called with every setpoint of the reference: the host's time at which it is to act, the time since
        the start of the reference (us) and the flat outputs (14).

    Attributes
    ----------
    doubt
        Why the host ended the flight early; None otherwise.
    finished
        Whether the reference was flown to its end.
    stage
        The present stage.
    """

    wants = (*Situation.wants, m.CommandAck)

    def __init__(
        self,
        situation: Situation,
        reference: Reference,
        vehicle: Vehicle,
        *,
        on_stage: Callable[[Stage], None],
        on_reference: Callable[[int, int, Sequence[float]], None],
    ) -> None:
        super().__init__()
        self.doubt: Doubt | None = None
        self.finished = False
        self.stage = Stage.TAKEOFF if situation.kind.takes_off else Stage.APPROACH
        self._situation = situation
        self._course = Course(reference)
        self._first = self._course.at(0).at_rest()
        self._fence = vehicle.limits.geofence_m
        self._on_stage, self._on_reference = on_stage, on_reference
        self._way: Way | None = None
        self._target: Setpoint | None = None
        self._floor: Vector | None = None
        self._begun = self._was_armed = False
        self._disarmed = 0  # heartbeats in a row
        self._began_us = self._start_us = self._next_us = self._command_us = 0
        self._landed_us: int | None = None  # the landing was acknowledged
        self._takeoff_acked = False
        self._landings = 0
        self._rest_us: int | None = None
        self._apart_us: int | None = None

    def land(self) -> None:
        """Land, unless a pilot or a failsafe has the vehicle."""
        if self.stage not in (Stage.LANDING, Stage.RELEASED):
            self._target = None if self._target is None else self._target.at_rest()
            self._command_us = 0
            self._enter(Stage.LANDING)

    def words(self) -> str:
        """Return the stage, and the doubt if there is one, for the log."""
        return self.stage.value if self.doubt is None else f"{self.stage.value}: {DOUBT_WORDS[self.doubt]}"

    def begin(self, client: Client, now_us: int) -> None:
        """Start at the present pose, or go on."""
        self.deadline_us = self._next_us = now_us
        if self._begun:
            return
        self._begun = True
        self._began_us = now_us
        pose = self._situation.pose
        assert pose is not None  # a check before arming
        self._floor = pose.p_ned
        if self.stage is not Stage.LANDING:
            self._on_stage(self.stage)
        if self.stage is Stage.APPROACH:
            self._target = Setpoint(pose.p_ned, yaw=pose.yaw)  # until its heartbeat shows that it is armed

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        """Take a message of the autopilot."""
        situation = self._situation
        if isinstance(message, m.CommandAck):
            self._acknowledged(message, now_us)
            return
        situation.receive(message, now_us)
        if situation.heartbeat_us != now_us or not isinstance(message, m.Heartbeat):
            return
        self._was_armed |= situation.armed
        self._disarmed = 0 if situation.armed else self._disarmed + 1
        if self._disarmed > 1 and (self._was_armed or now_us - self._began_us > STRAY_US):
            self.finish()

    def _acknowledged(self, message: m.CommandAck, now_us: int) -> None:
        if m.sender_of(message) != m.VEHICLE or message.result != mavlink.MAV_RESULT_ACCEPTED:
            return
        if message.command == mavlink.MAV_CMD_NAV_TAKEOFF:
            self._takeoff_acked = True
        elif self.stage is Stage.LANDING and any(message.command == n for n, _ in self._situation.kind.land):
            self._landed_us = now_us

    def advance(self, client: Client, now_us: int) -> None:
        """Send what is due."""
        if self._silence_us(now_us) >= GONE_US:
            raise LinkError(
                f"the autopilot has been silent for {GONE_US / 1e6:g} s; its own failsafe has it, check on it"
            )
        if self.stage not in (Stage.LANDING, Stage.RELEASED):
            self._watch(now_us)
        self._move_on(now_us)
        if self.stage is Stage.LANDING:
            self._command_landing(client, now_us)
        elif self.stage is not Stage.RELEASED:
            self._stream(client, now_us)
        self._next_us += SETPOINT_US * (1 + (now_us - self._next_us) // SETPOINT_US)
        self.deadline_us = self._next_us

    def _silence_us(self, now_us: int) -> int:
        """Return how long the autopilot has been silent."""
        heard_us = self._situation.heard_us
        return now_us - max(self._began_us, 0 if heard_us is None else heard_us)

    def _on_floor(self) -> bool:
        """Return whether the newest pose is as low as that at arming."""
        pose = self._situation.pose
        return pose is not None and self._floor is not None and self._floor[2] - pose.p_ned[2] < FLOOR_M

    # Stages.

    def _enter(self, stage: Stage) -> None:
        self.stage = stage
        self._on_stage(stage)

    def _approach(self, now_us: int) -> None:
        """Begin the way to the first node: straight up from the present pose, then across."""
        pose = self._situation.pose
        assert pose is not None  # checked before arming, and watched since
        above: Vector = (pose.p_ned[0], pose.p_ned[1], self._first.p[2])
        corners = (pose.p_ned, above, self._first.p)
        self._way = Way(corners, pose.yaw, self._first.yaw, speed_m_s=APPROACH_M_S)
        self._start_us = now_us
        if self.stage is not Stage.APPROACH:
            self._enter(Stage.APPROACH)

    def _move_on(self, now_us: int) -> None:
        """Go to the next stage when the present one has ended."""
        since_us = now_us - self._start_us
        if self.stage is Stage.TAKEOFF:
            pose = self._situation.pose
            if pose is not None and abs(pose.p_ned[2] - self._first.p[2]) < NEAR_M:
                self._approach(now_us)
            elif now_us - self._began_us >= (TAKEOFF_MAX_US if self._on_floor() else APPROACH_MAX_US):
                self._end(Doubt.NO_TAKEOFF if self._on_floor() else Doubt.START_MISSED)
        elif self.stage is Stage.APPROACH and self._way is None:
            if self._situation.armed:
                self._approach(now_us)
        elif self.stage is Stage.APPROACH and self._way is not None and since_us >= self._way.duration_us:
            if self._rests_at_start(now_us):
                self._start_us = now_us
                self._enter(Stage.TRACKING)
            elif since_us >= self._way.duration_us + APPROACH_MAX_US:
                self._end(Doubt.START_MISSED)
        elif self.stage is Stage.TRACKING and since_us >= self._course.duration_us:
            self.finished = True
            self._enter(Stage.HOLD)
        elif self.stage is Stage.HOLD and since_us >= self._course.duration_us + HOLD_US:
            self.land()

    def _rests_at_start(self, now_us: int) -> bool:
        """Return whether the vehicle has rested at the first node for RESTING_US. The estimate is watched."""
        pose, position = self._situation.pose, self._situation.position
        if pose is None or position is None:
            return False
        slow = math.hypot(position.vx, position.vy, position.vz) < SLOW_M_S
        turn = math.remainder(pose.yaw - self._first.yaw, 2.0 * math.pi)
        if not (slow and math.dist(pose.p_ned, self._first.p) < NEAR_M and abs(turn) < ALIGNED_RAD):
            self._rest_us = None
            return False
        if self._rest_us is None:
            self._rest_us = now_us
        return now_us - self._rest_us >= RESTING_US

    # Doubts.

    def _end(self, doubt: Doubt) -> None:
        """End the flight: land, or leave the vehicle to whoever has it."""
        self.doubt = doubt
        if doubt is Doubt.LEFT_MODE:
            self._enter(Stage.RELEASED)
        else:
            self.land()

    def _watch(self, now_us: int) -> None:
        """End the flight on the first doubt."""
        situation, pose = self._situation, self._situation.pose
        beat_us = max(self._began_us, situation.heartbeat_us or 0)
        if not situation.streamed:
            self._end(Doubt.LEFT_MODE)
        elif pose is None or situation.pose_age_us(now_us) > POSES_MAX_US:
            self._end(Doubt.POSES_STOPPED)
        elif self._silence_us(now_us) > SILENT_US or now_us - beat_us > BEATS_US:
            self._end(Doubt.LINK_SILENT)
        elif not all(
            low - FENCE_M <= x <= high + FENCE_M
            for x, (low, high) in zip(pose.p_ned, self._fence, strict=True)
        ):
            self._end(Doubt.LEFT_FENCE)
        elif math.dist(pose.p_ned, self._expected(pose.t_us)) > FAR_M:
            self._end(Doubt.FAR_OFF)
        elif situation.estimate_age_us(now_us) > ESTIMATE_AGE_US or self._is_apart(now_us):
            self._end(Doubt.ESTIMATE_WRONG)

    def _is_apart(self, now_us: int) -> bool:
        """Return whether estimate and poses have been apart for APART_US: a late message is no doubt."""
        apart = self._situation.disagreement()
        if apart is None:
            return False
        if apart[0] <= APART_M and apart[1] <= APART_RAD:
            self._apart_us = None
            return False
        if self._apart_us is None:
            self._apart_us = now_us
        return now_us - self._apart_us >= APART_US

    def _expected(self, t_us: int) -> Vector:
        """Return where the vehicle should be at the host's time `t_us`."""
        if self.stage in (Stage.TRACKING, Stage.HOLD):
            return self._course.at(t_us - self._start_us).p
        pose = self._situation.pose
        if self._way is None or pose is None:
            return self._first.p if pose is None else pose.p_ned
        return self._way.at(t_us - self._start_us).p

    # Messages.

    def _stream(self, client: Client, now_us: int) -> None:
        """Send the setpoint that is to act when it arrives, or the command to take off."""
        acts_us = now_us + round(client.clock.uplink_us)
        since_us = acts_us - self._start_us
        if self.stage is Stage.TAKEOFF:
            self._take_off(client, now_us)
            return
        if self.stage is Stage.APPROACH:
            if self._way is not None:
                self._target = self._way.at(since_us)
        else:
            flat = self._course.flat_at(since_us)
            self._target = setpoint_of(flat)
            if since_us <= self._course.duration_us + SETPOINT_US:
                self._on_reference(acts_us, min(since_us, self._course.duration_us), flat)
        assert self._target is not None
        client.send(self._target.message(now_us))

    def _take_off(self, client: Client, now_us: int) -> None:
        """Let the autopilot climb to the height of the first node.

        A copy may be refused because the vehicle already climbs: only the pose tells.
        """
        if self._takeoff_acked or not self._on_floor() or now_us < self._command_us:
            return
        assert self._floor is not None
        self._command_us = now_us + TAKEOFF_US
        height_m = self._floor[2] - self._first.p[2]
        client.send(command_message(mavlink.MAV_CMD_NAV_TAKEOFF, (*(0.0,) * 6, height_m)))

    def _command_landing(self, client: Client, now_us: int) -> None:
        """Command the landing until the autopilot acknowledges it, and hold until then; obey a pilot's mode.

        A vehicle that has not left the floor is also told to disarm, which it refuses in the air.
        """
        situation = self._situation
        on_floor = self._on_floor() and not self.finished
        if not situation.streamed and not on_floor:
            return
        if self._silence_us(now_us) > SILENT_US + BLIND_US:
            return
        if self._landed_us is not None and now_us - self._landed_us < ACKED_US:
            return
        if self._target is not None and situation.streamed:
            client.send(self._target.message(now_us))
        if now_us < self._command_us:
            return
        self._command_us = now_us + RETRY_US
        if situation.streamed:
            self._landed_us = None
            number, parameters = situation.kind.land[self._landings % len(situation.kind.land)]
            self._landings += 1
            client.send(command_message(number, parameters))
        if on_floor and situation.armed:
            client.send(command_message(mavlink.MAV_CMD_COMPONENT_ARM_DISARM))
