"""Stream of a host-side controller's commands during a flight, without I/O.

The vehicle climbs on board and holds. The host then sends it to the first node of the reference in its
offboard mode, by position setpoints. Once it rests there, the controller takes over: LEAD_US before the
start of the reference, to HOLD_US after its end, when the host commands the landing.

A step at time t gets the newest FC_ESTIMATE. Its command is sent at t plus the declared computing time, and
is expected to act the uplink's delay later, which `ClockSync.uplink_us` estimates. All times that the
controller sees are on the vehicle's clock, since the start of the reference.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from enum import Enum
from typing import NamedTuple

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.firmware_model.law.rotations import matrix_to_euler, quat_to_matrix
from trimtab.host.control.interface import ControlStep, RateCommand, StateEstimate
from trimtab.host.link.client import NEVER_US, Client
from trimtab.host.link.host_control import ControlStop, HostControl
from trimtab.host.link.tasks import RETRY_US, command_message
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Reference
from trimtab.protocol.messages import Message, mavlink
from trimtab.protocol.telemetry import TICK_US, decode_quaternion

LEAD_US = 1_000_000
"""Time from the controller's first step to the start of the reference."""
HOLD_US = 1_000_000
"""Time from the end of the reference to the command to land, in which the controller holds the last node."""
ESTIMATE_AGE_MAX_US = 250_000
"""Age of the newest estimate above which no command is sent any more."""
SETPOINT_US = 100_000
"""Interval of position setpoints on the way to the first node."""
APPROACH_MAX_US = 30_000_000
"""Longest time from the first position setpoint to rest at the first node."""
NEAR_M, SLOW_M_S, ALIGNED_RAD = 0.25, 0.1, 0.1
"""Bounds of position error, speed and yaw error at rest at the first node."""
RESTING_US = 300_000
"""Time for which the estimate must be within these bounds."""

_ON_THE_WAY = (mavlink.TRIMTAB_STATE_HOLD, mavlink.TRIMTAB_STATE_OFFBOARD)
_PX4_OFFBOARD = 6.0
_POSITION_AND_YAW = (
    mavlink.POSITION_TARGET_TYPEMASK_VX_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_VY_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_VZ_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_AX_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_AY_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_AZ_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
)


class StepRecord(NamedTuple):
    """One control step: times since the start of the reference, and how late its command was sent."""

    t_us: int
    estimate_age_us: int
    act_us: int
    late_us: int
    step: ControlStep


class Stage(Enum):
    """Stages of a stream."""

    CLIMBING = 0
    APPROACHING = 1
    STREAMING = 2
    LANDING = 3
    OVER = 4


