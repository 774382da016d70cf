"""Flight logic from power-up to power-off: law, supervisor and failsafes, tick by tick, without messages.

Inputs are events, poses and sensor samples. Messages for people are in `texts`.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from trimtab.firmware_model.clock import NEVER_US
from trimtab.firmware_model.flight.condition_monitor import (
    LEVEL,
    TOUCH_FORCE,
    ConditionMonitor,
    Observation,
    fence,
)
from trimtab.firmware_model.flight.course import Course
from trimtab.firmware_model.flight.dead_reckoning import DeadReckoning, near_floor_m
from trimtab.firmware_model.flight.engine import Engine, doubles
from trimtab.firmware_model.flight.envelope import Motion, stops_outside
from trimtab.firmware_model.flight.estimate import Estimate
from trimtab.firmware_model.flight.failsafe import BY_EVENT, Action, Condition, Failsafe, escalate
from trimtab.firmware_model.flight.feedforward import FeedForwardInput
from trimtab.firmware_model.flight.gate import CommandGate
from trimtab.firmware_model.flight.parameters import ParameterValues
from trimtab.firmware_model.flight.phases import Phases, ReferenceState
from trimtab.firmware_model.flight.readiness import StillnessDetector
from trimtab.firmware_model.flight.setpoints import Target
from trimtab.firmware_model.flight.supervisor import FLYING, Event, State, update
from trimtab.firmware_model.flight.track import Track
from trimtab.firmware_model.law import step as law
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.firmware_model.law.rotations import mat_vec, quat_to_matrix
from trimtab.protocol.messages import Station, station_name
from trimtab.protocol.telemetry import TICK_US

OFF_TRACK_M = 0.5
"""Distance (m) from its reference beyond which a vehicle is judged by its own stopping point."""
POSES_US = 200_000
"""Time since the last pose within which poses count as arriving."""
AFTER_DIRECT_US = 1_000_000
"""Time after a directly commanded attitude in which other setpoints are judged like it."""
BOOT_US = 200_000
"""Time from power to standby."""
UPDATE_TICKS = 10
"""Number of ticks between two checks of conditions, readiness and touchdown."""
UPDATE_S = 1e-6 * UPDATE_TICKS * TICK_US
"""The same in seconds."""
_CRITICAL, _WARNING, _INFO = 2, 4, 6  # MAV_SEVERITY

OBSERVED = (State.TRACKING, State.HOLD, State.OFFBOARD)
"""Entering TRACKING starts the disturbance observer. Entering HOLD or OFFBOARD leaves it as it is; entering
any other state stops it. Above 2 LAND_HEIGHT it is started in every flying state except LANDING and FAILSAFE.
While it is stopped its estimate is constant: in a landing it would interpret the floor as a disturbance.
"""
_END = {
    State.TRACKING: Event.REFERENCE_ENDED,
    State.HOLD: Event.HELD,
    State.LANDING: Event.TOUCHDOWN,
    State.FAILSAFE: Event.TOUCHDOWN,
}
"""Event at the end of a state's track. At the end of a descent's track the vehicle counts as landed even if
no touchdown was detected.
"""
_NAMED = (Event.HOLD, Event.OFFBOARD, Event.LAND, Event.DISARM, Event.KILL)
"""Commands whose station a text names: they end or interrupt a flight."""


class Flight:
    """Flight logic of one power-up; one object sees many flights. For a power cycle, build a new one.

    Parameters
    ----------
    engine
        `law.step` as an engine.
    parameters
        Values on board.

    Attributes
    ----------
    reference, feedforward
        Track to fly (or None) and feed-forward. Both may be replaced in standby. `swap` replaces the
        reference in flight.
    changed
        Set when FC_STATUS must be sent at once; whoever sends FC_STATUS resets it.
    course
        Who owns the flight, and what its commands and its tracking came to.
    conditions
        Active rows of the failsafe table at the last update, bit k for Failsafe k.
    texts
        Severities and texts for people; the reader removes them.
    """

    def __init__(self, *, engine: Engine, parameters: ParameterValues) -> None:
        self.parameters = parameters
        self.state = State.BOOT
        self.state_us = 0
        self.course = Course()
        self.failsafe = Failsafe.NONE
        self.action = Action.NONE
        self.conditions = 0
        self.reference: Track | None = None
        self.tracking_us: int | None = None
        self.texts: deque[tuple[int, str]] = deque()
        self.changed = True
        self.saturated_ticks = 0
        self.flight_ticks = 0
        self._direct_us = -AFTER_DIRECT_US
        self.monitor = ConditionMonitor(parameters)

        self._engine, self._run_law = engine, engine.run
        inputs, self.outputs = doubles(engine.inputs), doubles(engine.outputs)
        self._memory = inputs["memory"]
        self._memory_out = self.outputs["memory"]
        self._gyro, self._force = inputs["gyro"], inputs["specific_force"]
        self._observing = inputs["observing"]
        self._law_parameters = inputs["parameters"]
        self._saturated, self._cos_tilt = self.outputs["saturated"], self.outputs["cos_tilt"]
        self._takeoff_end = Event.START_REACHED
        self.feedforward = FeedForwardInput(inputs, self.outputs)
        self._phases = Phases(
            inputs,
            self.outputs,
            parameters=parameters,
            feedforward=self.feedforward,
            thrust_ratio=lambda: self.monitor.thrust_ratio,
            report=lambda text: self._report(_WARNING, text),
        )
        self._player, self._offboard = self._phases.player, self._phases.offboard

        self._dead_reckoning = DeadReckoning(self._memory)
        self._estimate = Estimate(inputs, parameters)
        self.poses, self.calibration = self._estimate.poses, self._estimate.calibration
        self._stillness = StillnessDetector()
        self._poses_waiting = self.poses.waiting
        self._flying = False
        self._gate = CommandGate(
            parameters=parameters,
            monitor=self.monitor,
            estimate=self._estimate,
            stillness=self._stillness,
            phases=self._phases,
            memory=self._memory,
            cos_tilt=self._cos_tilt,
        )
        for view in (*inputs.values(), *self.outputs.values()):
            view[:] = memoryview(bytes(8 * len(view))).cast("d")
        self._estimate.reset()
        self.feedforward.clear()
        self._offboard.release()
        self.configure()
        self._phases.stop_rotors(0)

    @property
    def rotors_on(self) -> bool:
        """Return whether the law drives the rotors."""
        return self._phases.rotors_on

    @property
    def gyro(self) -> tuple[float, float, float]:
        """Return the gyro sample of the last tick (rad/s, FRD)."""
        return (self._gyro[0], self._gyro[1], self._gyro[2])

    @property
    def home_ned(self) -> tuple[float, float, float] | None:
        """Return the position of the last take-off; None before the first."""
        return self._phases.home_ned

    @property
    def height_m(self) -> float:
        """Return the estimated height above the floor of the last take-off."""
        return self._phases.floor - self._memory[2]

    def has_pose(self, now_us: int) -> bool:
        """Return whether poses arrive."""
        return self._gate.has_pose(now_us)

    # Commands and measurements.

    def handle_event(
        self, event: Event, now_us: int, height_m: float | None = None, by: Station | None = None
    ) -> str | None:
        """Apply an event (a command or the end of a phase); return why it was refused, or None.

        height_m: height of a take-off; TAKEOFF_HEIGHT by default. by: station that gave the command.
        """
        outcome = update(self.state, event)
        refusal = outcome.refusal or self._gate.refusal(
            event,
            now_us,
            state=self.state,
            reference=self.reference,
            to_reference=self._takeoff_end is Event.START_REACHED,
            flown=self.tracking_us is not None,
        )
        if refusal is None and (outcome.state is not self.state or event is Event.HOLD):
            if event in _NAMED and by is not None:
                self._report(_INFO, f"{event.name.lower()} by station {station_name(by)}")
            self._enter(outcome.state, event, now_us, height_m, by)
        return refusal

    def setpoint(self, target: Target, now_us: int) -> None:
        """Store a setpoint, and follow it now if the state is OFFBOARD."""
        self._offboard.offer(target, now_us)
        if self.state is State.OFFBOARD:
            self.monitor.setpoint_us = now_us
            self._phases.follow(now_us)

    def pose(self, time_us: int, p: Sequence[float], q: Sequence[float], now_us: int) -> bool:
        """Queue a pose (NED; q_ned_frd, w first) measured at `time_us`; return False if it is rejected.

        A level descent rejects every pose: after a gap, a few of them would upset the dead reckoning.
        """
        if self.state is State.BOOT or self.action is Action.LEVEL_DESCENT:
            return False
        clash = self._estimate.clash
        known = clash.found
        accepted = self._estimate.offer(
            time_us, p, q, now_us, flying=self._flying, armed=self.state is not State.STANDBY
        )
        if clash.found and not known:
            self._report(_CRITICAL, "poses of two sources: none is used")
        return accepted

    def restart_estimate(self, now_us: int) -> None:
        """Forget all poses, in standby: the next pose sets the estimate."""
        self.poses.restart()
        self._stillness.reset(now_us)

    def host_heard(self, now_us: int) -> None:
        """Record that a message of a station that keeps the link alive has arrived."""
        self.monitor.host_us = now_us

    def configure(self) -> None:
        """Configure the law and the failsafes from the current parameters."""
        self._law_parameters[:] = memoryview(self.parameters.vector)
        self.monitor.configure(self.parameters)

    def swap(self, reference: Track, at_us: int) -> None:
        """Track `reference` from now on. Its time 0 is `at_us`, which is not in the future."""
        self.reference, self.tracking_us, self.changed = reference, at_us, True
        self._player.start(reference, at_us)
        self._report(_INFO, "reference swapped")

    # The tick.

    def tick(self, now_us: int, gyro: Sequence[float], force: Sequence[float]) -> None:
        """Run the engine once on these samples (FRD); its outputs hold the commands."""
        player, run_law = self._player, self._run_law
        if now_us >= player.switch_us and player.switch(now_us):
            self._track_ended(now_us)
        has_pose = False
        if self._poses_waiting:
            has_pose = self._take_pose(now_us)
        view = self._gyro
        view[0], view[1], view[2] = gyro
        view = self._force
        view[0], view[1], view[2] = force
        player.piece[0] = (now_us - player.piece_us) * 1e-6
        player.yaw[0] = (now_us - player.yaw_us) * 1e-6
        run_law()
        self._memory[:] = self._memory_out
        if has_pose:
            self.poses.hide()
        if self._flying:
            self.flight_ticks += 1
            if self._saturated[0]:
                self.saturated_ticks += 1

    def update(self, now_us: int, battery_v: float) -> None:
        """Check readiness, failsafes and touchdown; called every UPDATE_TICKS, after the tick."""
        state = self.state
        if self._flying and self.feedforward.update(battery_v / self.parameters["BAT_FULL_V"]):
            self._report(_WARNING, "feed-forward fades: beyond its region")
        if state is State.BOOT:
            if now_us >= BOOT_US:
                self.handle_event(Event.BOOTED, now_us)
            return
        self._observe(now_us, battery_v)
        if self.action is not Action.LEVEL_DESCENT:
            self._dead_reckoning.follow_bias(UPDATE_S)
        active = self.monitor.active_conditions()
        if self._flying and self._stops_outside(now_us):
            active.append(BY_EVENT[Event.FENCE_AHEAD])
        self.conditions = 0
        for condition in active:
            if condition.failsafe is not Failsafe.NONE:
                self.conditions |= 1 << condition.failsafe
        if state is State.STANDBY:
            R = quat_to_matrix(FLOAT, self._memory[law.EST_Q])
            self._stillness.update(now_us, math.hypot(*self._memory[law.EST_V]), mat_vec(R, self._force))
            if self._estimate.calibrate(now_us):
                self._report(_INFO, "gyro calibrated")
                self._dead_reckoning.calibrated()
            return
        for condition in active:
            self._trigger(condition, now_us)
        self._update_state(now_us)

    def _update_state(self, now_us: int) -> None:
        """Disarm if idle, detect touchdown; in the air update the thrust ratio and start the observer."""
        if self.state is State.ARMED and now_us - self.state_us > self.parameters.us("IDLE_S"):
            self._report(_INFO, "disarmed: nothing started")
            self.handle_event(Event.IDLED, now_us)
        elif self.state in (State.LANDING, State.FAILSAFE):
            if self._update_descent(now_us):
                self.handle_event(Event.TOUCHDOWN, now_us)
        elif self._flying and self.height_m > 2.0 * self.parameters["LAND_HEIGHT"]:
            level = self._cos_tilt[0] > LEVEL
            if level and now_us - self.monitor.pose_us <= POSES_US:
                self._dead_reckoning.learn(now_us)
            else:
                self._dead_reckoning.pause()
            if level:
                self.monitor.update_thrust_ratio(force=self._lift, thrust=self._phases.lagged_thrust)
            self._observing[0] = 1.0

    def _observe(self, now_us: int, battery_v: float) -> None:
        memory, measured_us = self._memory, self.poses.measured_us
        observation = Observation(
            cos_tilt=self._cos_tilt[0],
            age_us=None if measured_us is None else now_us - measured_us,
            p=(memory[0], memory[1], memory[2]),
            battery_v=battery_v,
            imu=(*self._gyro, *self._force),
            flight_ticks=self.flight_ticks,
            saturated_ticks=self.saturated_ticks,
        )
        self.monitor.observe(now_us, observation)

    def _stops_outside(self, now_us: int) -> bool:
        """Return whether nothing but a stop now keeps the vehicle inside the fence and off the floor.

        A vehicle that is near its reference is where the reference is, which does not leave the fence, unless
        it began in a motion that attitudes had caused. Such a motion is to stop inside the fence.
        """
        memory = self._memory
        if self._offboard.direct:
            self._direct_us = now_us
        direct = self.state is State.OFFBOARD and now_us - self._direct_us <= AFTER_DIRECT_US
        near = math.dist(self.outputs["reference"][:3], memory[:3]) < OFF_TRACK_M
        if near and not direct:
            return False
        a = mat_vec(quat_to_matrix(FLOAT, memory[law.EST_Q]), self._force)
        motion = Motion(
            p=memory[law.EST_P],
            v=memory[law.EST_V],
            a=(a[0], a[1], a[2] + GRAVITY),
            thrust=self._phases.thrust,
            cos_tilt=self._cos_tilt[0],
        )
        values, phases = self.parameters, self._phases
        margin = 0.0 if direct else values["FS_FENCE_M"]
        return stops_outside(phases.envelope, motion, fence(values), margin, phases.floor)

    @property
    def _lift(self) -> float:
        """Specific force along -z (m/s^2) without the accelerometer's bias, for a level vehicle."""
        return -(self._force[2] + self._dead_reckoning.correction[2])

    # Entry actions of the states.

    def _enter(
        self,
        state: State,
        event: Event,
        now_us: int,
        height_m: float | None = None,
        by: Station | None = None,
    ) -> None:
        self.course.enter(state, event, by)
        before, self.state, self.state_us, self.changed = self.state, state, now_us, True
        self._flying = state in FLYING
        if state not in OBSERVED:
            self._observing[0] = 0.0
        elif state is State.TRACKING:
            self._observing[0] = 1.0
        self.monitor.start(now_us)
        self.monitor.setpoint_us = self._offboard.setpoint_us if state is State.OFFBOARD else NEVER_US
        phases = self._phases
        reference_state = phases.reference_state(now_us)
        self._offboard.release()
        if state is State.STANDBY:
            self._stand_by(before, now_us)
        elif state is State.ARMED:
            self._arm()
        elif state is State.TAKEOFF:
            self._takeoff_end = Event.START_REACHED if event is Event.START else Event.HEIGHT_REACHED
            self._climb(before, reference_state, height_m, now_us)
        elif state is State.TRACKING and self.reference is not None:
            self.tracking_us = now_us
            self._player.start(self.reference, now_us)
        elif state is State.HOLD:
            self._hold(event, reference_state, now_us)
        elif state is State.OFFBOARD:
            if before is State.ARMED:
                phases.lift_off(now_us)
            else:
                phases.stop(reference_state, now_us)
            phases.follow(now_us)
        elif state is State.LANDING:
            phases.land(reference_state, now_us)

    def _stand_by(self, before: State, now_us: int) -> None:
        """Stop the rotors and restart the detection of stillness."""
        self.action = Action.NONE
        self._stillness.reset(now_us)
        self.feedforward.resume()
        self._phases.stop_rotors(now_us)
        if before is not State.BOOT:
            self._report(_INFO, "disarmed")

    def _arm(self) -> None:
        """Reset the results of the last flight and report a missing reference."""
        self._estimate.clash.reset()
        self.failsafe = Failsafe.NONE
        self.tracking_us = None
        self._report(_INFO, "armed")
        if self.reference is None:
            self._report(_WARNING, "no live reference: start will be refused")

    def _hold(self, event: Event, reference_state: ReferenceState, now_us: int) -> None:
        """Hold at the reference's end for HOLD_S; otherwise stop and hold here.

        The hold lasts FS_OFFB_HOLD_S if setpoints were lost, else until a command.
        """
        if event is Event.REFERENCE_ENDED and self.reference is not None:
            self._phases.hold_at_end(self.reference, now_us)
            return
        lost = event is Event.SETPOINTS_LOST
        self._phases.stop(reference_state, now_us, self.parameters["FS_OFFB_HOLD_S"] if lost else None)

    def _climb(self, before: State, start: ReferenceState, height_m: float | None, now_us: int) -> None:
        """Climb to a height or to the first node of the reference, from the floor or in the air."""
        phases, reference = self._phases, self.reference
        if self._takeoff_end is Event.HEIGHT_REACHED:
            phases.rise(height_m, now_us)
            return
        assert reference is not None, "a start without a reference is refused"
        if before is State.ARMED:
            phases.climb_to(reference, now_us)
        else:
            phases.go_to_start(reference, start, now_us)

    # Failsafes and touchdown.

    def _trigger(self, condition: Condition, now_us: int) -> None:
        """Send the event of a condition to the supervisor; take its action if it outranks the active one."""
        if self.state is State.FAILSAFE and condition.action <= self.action:
            return
        outcome = update(self.state, condition.event)
        if outcome.refusal is not None:
            return
        self._report(_WARNING if condition.failsafe is Failsafe.NONE else _CRITICAL, condition.text)
        if outcome.state is not State.FAILSAFE:
            self.failsafe = condition.failsafe
            self._enter(outcome.state, condition.event, now_us)
            return
        if self.failsafe is Failsafe.NONE:
            self.failsafe = condition.failsafe
        phases = self._phases
        reference_state = phases.reference_state(now_us)
        if self.state is not State.FAILSAFE:
            self._enter(State.FAILSAFE, condition.event, now_us)
        self.changed = True
        self.action = escalate(self.action, condition)
        if self.action is Action.LAND_IN_PLACE:
            phases.land(reference_state, now_us)
        elif self.action is Action.LEVEL_DESCENT:
            self._dead_reckoning.start(1e-6 * (now_us - self.monitor.pose_us), self.parameters)
            phases.descend_level(reference_state, self.monitor.thrust_ratio, now_us)
        elif self.action is Action.MOTORS_OFF:
            phases.fall(now_us)

    def _track_ended(self, now_us: int) -> None:
        event = self._takeoff_end if self.state is State.TAKEOFF else _END.get(self.state)
        if event is None:
            return
        if event in BY_EVENT:
            self._report(_INFO, BY_EVENT[event].text)
        elif event is Event.TOUCHDOWN and self.action is not Action.MOTORS_OFF:
            self._report(_WARNING, "no touchdown detected: motors off")
        self.handle_event(event, now_us)

    def _update_descent(self, now_us: int) -> bool:
        """Update the detection of touchdown and the feedback of a descent; return whether it has landed."""
        if self.action is Action.MOTORS_OFF:
            return False
        memory = self._memory
        if self.action is Action.LEVEL_DESCENT:
            phases, monitor = self._phases, self.monitor
            self._dead_reckoning.apply(UPDATE_S)
            phases.go_blind(monitor.thrust_ratio, now_us)
            return monitor.update_support(
                now_us,
                force=self._lift,
                thrust=phases.lagged_thrust,
                expected_excess=phases.floor_force,
                learn=not phases.blind,
                near=phases.blind or self.height_m < near_floor_m(now_us - monitor.pose_us),
                stopped=memory[5] < 0.5 * self.parameters["FS_SINK_SPEED"],
            )
        return self.monitor.update_touchdown(
            now_us,
            height=self.height_m,
            v=memory[law.EST_V],
            reference_below=self.outputs["reference"][2] > memory[2] + 0.05,
            carried=self.monitor.excess(self._lift, self._phases.lagged_thrust) > TOUCH_FORCE,
        )

    def _take_pose(self, now_us: int) -> bool:
        """Put a waiting pose into the engine's inputs; return False if it set the estimate instead.

        In standby a pose sets the estimate if it follows a gap of FS_MOCAP_S.
        """
        self.monitor.pose_us = now_us
        resting = self.state is State.STANDBY
        return self._estimate.take_pose(now_us, self.monitor.pose_lost_us if resting else None)

    def arming_reasons(self, now_us: int) -> list[str]:
        """Return every reason why arming would be refused in standby."""
        return self._gate.arming_reasons(now_us, self.reference)

    def _report(self, severity: int, text: str) -> None:
        self.texts.append((severity, text))
