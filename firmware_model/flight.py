"""The flight itself: law, track, state and failsafes, tick by tick. Knows no bytes and no messages.

Commands come in as events, poses as numbers; what people should read goes out as `texts`.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from firmware_model import track
from firmware_model.engine import Engine, doubles
from firmware_model.failsafe import BY_EVENT, Action, Condition, Failsafe, escalate
from firmware_model.feedforward import FeedForwardInput
from firmware_model.law import step as law
from firmware_model.law.constants import GRAVITY
from firmware_model.law.ops import FLOAT
from firmware_model.law.rotations import quat_to_matrix
from firmware_model.offboard import Offboard
from firmware_model.parameters import ParameterValues
from firmware_model.player import Player
from firmware_model.poses import PoseInput
from firmware_model.readiness import Facts, GyroCalibration, contradiction, reasons
from firmware_model.setpoints import PositionTarget, Target, towards, turned
from firmware_model.supervisor import FLYING, Event, State, update
from firmware_model.uart import NEVER_US
from firmware_model.watch import TOUCH_HEIGHT, Seen, Watch, fence
from protocol.telemetry import TICK_US

BOOT_US = 200_000
"""Time from power to standby."""
LOOK_TICKS = 10
"""Conditions, readiness and touchdown are looked at every so many ticks."""
BLIND_US = 5_000_000
"""How long dead-reckoned velocity is worth following."""
BLIND_END_US = 8_000_000
"""When a level descent is over at the latest."""
FALL_US = 2_000_000
"""Time that rotors rest before a failsafe that stopped them ends."""
_CRITICAL, _WARNING, _INFO = 2, 4, 6  # MAV_SEVERITY

OBSERVED = (State.TRACKING, State.HOLD, State.OFFBOARD)
"""States in which the disturbance observer runs, as it does in a take-off well above the floor. In a landing
what it found stays: the floor would be taken for a disturbance.
"""
_END = {
    State.TRACKING: Event.REFERENCE_ENDED,
    State.HOLD: Event.HELD,
    State.LANDING: Event.TOUCHDOWN,
    State.FAILSAFE: Event.TOUCHDOWN,
}
"""What the end of a state's track means; for descents it is the timeout of touchdown. A takeoff knows itself
what it is for.
"""
HARDEST = 8.0
"""m/s^2 that a reference begins with at most where it takes over from commanded attitude."""


class Flight:
    """One power-up of the flight processor.

    Args:
        engine: `law.step` as an engine. parameters: values on board.

    `reference` is the track to fly, None for none; `feedforward` the law's feed-forward. Both may be replaced
    in standby, the reference also by `swap` while it is tracked. `changed` is set whenever state or failsafe
    change, for whoever reports them. `conditions`: rows of the failsafe table that held at the last look, bit
    k for Failsafe k.
    """

    def __init__(self, *, engine: Engine, parameters: ParameterValues) -> None:
        self.parameters = parameters
        self.state = State.BOOT
        self.state_us = 0
        self.failsafe = Failsafe.NONE
        self.action = Action.NONE
        self.conditions = 0
        self.reference: track.Track | None = None
        self.tracking_us: int | None = None
        self.texts: deque[tuple[int, str]] = deque()
        self.changed = True
        self.saturated_ticks = 0
        self.flight_ticks = 0
        self.watch = Watch(parameters)
        self.calibration = GyroCalibration()

        self._engine = engine
        inputs, self.outputs = doubles(engine.inputs), doubles(engine.outputs)
        self._memory = inputs["memory"]
        self._memory_out = self.outputs["memory"]
        self._gyro, self._force = inputs["gyro"], inputs["specific_force"]
        self._armed, self._weights = inputs["armed"], inputs["feedback_weights"]
        self._observing = inputs["observing"]
        self._law_parameters = inputs["parameters"]
        self._saturated, self._cos_tilt = self.outputs["saturated"], self.outputs["cos_tilt"]
        self._player = Player(inputs["piece"], inputs["yaw_piece"])
        self._offboard = Offboard(inputs["offboard"], parameters)
        self._climb_end = Event.CLIMBED
        self._bounded = False  # by the newest setpoint
        self.feedforward = FeedForwardInput(inputs["feedforward"], inputs["ff_accel_ned"])

        self.poses = PoseInput(inputs)
        self._poses_waiting = self.poses.waiting
        self._floor = 0.0
        self._home: tuple[float, float, float] | None = None
        self._blind_until_us = NEVER_US
        self._flying = False
        for view in (*inputs.values(), *self.outputs.values()):
            view[:] = memoryview(bytes(8 * len(view))).cast("d")
        memory = law.initial_memory()
        for k, value in enumerate(memory):
            self._memory[k] = value
        self.feedforward.clear()
        self._offboard.release()
        self.configure()
        self._rest(0)

    @property
    def rotors_on(self) -> bool:
        """Whether the law drives the rotors."""
        return self._armed[0] > 0.5

    @property
    def gyro(self) -> tuple[float, float, float]:
        """The gyro's sample of the last tick (rad/s, FRD)."""
        return (self._gyro[0], self._gyro[1], self._gyro[2])

    @property
    def home_ned(self) -> tuple[float, float, float] | None:
        """Where the last take-off began, None before the first."""
        return self._home

    def has_pose(self, now_us: int) -> bool:
        """Whether poses come."""
        return self.poses.used > 0 and now_us - self.watch.pose_us <= self.watch.pose_lost_us

    # Commands and measurements.

    def command(self, event: Event, now_us: int, height_m: float | None = None) -> str | None:
        """Why `event` was refused, None where it took effect. height_m: of a takeoff, else TAKEOFF_HEIGHT."""
        outcome = update(self.state, event)
        refusal = outcome.refusal or self._refusal(event, now_us)
        if refusal is None and (outcome.state is not self.state or event is Event.HOLD):
            self._enter(outcome.state, event, now_us, height_m)
        return refusal

    def setpoint(self, target: Target, now_us: int) -> None:
        """Nothing comes back; the target is followed at once, or when setpoints are asked to be followed."""
        self._offboard.offer(target, now_us)
        if self.state is State.OFFBOARD:
            self.watch.setpoint_us = now_us
            self._follow(now_us)

    def pose(self, time_us: int, p: Sequence[float], q: Sequence[float], now_us: int) -> bool:
        """Whether the pose (NED; q_ned_frd, w first) measured at `time_us` will be used at the next tick."""
        return self.state is not State.BOOT and self.poses.offer(time_us, p, q, now_us)

    def host_heard(self, now_us: int) -> None:
        """Nothing comes back; the host has said something."""
        self.watch.host_us = now_us

    def configure(self) -> None:
        """Nothing comes back; the law and the failsafes take over the parameters as they are now."""
        self._law_parameters[:] = memoryview(self.parameters.vector)
        self.watch.configure(self.parameters)

    def swap(self, reference: track.Track, at_us: int) -> None:
        """Nothing comes back; `reference` is tracked from here on, its time 0 is `at_us`, which has come."""
        self.reference, self.tracking_us, self.changed = reference, at_us, True
        self._player.start(reference, at_us)
        self._tell(_INFO, "reference swapped")

    # The tick.

    def tick(self, now_us: int, gyro: Sequence[float], force: Sequence[float]) -> None:
        """Nothing comes back; the engine has run once on these samples (FRD), outputs hold the commands."""
        player = self._player
        if now_us >= player.switch_us and player.switch(now_us):
            self._track_ended(now_us)
        fresh = False
        if self._poses_waiting:
            fresh = self._take_pose(now_us)
        view = self._gyro
        view[0], view[1], view[2] = gyro
        view = self._force
        view[0], view[1], view[2] = force
        player.piece[0] = (now_us - player.piece_us) * 1e-6
        player.yaw[0] = (now_us - player.yaw_us) * 1e-6
        self._engine()
        self._memory[:] = self._memory_out
        if fresh:
            self.poses.hide()
        if self._flying:
            self.flight_ticks += 1
            if self._saturated[0]:
                self.saturated_ticks += 1

    def look(self, now_us: int, battery_v: float) -> None:
        """Nothing comes back; once every LOOK_TICKS, after the tick: readiness, failsafes, touchdown."""
        state = self.state
        if self._flying:
            self.feedforward.update(self.outputs["reference"])
        if state is State.BOOT:
            if now_us >= BOOT_US:
                self.command(Event.BOOTED, now_us)
            return
        self._see(now_us, battery_v)
        holding = self.watch.holding()
        self.conditions = 0
        for condition in holding:
            if condition.failsafe is not Failsafe.NONE:
                self.conditions |= 1 << condition.failsafe
        if state is State.STANDBY:
            self._calibrate(now_us)
            return
        for condition in holding:
            self._strike(condition, now_us)
        if self.state is State.ARMED and now_us - self.state_us > self.parameters.us("IDLE_S"):
            self._tell(_INFO, "disarmed: nothing started")
            self.command(Event.IDLED, now_us)
        elif self.state in (State.LANDING, State.FAILSAFE):
            if self._touched(now_us):
                self.command(Event.TOUCHDOWN, now_us)
        elif self._floor - self._memory[2] > 2.0 * TOUCH_HEIGHT:
            self.watch.aloft(force=-self._force[2], thrust=self._thrust())
            self._observing[0] = 1.0

    def _see(self, now_us: int, battery_v: float) -> None:
        memory, measured_us = self._memory, self.poses.measured_us
        seen = Seen(
            cos_tilt=self._cos_tilt[0],
            age_us=None if measured_us is None else now_us - measured_us,
            p=(memory[0], memory[1], memory[2]),
            battery_v=battery_v,
            imu=(*self._gyro, *self._force),
            flight_ticks=self.flight_ticks,
            saturated_ticks=self.saturated_ticks,
        )
        self.watch.see(now_us, seen)

    # What the states do when they are entered.

    def _enter(self, state: State, event: Event, now_us: int, height_m: float | None = None) -> None:
        before, self.state, self.state_us, self.changed = self.state, state, now_us, True
        self._flying = state in FLYING
        self._observing[0] = 1.0 if state in OBSERVED else 0.0
        self.watch.start(now_us)
        self.watch.setpoint_us = self._offboard.heard_us if state is State.OFFBOARD else NEVER_US
        node, yaw = self._present(now_us)
        self._offboard.release()
        values = self.parameters
        if state is State.STANDBY:
            self.action = Action.NONE
            self.feedforward.resume()
            self._rest(now_us)
            if before is not State.BOOT:
                self._tell(_INFO, "disarmed")
        elif state is State.ARMED:
            self.failsafe = Failsafe.NONE
            self.tracking_us = None
            self._tell(_INFO, "armed")
            if self.reference is None:
                self._tell(_WARNING, "no live reference: start will be refused")
        elif state is State.TAKEOFF:
            self._climb_end = Event.CLIMBED if event is Event.START else Event.RISEN
            if before is State.ARMED:
                self._take_off(now_us, height_m)
            else:
                self._go_to_start(node, yaw, now_us)
        elif state is State.TRACKING and self.reference is not None:
            self.tracking_us = now_us
            self._player.start(self.reference, now_us)
        elif state is State.HOLD:
            self._hold(event, node, yaw, now_us)
        elif state is State.OFFBOARD:
            self._player.start(track.stop(node, yaw, deceleration=values["LAND_DECEL"]), now_us)
            self._follow(now_us)
        elif state is State.LANDING:
            self._land(node, yaw, now_us)

    def _take_off(self, now_us: int, height_m: float | None) -> None:
        values, memory = self.parameters, self._memory
        p = (memory[0], memory[1], memory[2])
        yaw = self._yaw()
        self._floor, self._home = p[2], p
        target, yaw_end = p, yaw
        if self._climb_end is Event.RISEN:
            height = values["TAKEOFF_HEIGHT"] if height_m is None else height_m
            most = p[2] - values["FENCE_D_MIN"]
            if height > most:
                self._tell(_WARNING, f"takeoff bounded by the fence: {most:.2f} m")
            target = (p[0], p[1], p[2] - min(height, most))
        elif self.reference is not None:
            target, yaw_end = self.reference.start_ned, self.reference.start_yaw
        climb = track.climb(
            p,
            yaw,
            target,
            yaw_end,
            speed=values["TAKEOFF_SPEED"],
            clear=values["TAKEOFF_CLEAR"],
            hover_us=max(TICK_US, track.seconds_us(values["HOVER_S"])),
        )
        self._weights[0] = self._weights[1] = 1.0
        self._armed[0] = 1.0
        self._player.start(climb, now_us)

    def _go_to_start(self, node: track.Node, yaw: track.YawState, now_us: int) -> None:
        assert self.reference is not None, "a start without a reference is refused"
        values = self.parameters
        way = track.transit(
            node,
            yaw,
            self.reference.start_ned,
            self.reference.start_yaw,
            speed=values["TAKEOFF_SPEED"],
            deceleration=values["LAND_DECEL"],
            hover_us=max(TICK_US, track.seconds_us(values["HOVER_S"])),
        )
        self._player.start(way, now_us)

    def _hold(self, event: Event, node: track.Node, yaw: track.YawState, now_us: int) -> None:
        """At the end of a reference and where setpoints are lost for a time, else until told otherwise."""
        values = self.parameters
        hold_us = track.ENDLESS_US
        if event is Event.REFERENCE_ENDED and self.reference is not None:
            hold_us = max(TICK_US, track.seconds_us(values["HOLD_S"]))
            end = track.hold(self.reference.end_ned, self.reference.end_yaw, hold_us)
            self._player.start(end, now_us)
            return
        if event is Event.SETPOINTS_LOST:
            hold_us = max(TICK_US, track.seconds_us(values["FS_OFFB_HOLD_S"]))
        way = track.stop(node, yaw, deceleration=values["LAND_DECEL"], hold_us=hold_us)
        self._player.start(way, now_us)

    def _follow(self, now_us: int) -> None:
        """The newest setpoint is what is flown from now on."""
        offboard = self._offboard
        target = offboard.target
        if not isinstance(target, PositionTarget):
            if target is not None:
                offboard.drive(target)
            return
        if target == offboard.followed and target.rests:
            return
        node, yaw = self._present(now_us)
        offboard.release()
        offboard.followed = target
        way, bounded = towards(turned(target, self._yaw()), node, yaw, offboard.bounds(self._floor))
        if bounded and not self._bounded:
            self._tell(_WARNING, "setpoint bounded by fence, floor or speed")
        self._bounded = bounded
        self._player.start(way, now_us)

    def _present(self, now_us: int) -> tuple[track.Node, track.YawState]:
        """The reference state (p, v, a, j) and yaw now; the vehicle's own where attitude is commanded."""
        if not self._offboard.direct:
            reference = self._player.reference(now_us)
            return reference[:12], (reference[12], reference[13])
        memory = self._memory
        R = quat_to_matrix(FLOAT, memory[law.EST_Q])
        thrust = self._thrust()
        a = (-R[2] * thrust, -R[5] * thrust, GRAVITY - R[8] * thrust)
        share = min(1.0, HARDEST / max(math.hypot(*a), 1e-9))
        state = (*memory[law.EST_P], *memory[law.EST_V], *(share * x for x in a), 0.0, 0.0, 0.0)
        return state, (self._yaw(), 0.0)

    def _yaw(self) -> float:
        w, x, y, z = self._memory[law.EST_Q]
        return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))

    def _land(self, node: track.Node, yaw: track.YawState, now_us: int) -> None:
        descent = track.land(
            node,
            yaw,
            floor=self._floor,
            speed=self.parameters["LAND_SPEED"],
            deceleration=self.parameters["LAND_DECEL"],
        )
        self._player.start(descent, now_us)

    def _descend_level(self, yaw: float, now_us: int) -> None:
        memory = self._memory
        descent = track.level_descent(
            (memory[0], memory[1], memory[2]),
            (memory[3], memory[4], memory[5]),
            yaw,
            speed=self.parameters["FS_SINK_SPEED"],
            damped_us=BLIND_US,
            end_us=BLIND_END_US,
        )
        self._weights[0] = 0.0
        self._blind_until_us = now_us + BLIND_US
        # What was observed rests on a velocity that is no longer measured.
        for k in range(law.OBSERVER.start, law.OBSERVER.stop):
            memory[k] = 0.0
        # What thrust has been worth so far replaces the position feedback that made up for it.
        self.feedforward.hold((0.0, 0.0, GRAVITY / self.watch.thrust_ratio - GRAVITY))
        self._player.start(descent, now_us)

    def _rest(self, now_us: int) -> None:
        """Rotors off, nothing to follow."""
        self._armed[0] = 0.0
        self._weights[0] = self._weights[1] = 1.0
        self._blind_until_us = NEVER_US
        p = (self._memory[0], self._memory[1], self._memory[2])
        self._player.rest(track.hold(p, 0.0, 1_000_000), now_us)

    # Trouble, touchdown, readiness.

    def _strike(self, condition: Condition, now_us: int) -> None:
        """The condition's event goes to the supervisor; its action is taken if it outranks what is done."""
        if self.state is State.FAILSAFE and condition.action <= self.action:
            return
        outcome = update(self.state, condition.event)
        if outcome.refusal is not None:
            return
        self._tell(_WARNING if condition.failsafe is Failsafe.NONE else _CRITICAL, condition.text)
        if outcome.state is not State.FAILSAFE:
            self.failsafe = condition.failsafe
            self._enter(outcome.state, condition.event, now_us)
            return
        if self.failsafe is Failsafe.NONE:
            self.failsafe = condition.failsafe
        node, yaw = self._present(now_us)
        if self.state is not State.FAILSAFE:
            self._enter(State.FAILSAFE, condition.event, now_us)
        self.changed = True
        self.action = escalate(self.action, condition)
        if self.action is Action.LAND_IN_PLACE:
            self._land(node, yaw, now_us)
        elif self.action is Action.LEVEL_DESCENT:
            self._descend_level(yaw[0], now_us)
        elif self.action is Action.MOTORS_OFF:
            self._armed[0] = 0.0
            self._player.start(track.hold((0.0, 0.0, 0.0), 0.0, FALL_US), now_us)

    def _track_ended(self, now_us: int) -> None:
        event = self._climb_end if self.state is State.TAKEOFF else _END.get(self.state)
        if event is None:
            return
        if event in BY_EVENT:
            self._tell(_INFO, BY_EVENT[event].text)
        elif event is Event.TOUCHDOWN and self.action is not Action.MOTORS_OFF:
            self._tell(_WARNING, "no touchdown noticed: motors off")
        self.command(event, now_us)

    def _touched(self, now_us: int) -> bool:
        if self.action is Action.MOTORS_OFF:
            return False
        memory = self._memory
        if self.action is Action.LEVEL_DESCENT:
            if now_us >= self._blind_until_us:
                self._weights[1] = 0.0
            return self.watch.carried(now_us, force=-self._force[2], thrust=self._thrust())
        return self.watch.landed(
            now_us,
            height=self._floor - memory[2],
            speed=math.hypot(memory[3], memory[4], memory[5]),
            descending=self.outputs["reference"][2] > memory[2] + 0.05,
        )

    def _take_pose(self, now_us: int) -> bool:
        """Whether the oldest waiting pose is in the engine's inputs; in standby it may set the estimate."""
        pose, before_us = self.poses.take()
        self.watch.pose_us = now_us
        resting = self.state is State.STANDBY
        if before_us is None or (resting and pose[0] - before_us > self.watch.pose_lost_us):
            self._initialise(pose[1], pose[2])
            return False
        self.poses.show(pose, before_us, now_us)
        return True

    def _initialise(self, p: Sequence[float], q: Sequence[float]) -> None:
        """The estimate is this pose, at rest; the gyro bias stays."""
        values = (*p, 0.0, 0.0, 0.0, *q)
        for k, value in enumerate(values):
            self._memory[k] = value

    def _calibrate(self, now_us: int) -> None:
        memory = self._memory
        most = self.parameters["EST_BIAS_MAX"]
        if self.calibration.bias is None and self.calibration.look(
            now_us, self._gyro, self._force, memory[law.GYRO_SUM], most
        ):
            assert self.calibration.bias is not None
            for k, value in enumerate(self.calibration.bias):
                memory[law.EST_BIAS.start + k] = value
            self._tell(_INFO, "gyro calibrated")

    def _refusal(self, event: Event, now_us: int) -> str | None:
        """Why a command that the table allows is refused all the same."""
        state = self.state
        if event is Event.ARM and state is State.STANDBY:
            return next(iter(self.arming_reasons(now_us)), None)
        if event is Event.START and state is State.TAKEOFF and self._climb_end is Event.RISEN:
            return "still taking off"
        if event is Event.START and state in (State.ARMED, State.HOLD):
            if self.tracking_us is not None:
                return "the reference has been flown: land, then arm again"
            if self.reference is None:
                return "no live reference: upload one"
            if not self.reference.rests:
                return "reference not at rest at its ends"
        if event is Event.OFFBOARD and not self._offboard.arriving(now_us):
            return "no setpoints: stream them first"
        return None

    def arming_reasons(self, now_us: int) -> list[str]:
        """Every reason why arming would be refused in standby; none where it would not."""
        memory, values = self._memory, self.parameters
        facts = Facts(
            calibrated=self.calibration.bias is not None,
            posed=self.has_pose(now_us),
            cos_tilt=self._cos_tilt[0],
            p=(memory[0], memory[1], memory[2]),
            fence=fence(values),
            holding=frozenset(row.event for row in self.watch.holding()),
            contradiction=contradiction(values),
        )
        return reasons(facts)

    def _thrust(self) -> float:
        return self.outputs["collective_n"][0] / self.parameters["MASS"]

    def _tell(self, severity: int, text: str) -> None:
        self.texts.append((severity, text))