class ControlStream:
    """Companion of FollowFlight that flies `reference` by the commands of a controller.

    Parameters
    ----------
    mass_kg, thrust_max_n
        Of the vehicle; `thrust_max_n` of one rotor, as the vehicle scales thrust setpoints.
    on_begin
        Called with the start of the reference (vehicle's clock, us) and the host's time when the controller
        takes over.
    on_step
        Called with every step and the host's time, when its command is sent or when it gave none.

    Attributes
    ----------
    deadline_us
        Latest time of the next call of `advance`.
    stop
        Why the stream ended before the reference did; None until then, or if it did not.
    finished
        Whether the controller has flown the reference to its end.
    """

    wants: tuple[type[Message], ...] = (m.FcEstimate,)

    def __init__(
        self,
        control: HostControl,
        reference: Reference,
        *,
        mass_kg: float,
        thrust_max_n: float,
        on_begin: Callable[[int, int], None],
        on_step: Callable[[StepRecord, int], None],
    ) -> None:
        self.deadline_us = NEVER_US
        self.stop: ControlStop | None = None
        self.finished = False
        self._control = control
        self._reference = reference
        self._first_ned = reference.nodes_ned()[0].state[:3]
        self._first_yaw = reference.yaw_nodes()[0].yaw
        self._thrust_scale = 1.0 / (4.0 * thrust_max_n)
        self._hover_n = mass_kg * GRAVITY
        self._on_begin, self._on_step = on_begin, on_step
        self._stage = Stage.CLIMBING
        self._estimate: m.FcEstimate | None = None
        self._offboard = False
        self._approach_us = 0
        self._setpoint_us = 0
        self._command_us = 0
        self._rest_us = NEVER_US
        self._start_us = 0
        self._next_us = 0
        self._sent: deque[RateCommand] = deque()
        self._pending: tuple[int, StepRecord] | None = None

    def status(self, client: Client, message: m.FcStatus, now_us: int) -> None:
        """Begin the approach when the climb has ended; end the stream when the vehicle leaves OFFBOARD."""
        self._offboard = message.state == mavlink.TRIMTAB_STATE_OFFBOARD
        if self._stage is Stage.CLIMBING and message.state == mavlink.TRIMTAB_STATE_HOLD:
            self._stage = Stage.APPROACHING
            self._approach_us = self._setpoint_us = now_us
            self._command_us = now_us + SETPOINT_US  # the vehicle must know a setpoint first
            self.deadline_us = now_us
        elif self._stage is Stage.APPROACHING and message.state not in _ON_THE_WAY:
            self._end(ControlStop.START_MISSED)
        elif self._stage in (Stage.STREAMING, Stage.LANDING) and not self._offboard:
            self._end(ControlStop.LEFT_OFFBOARD)

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        """Take the newest estimate; begin to stream once it rests at the first node."""
        assert isinstance(message, m.FcEstimate)
        if self._estimate is not None and message.tick <= self._estimate.tick:
            return
        self._estimate = message
        if self._stage is Stage.APPROACHING and self._offboard:
            if not self._is_at_start(message):
                self._rest_us = NEVER_US
            elif self._rest_us == NEVER_US:
                self._rest_us = now_us
            elif now_us - self._rest_us >= RESTING_US:
                self._begin(client, message, now_us)

    def advance(self, client: Client, now_us: int) -> None:
        """Send what is due, and take the controller's step that is due."""
        if self._stage is Stage.APPROACHING:
            self._approach(client, now_us)
            return
        self._send_if_due(client, now_us)
        if self._stage is Stage.STREAMING and self._time_us(client, now_us) >= self._end_us:
            self.finished = True
            self._stage, self._command_us = Stage.LANDING, now_us
        if self._stage is Stage.LANDING and now_us >= self._command_us:
            self._command_us = now_us + RETRY_US
            client.send(command_message(mavlink.MAV_CMD_NAV_LAND))
        steering = self._stage in (Stage.STREAMING, Stage.LANDING)
        if steering and self._pending is None and now_us >= self._next_us:
            self._step(client, now_us)
            self._send_if_due(client, now_us)
        self._plan()

    @property
    def _end_us(self) -> int:
        return self._reference.duration_us + HOLD_US

    def _plan(self) -> None:
        """Set the deadline to whatever comes next."""
        if self._stage is Stage.OVER:
            self.deadline_us = NEVER_US
            return
        self.deadline_us = self._next_us if self._pending is None else self._pending[0]

    def _end(self, stop: ControlStop) -> None:
        self._stage, self._pending = Stage.OVER, None
        self.stop = None if self.finished else stop
        self.deadline_us = NEVER_US

    # The way to the first node.

    def _approach(self, client: Client, now_us: int) -> None:
        if now_us - self._approach_us >= APPROACH_MAX_US:
            client.send(command_message(mavlink.MAV_CMD_NAV_LAND))
            self._end(ControlStop.START_MISSED)
            return
        if now_us >= self._setpoint_us:
            self._setpoint_us = now_us + SETPOINT_US
            client.send(self._first_node())
        if now_us >= self._command_us and not self._offboard:
            self._command_us = now_us + RETRY_US
            mode = (float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), _PX4_OFFBOARD)
            client.send(command_message(mavlink.MAV_CMD_DO_SET_MODE, mode))
        self.deadline_us = self._setpoint_us if self._offboard else min(self._setpoint_us, self._command_us)

    def _first_node(self) -> Message:
        north, east, down = self._first_ned
        return m.SetPositionTarget(
            time_boot_ms=0,
            target_system=m.VEHICLE[0],
            target_component=m.VEHICLE[1],
            coordinate_frame=mavlink.MAV_FRAME_LOCAL_NED,
            type_mask=_POSITION_AND_YAW,
            x=north,
            y=east,
            z=down,
            vx=0.0,
            vy=0.0,
            vz=0.0,
            afx=0.0,
            afy=0.0,
            afz=0.0,
            yaw=self._first_yaw,
            yaw_rate=0.0,
        )

    def _is_at_start(self, estimate: m.FcEstimate) -> bool:
        _, _, yaw = matrix_to_euler(FLOAT, quat_to_matrix(FLOAT, decode_quaternion(estimate.q)))
        turn = math.remainder(yaw - self._first_yaw, 2.0 * math.pi)
        distance = math.dist(estimate.p, self._first_ned)
        return distance < NEAR_M and math.hypot(*estimate.v) < SLOW_M_S and abs(turn) < ALIGNED_RAD

    # The stream.

    def _begin(self, client: Client, estimate: m.FcEstimate, now_us: int) -> None:
        """Choose the start of the reference, a whole tick of the vehicle, and start the controller."""
        vehicle_us = round(now_us + client.clock.offset_us)
        self._start_us = (vehicle_us + LEAD_US) // TICK_US * TICK_US
        self._stage = Stage.STREAMING
        self._next_us = now_us
        # Until the first command the vehicle hovers at rest under its own law.
        rest_us = estimate.tick * TICK_US - self._start_us
        self._sent.append(RateCommand(rest_us, (0.0, 0.0, 0.0), self._hover_n))
        self._control.controller.begin(self._reference)
        self._on_begin(self._start_us, now_us)
        self.deadline_us = now_us

    def _time_us(self, client: Client, now_us: int) -> int:
        """Return the present time on the vehicle's clock since the start of the reference."""
        return round(now_us + client.clock.offset_us) - self._start_us

    def _step(self, client: Client, now_us: int) -> None:
        """Take one step of the controller with the newest estimate."""
        control, message = self._control, self._estimate
        assert message is not None
        period_us = control.controller.period_us
        self._next_us += period_us * (1 + (now_us - self._next_us) // period_us)
        t_us = self._time_us(client, now_us)
        estimate_us = message.tick * TICK_US - self._start_us
        age_us = max(0, t_us - estimate_us)
        if age_us > ESTIMATE_AGE_MAX_US:
            self._end(ControlStop.ESTIMATES_LOST)
            return
        while len(self._sent) > 1 and self._sent[1].t_us <= estimate_us:
            self._sent.popleft()
        act_us = t_us + control.computing_us + round(client.clock.uplink_us)
        estimate = StateEstimate(
            estimate_us,
            (message.p[0], message.p[1], message.p[2]),
            (message.v[0], message.v[1], message.v[2]),
            decode_quaternion(message.q),
            (message.rate[0], message.rate[1], message.rate[2]),
        )
        step = control.controller.step(estimate, tuple(self._sent), act_us)
        record = StepRecord(t_us, age_us, act_us, 0, step)
        if step.command is None:
            self._on_step(record, now_us)
            if not self.finished:
                self._end(ControlStop.NO_COMMAND)
            return
        if not all(map(math.isfinite, (*step.command.rate_frd, step.command.collective_n))):
            raise ValueError(f"{control.name}: a command that is not finite at {1e-6 * t_us:.3f} s")
        self._pending = (now_us + control.computing_us, record)

    def _send_if_due(self, client: Client, now_us: int) -> None:
        """Send the command of a step whose computing time has passed."""
        if self._pending is None or now_us < self._pending[0]:
            return
        due_us, record = self._pending
        self._pending = None
        command = record.step.command
        assert command is not None
        late_us = now_us - due_us
        client.send(
            m.SetAttitudeTarget(
                0,
                *m.VEHICLE,
                mavlink.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE,
                (1.0, 0.0, 0.0, 0.0),
                *command.rate_frd,
                command.collective_n * self._thrust_scale,
            )
        )
        self._sent.append(command._replace(t_us=record.act_us + late_us))
        self._on_step(record._replace(late_us=late_us), now_us)
