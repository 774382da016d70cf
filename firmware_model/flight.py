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
from firmware_model.parameters import ParameterValues
from firmware_model.player import Player
from firmware_model.poses import PoseInput
from firmware_model.readiness import GyroCalibration, refusal
from firmware_model.supervisor import FLYING, Event, State, update
from firmware_model.uart import NEVER_US
from firmware_model.watch import TOUCH_HEIGHT, Watch
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

OBSERVED = (State.TRACKING, State.HOLD)
"""States in which the disturbance observer runs, as it does in a take-off well above the floor. In a landing
what it found stays: the floor would be taken for a disturbance.
"""
_END = {
    State.TAKEOFF: Event.CLIMBED,
    State.TRACKING: Event.REFERENCE_ENDED,
    State.HOLD: Event.HELD,
    State.LANDING: Event.TOUCHDOWN,
    State.FAILSAFE: Event.TOUCHDOWN,
}
"""What the end of a state's track means; for descents it is the timeout of touchdown."""


class Flight:
    """One power-up of the flight processor.

    Args:
        engine: `law.step` as an engine. parameters: values on board.

    `reference` is the track to fly, None for none; `feedforward` the law's feed-forward. Both may be replaced
    in standby. `changed` is set whenever state or failsafe change, for whoever reports them.
    """

    def __init__(self, *, engine: Engine, parameters: ParameterValues) -> None:
        self.parameters = parameters
        self.state = State.BOOT
        self.state_us = 0
        self.failsafe = Failsafe.NONE
        self.action = Action.NONE
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
        self.feedforward = FeedForwardInput(inputs["feedforward"], inputs["ff_accel_ned"])

        self.poses = PoseInput(inputs)
        self._poses_waiting = self.poses.waiting
        self._floor = 0.0
        self._blind_until_us = NEVER_US
        self._flying = False
        for view in (*inputs.values(), *self.outputs.values()):
            view[:] = memoryview(bytes(8 * len(view))).cast("d")
        memory = law.initial_memory()
        for k, value in enumerate(memory):
            self._memory[k] = value
        self.feedforward.clear()
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

    # Commands and measurements.

    def command(self, event: Event, now_us: int) -> str | None:
        """Why `event` was refused, None where it took effect."""
        if event is Event.ARM and self.state is State.STANDBY:
            reason = self._arm_refusal(now_us)
            if reason is not None:
                return reason
        outcome = update(self.state, event)
        if outcome.refusal is None and outcome.state is not self.state:
            self._enter(outcome.state, now_us)
        return outcome.refusal

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

    def look(self, now_us: int) -> None:
        """Nothing comes back; once every LOOK_TICKS, after the tick: readiness, failsafes, touchdown."""
        state = self.state
        if self._flying:
            self.feedforward.update(self.outputs["reference"])
        if state is State.BOOT:
            if now_us >= BOOT_US:
                self.command(Event.BOOTED, now_us)
            return
        if state is State.STANDBY:
            self._calibrate(now_us)
            return
        for condition in self.watch.struck(now_us, self._cos_tilt[0]):
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

    # What the states do when they are entered.

    def _enter(self, state: State, now_us: int) -> None:
        before, self.state, self.state_us, self.changed = self.state, state, now_us, True
        self._flying = state in FLYING
        self._observing[0] = 1.0 if state in OBSERVED else 0.0
        self.watch.start(now_us)
        reference = tuple(self.outputs["reference"])
        yaw = reference[12]
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
        elif state is State.TAKEOFF:
            self._take_off(now_us)
        elif state is State.TRACKING and self.reference is not None:
            self.tracking_us = now_us
            self._player.start(self.reference, now_us)
        elif state is State.HOLD:
            end = (reference[0], reference[1], reference[2])
            if self.reference is not None:
                end, yaw = self.reference.end_ned, self.reference.end_yaw
            duration_us = max(TICK_US, track.seconds_us(values["HOLD_S"]))
            self._player.start(track.hold(end, yaw, duration_us), now_us)
        elif state is State.LANDING:
            self._land(now_us)

    def _take_off(self, now_us: int) -> None:
        assert self.reference is not None, "arming without a reference is refused"
        values, memory = self.parameters, self._memory
        w, x, y, z = memory[law.EST_Q]
        p = (memory[0], memory[1], memory[2])
        self._floor = p[2]
        climb = track.climb(
            p,
            math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
            self.reference.start_ned,
            self.reference.start_yaw,
            speed=values["TAKEOFF_SPEED"],
            clear=values["TAKEOFF_CLEAR"],
            hover_us=max(TICK_US, track.seconds_us(values["HOVER_S"])),
        )
        self._weights[0] = self._weights[1] = 1.0
        self._armed[0] = 1.0
        self._player.start(climb, now_us)

    def _land(self, now_us: int) -> None:
        reference = tuple(self.outputs["reference"])
        descent = track.land(
            reference[:12],
            reference[12],
            floor=self._floor,
            speed=self.parameters["LAND_SPEED"],
            deceleration=self.parameters["LAND_DECEL"],
        )
        self._player.start(descent, now_us)

    def _descend_level(self, now_us: int) -> None:
        memory = self._memory
        descent = track.level_descent(
            (memory[0], memory[1], memory[2]),
            (memory[3], memory[4], memory[5]),
            self.outputs["reference"][12],
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
        self._tell(_CRITICAL, condition.text)
        if outcome.state is not State.FAILSAFE:
            self.failsafe = condition.failsafe
            self._enter(outcome.state, now_us)
            return
        if self.failsafe is Failsafe.NONE:
            self.failsafe = condition.failsafe
        if self.state is not State.FAILSAFE:
            self._enter(State.FAILSAFE, now_us)
        self.changed = True
        self.action = escalate(self.action, condition)
        if self.action is Action.LAND_IN_PLACE:
            self._land(now_us)
        elif self.action is Action.LEVEL_DESCENT:
            self._descend_level(now_us)
        elif self.action is Action.MOTORS_OFF:
            self._armed[0] = 0.0
            self._player.start(track.hold((0.0, 0.0, 0.0), 0.0, FALL_US), now_us)

    def _track_ended(self, now_us: int) -> None:
        event = _END.get(self.state)
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

    def _arm_refusal(self, now_us: int) -> str | None:
        return refusal(
            has_reference=self.reference is not None,
            rests=self.reference is not None and self.reference.rests,
            calibrated=self.calibration.bias is not None,
            has_pose=self.poses.used > 0 and now_us - self.watch.pose_us <= self.watch.pose_lost_us,
            cos_tilt=self._cos_tilt[0],
        )

    def _thrust(self) -> float:
        return self.outputs["collective_n"][0] / self.parameters["MASS"]

    def _tell(self, severity: int, text: str) -> None:
        self.texts.append((severity, text))
