"""Phases of a flight: tracks and engine settings of take-off, hold, setpoints, landings and rest.

Stops, landings, transits and setpoints start at the present reference, so it does not jump. Take-off and
level descent start at the estimate. `Flight` decides on the state of the vehicle.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from trimtab.firmware_model.clock import NEVER_US
from trimtab.firmware_model.flight import braking, track
from trimtab.firmware_model.flight.condition_monitor import CLEAR_HEIGHT, FLOOR_HEIGHT
from trimtab.firmware_model.flight.envelope import Envelope, envelope
from trimtab.firmware_model.flight.feedforward import FeedForwardInput
from trimtab.firmware_model.flight.offboard import Offboard
from trimtab.firmware_model.flight.parameters import ParameterValues
from trimtab.firmware_model.flight.player import Player
from trimtab.firmware_model.flight.setpoints import PositionTarget, climb_only, levelled, to_ned, towards
from trimtab.firmware_model.law import step as law
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.firmware_model.law.rotations import quat_to_matrix
from trimtab.protocol.parameters import BY_NAME
from trimtab.protocol.telemetry import TICK_US

FALL_US = 2_000_000
"""Time from a stop of the rotors in the air to the end of the failsafe."""
START_ACCEL_MAX = 8.0
"""Greatest initial horizontal acceleration (m/s^2) of a reference that takes over after a directly commanded
attitude."""

TAKEOFF_HEIGHT_MIN = BY_NAME["TAKEOFF_HEIGHT"].min
"""Least height (m) of a take-off."""

ReferenceState = tuple[braking.Node, track.YawState]
"""State (p, v, a, j) of the reference, and its yaw and yaw rate."""


_REST = (0.0,) * 9


class Phases:
    """Writes the engine's blocks for the reference and for the rotors (`armed`: 1 while the rotors are on).

    Parameters
    ----------
    inputs, outputs
        Blocks of the engine.
    parameters
        Values on board.
    feedforward
        Feed-forward of the law.
    thrust_ratio
        Returns actual over nominal thrust.
    report
        Receives texts for people about bounded setpoints and take-offs.

    Attributes
    ----------
    player
        Playback of the present track.
    offboard
        Newest setpoint.
    floor
        Floor of the last take-off (m, down).
    home_ned
        Position of the last take-off; None before the first.
    """

    def __init__(
        self,
        inputs: Mapping[str, memoryview[float]],
        outputs: Mapping[str, memoryview[float]],
        *,
        parameters: ParameterValues,
        feedforward: FeedForwardInput,
        thrust_ratio: Callable[[], float],
        report: Callable[[str], None],
    ) -> None:
        self.player = Player(inputs["piece"], inputs["yaw_piece"])
        self.offboard = Offboard(inputs["offboard"], parameters)
        self.floor = 0.0
        self.home_ned: tuple[float, float, float] | None = None
        self._parameters = parameters
        self._feedforward = feedforward
        self._thrust_ratio = thrust_ratio
        self._report = report
        self._memory = inputs["memory"]
        self._armed, self._weights = inputs["armed"], inputs["feedback_weights"]
        self._collective = outputs["collective_n"]
        self._bounded = False  # whether the newest setpoint was bounded
        self._blind_until_us = NEVER_US

    @property
    def rotors_on(self) -> bool:
        """Whether the law drives the rotors (block `armed`)."""
        return self._armed[0] > 0.5

    @property
    def thrust(self) -> float:
        """Commanded thrust over mass (m/s^2)."""
        return self._collective[0] / self._parameters["MASS"]

    @property
    def ceiling_distance(self) -> float:
        """Distance (m) from the vehicle up to the ceiling of the flight volume."""
        return self._memory[2] - self._parameters["FENCE_D_MIN"]

    @property
    def envelope(self) -> Envelope:
        """Envelope of the parameters on board. Stops with room brake by LAND_DECEL."""
        return envelope(self._parameters, self._thrust_ratio(), self._parameters["LAND_DECEL"])

    @property
    def lagged_thrust(self) -> float:
        """Commanded thrust over mass (m/s^2) after the nominal rotor lag."""
        return self._memory[law.OBSERVER_THRUST.start] / self._parameters["MASS"]

    @property
    def blind(self) -> bool:
        """Whether velocity feedback is off.

        Thrust over mass then decreases within a second to `track.SINK` (m/s^2) below hover, even on the
        floor.
        """
        return self._weights[1] == 0.0

    @property
    def floor_force(self) -> float:
        """Force over mass (m/s^2) that the floor takes over from the rotors once a level descent has touched
        it.
        """
        values = self._parameters
        return track.SINK if self.blind else values["VEL_D_D"] * values["FS_SINK_SPEED"]

    def reference_state(self, now_us: int) -> ReferenceState:
        """Return the present reference, or the state of the vehicle while attitude is commanded.

        In height that state has no acceleration, since thrust changes at once, unless the vehicle brakes
        already.
        """
        if not self.offboard.direct:
            reference = self.player.reference(now_us)
            return reference[:12], (reference[12], reference[13])
        memory = self._memory
        if self.floor - memory[2] < FLOOR_HEIGHT:  # the floor supports the vehicle
            return (*self._position(), *_REST), (self._yaw(), 0.0)
        R = quat_to_matrix(FLOAT, memory[law.EST_Q])
        thrust = self.thrust
        north, east = -R[2] * thrust, -R[5] * thrust
        share = min(1.0, START_ACCEL_MAX / max(math.hypot(north, east), 1e-9))
        down = GRAVITY - R[8] * self.lagged_thrust * self._thrust_ratio()
        if down * (memory[law.EST_V][2] + down * self._parameters["MOTOR_LAG"]) > 0.0:
            down = 0.0
        state = (*memory[law.EST_P], *memory[law.EST_V], share * north, share * east, down, *braking.ZERO)
        return state, (self._yaw(), 0.0)

    # Floor and take-off.

    def stop_rotors(self, now_us: int) -> None:
        """Stop the rotors in standby, also after a kill in the air."""
        self._armed[0] = 0.0
        self._weights[0] = self._weights[1] = 1.0
        self._blind_until_us = NEVER_US
        self._bounded = False
        self.player.hold_first_piece(track.hold(self._position(), 0.0, 1_000_000), now_us)

    def climb_to(self, reference: track.Track, now_us: int) -> None:
        """Take off to the reference's first node and hover there."""
        self._climb(reference.start_ned, reference.start_yaw, now_us)

    def rise(self, height_m: float | None, now_us: int) -> None:
        """Take off to this height above the floor, by default TAKEOFF_HEIGHT."""
        p, height_max = self._position(), self.ceiling_distance
        height = self._parameters["TAKEOFF_HEIGHT"] if height_m is None else height_m
        if height > height_max:
            self._report(f"takeoff bounded by the fence: {height_max:.2f} m")
        self._climb((p[0], p[1], p[2] - min(height, height_max)), self._yaw(), now_us)

    def _climb(self, target: braking.Vector, yaw_end: float, now_us: int) -> None:
        values, p = self._parameters, self._position()
        climb = track.climb(
            p,
            self._yaw(),
            target,
            yaw_end,
            speed=values["TAKEOFF_SPEED"],
            clear=values["TAKEOFF_CLEAR"],
            hover_us=max(TICK_US, braking.seconds_us(values["HOVER_S"])),
        )
        self._leave_floor(p)
        self.player.start(climb, now_us)

    def lift_off(self, now_us: int) -> None:
        """Start the rotors with a reference at rest at the present position."""
        p = self._position()
        self._leave_floor(p)
        self.player.start(track.hold(p, self._yaw(), track.ENDLESS_US), now_us)

    def _leave_floor(self, p: braking.Vector) -> None:
        """Start the rotors and set floor and home to this position."""
        self.floor, self.home_ned = p[2], p
        self._weights[0] = self._weights[1] = 1.0
        self._armed[0] = 1.0

    # In the air.

    def go_to_start(self, reference: track.Track, reference_state: ReferenceState, now_us: int) -> None:
        """Go to the reference's first node and hover; below CLEAR_HEIGHT, climb vertically first."""
        values = self._parameters
        state, yaw = reference_state
        path = track.transit(
            braking.braked(state, self.envelope.brakes, self._room()),
            yaw,
            reference.start_ned,
            reference.start_yaw,
            speed=values["TAKEOFF_SPEED"],
            hover_us=max(TICK_US, braking.seconds_us(values["HOVER_S"])),
            climb_first=self._is_low(reference_state[0]),
        )
        self.player.start(path, now_us)

    def hold_at_end(self, reference: track.Track, now_us: int) -> None:
        """Stay at the end of the reference for HOLD_S."""
        hold_us = max(TICK_US, braking.seconds_us(self._parameters["HOLD_S"]))
        self.player.start(track.hold(reference.end_ned, reference.end_yaw, hold_us), now_us)

    def stop(self, reference_state: ReferenceState, now_us: int, hold_s: float | None = None) -> None:
        """Stop and hold, for `hold_s` or until another command."""
        hold_us = track.ENDLESS_US if hold_s is None else max(TICK_US, braking.seconds_us(hold_s))
        path = track.stop(*reference_state, brakes=self.envelope.brakes, room=self._room(), hold_us=hold_us)
        self.player.start(path, now_us)

    def follow(self, now_us: int) -> None:
        """Follow the newest setpoint from now on."""
        offboard = self.offboard
        target = offboard.target
        if not isinstance(target, PositionTarget):
            if target is not None:
                low = self._is_low(self._memory[law.EST_P])
                offboard.command(levelled(target, self._yaw()) if low else target)
            return
        if target == offboard.followed and target.is_stationary:
            return
        node, yaw = self.reference_state(now_us)
        offboard.release()
        target_ned = to_ned(target, self._yaw())
        if self._is_low(node):
            target_ned = climb_only(target_ned, node)
        else:
            offboard.followed = target
        path, bounded = towards(target_ned, node, yaw, offboard.bounds(self.floor, self.envelope.brakes))
        if bounded and not self._bounded:
            self._report("setpoint bounded by fence, floor or speed")
        self._bounded = bounded
        self.player.start(path, now_us)

    # Descent.

    def land(self, reference_state: ReferenceState, now_us: int) -> None:
        """Stop and descend vertically."""
        values = self._parameters
        descent = track.land(
            *reference_state,
            floor=self.floor,
            speed=values["LAND_SPEED"],
            brakes=self.envelope.brakes,
            room=self._room(),
        )
        self.player.start(descent, now_us)

    def descend_level(self, reference_state: ReferenceState, thrust_ratio: float, now_us: int) -> None:
        """Stop and descend by velocity feedback only, after FS_BLIND_S without position or velocity feedback.

        reference_state: its acceleration and yaw continue. thrust_ratio: actual over nominal thrust,
        estimated while position was known. From a height the vehicle first sinks faster, because dead
        reckoning gets worse with time.
        """
        memory, values = self._memory, self._parameters
        blind_us = values.us("FS_BLIND_S")
        node, (yaw, _) = reference_state
        descent = track.level_descent(
            (*memory[law.EST_P], *memory[law.EST_V], *node[6:]),
            yaw,
            floor=self.floor,
            speed=values["FS_SINK_SPEED"],
            brakes=self.envelope.brakes,
            room=self._room(),
            damped_us=blind_us,
            end_us=blind_us + values.us("FS_BLIND_END_S"),
        )
        self._weights[0] = 0.0
        self._blind_until_us = now_us + blind_us
        # The disturbance estimate depends on a velocity that is no longer measured.
        for k in range(law.OBSERVER.start, law.OBSERVER.stop):
            memory[k] = 0.0
        self._compensate_thrust(thrust_ratio)
        self.player.start(descent, now_us)

    def go_blind(self, thrust_ratio: float, now_us: int) -> None:
        """Turn velocity feedback off after FS_BLIND_S, when dead reckoning is unreliable.

        thrust_ratio: actual over nominal thrust, estimated in the descent so far.
        """
        if now_us >= self._blind_until_us and not self.blind:
            self._weights[1] = 0.0
            self._compensate_thrust(thrust_ratio)

    def _compensate_thrust(self, thrust_ratio: float) -> None:
        """Compensate the thrust ratio by feed-forward instead of feedback."""
        self._feedforward.hold((0.0, 0.0, GRAVITY / thrust_ratio - GRAVITY))

    def fall(self, now_us: int) -> None:
        """Stop the rotors in the air."""
        self._armed[0] = 0.0
        self.player.start(track.hold((0.0, 0.0, 0.0), 0.0, FALL_US), now_us)

    def _room(self) -> braking.Room:
        return self.offboard.room(self.floor)

    def _is_low(self, node: Sequence[float]) -> bool:
        return self.floor - node[2] < CLEAR_HEIGHT

    def _position(self) -> braking.Vector:
        return (self._memory[0], self._memory[1], self._memory[2])

    def _yaw(self) -> float:
        w, x, y, z = self._memory[law.EST_Q]
        return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
