"""The envelope: how hard the vehicle can brake, and where it would stop if it braked now.

A vehicle that follows a reference stays where the reference does. Under a directly commanded attitude, or far
from its reference, only a stop in time keeps it inside the flight volume. So the failsafe acts on the
predicted stopping point, not on the present position. The prediction takes the present motion, the thrust on
its way to the rotors, the time to turn the thrust axis, and then a constant deceleration.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from trimtab.firmware_model.flight.braking import SIDEWAYS_RAMP_US, VERTICAL_RAMP_US, Brakes
from trimtab.firmware_model.flight.condition_monitor import CLEAR_HEIGHT, Box
from trimtab.firmware_model.law.constants import GRAVITY

THRUST_SHARE = 0.75
"""Share of the greatest thrust that a stop uses; the rest is for attitude control."""
SIDEWAYS_TILT_DEG = 50.0
"""Greatest tilt of a horizontal stop without a climb or a descent."""
TILT_MAX_DEG = 70.0
"""Greatest tilt of a horizontal stop beside a climb that is braked: little lift is left to tilt."""
RISING_SHARE = 0.95
"""Share of the greatest deceleration of a climb, that without thrust beyond the least, that a stop uses."""
SINKING_MAX = 12.0
"""Greatest deceleration (m/s^2) of a descent."""
SINKING_MIN = 0.5
"""Least deceleration (m/s^2) of a descent that a prediction assumes, for vehicles with little thrust."""
DECISION_S = 0.012
"""Time from a measurement to the thrust of a decision: one update, and a tick of the rotors' commands."""
TURN_SHARE = 0.7
"""Mean body rate of a turn of the thrust axis over ATT_P times its angle."""
TURN_S = 0.05
"""Time that a turn of the thrust axis takes beyond that: the body rate has to build up and to end."""
TURN_LIFT = 3.0
"""Lift (m/s^2) beyond the least while the thrust axis turns: torque takes more thrust than is commanded."""
SHARE_MIN = 0.3
"""Least share of a horizontal deceleration along an axis, for one along which the vehicle hardly moves."""
IMPACT_SPEED = 1.0
"""Greatest speed (m/s) at which a stop may still meet the floor."""


class Motion(NamedTuple):
    """Estimated motion at one time.

    p, v, a: position (m), velocity and acceleration with gravity (m/s^2), NED. thrust: commanded thrust over
    mass (m/s^2). cos_tilt: cosine of the tilt.
    """

    p: Sequence[float]
    v: Sequence[float]
    a: Sequence[float]
    thrust: float
    cos_tilt: float

    @property
    def tilt(self) -> float:
        """Tilt, rad."""
        return math.acos(min(max(self.cos_tilt, -1.0), 1.0))


class Envelope(NamedTuple):
    """Constants of the prediction, from the parameters on board and the thrust ratio.

    brakes: greatest decelerations. lag_s: time constant of the rotors' thrust. turn_rate: mean body rate over
    the angle of a turn of the thrust axis (1/s).
    """

    brakes: Brakes
    lag_s: float
    turn_rate: float

    def apex(self, motion: Motion) -> float:
        """Return how far the vehicle would still climb, m, if the thrust were cut now."""
        speed, excess_s = self._rising(motion)
        if speed <= 0.0:
            return 0.0
        delay_s = DECISION_S + 0.5e-6 * VERTICAL_RAMP_US
        high = max(0.0, -motion.v[2]) * delay_s + speed * speed / (2.0 * self.brakes.rising)
        return high - excess_s * self.lag_s

    def _rising(self, motion: Motion) -> tuple[float, float]:
        """Return the speed (m/s) from which a climb has to stop, and the part gained in the rotor lag."""
        lift = GRAVITY - motion.a[2]
        commanded = motion.thrust * max(motion.cos_tilt, 0.0)
        lift += max(0.0, commanded - lift) * (1.0 - math.exp(-DECISION_S / self.lag_s))
        excess_s = max(0.0, lift - (GRAVITY - self.brakes.rising)) * self.lag_s
        turned = TURN_LIFT * self._turn_to_brake(motion)[0] / self.turn_rate
        return -motion.v[2] + (lift - GRAVITY) * DECISION_S + excess_s + turned, excess_s

    def sideways(self, motion: Motion, room: float) -> tuple[float, float, float, float]:
        """Return how far the vehicle would still move to the north, south, east and west, m.

        room: height (m) that is left for a climb. A climb that needs a hard stop leaves less lift to tilt.
        """
        rising = max(0.0, self._rising(motion)[0]) if motion.v[2] < 0.0 else 0.0
        needed = self.brakes.climb(rising, room)
        beside, brake = self.brakes.sideways_beside(needed), self.brakes.sideways
        beside_s = rising / needed + 1e-6 * (VERTICAL_RAMP_US + SIDEWAYS_RAMP_US / 2) if rising else 0.0
        brake_tilt = math.atan2(brake, GRAVITY)
        tilt = motion.tilt
        level = max(math.hypot(motion.a[0], motion.a[1]), 1e-6)
        shares = _shares(motion, 0.5 * self._turn_s(brake_tilt + tilt))
        distances = []
        for axis, side in ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)):
            v, a, share = side * motion.v[axis], side * motion.a[axis], shares[axis]
            turn_s = max(1e-6 * SIDEWAYS_RAMP_US, self._turn_s(max(0.0, brake_tilt + tilt * a / level)))
            distances.append(_stop_distance(v, a, (share * beside, share * brake), beside_s, turn_s))
        north, south, east, west = distances
        return north, south, east, west

    def impact_speed(self, motion: Motion, height: float) -> float:
        """Return the speed (m/s) at which the vehicle would meet a floor `height` below it; 0 if it stops.

        A vehicle that moves sideways must stop CLEAR_HEIGHT above the floor. While its thrust turns to brake,
        it has less lift.
        """
        sinking, a = motion.v[2], motion.a[2]
        turn, sideways = self._turn_to_brake(motion)
        if sideways > IMPACT_SPEED:
            height -= CLEAR_HEIGHT
            a = max(a, GRAVITY * (1.0 - max(0.0, math.cos(turn))))
        # A linear change as late, in its mean, as the stop's ramp behind decision and rotor lag.
        turn_s = turn / self.turn_rate + 2.0 * (DECISION_S + self.lag_s) + 1e-6 * VERTICAL_RAMP_US
        brake = max(self.brakes.sinking, SINKING_MIN)
        after = sinking + turn_s * (a - brake) / 2.0
        left = height - (sinking * turn_s + turn_s**2 * (2.0 * a - brake) / 6.0)
        if after <= 0.0 or left <= 0.0:
            square = max(sinking, 0.0) ** 2 + 2.0 * max(a, 0.0) * max(height, 0.0)
            return math.hypot(math.sqrt(square), sideways) if left <= 0.0 else 0.0
        square = after * after - 2.0 * brake * left
        return math.hypot(math.sqrt(square), sideways) if square > 0.0 else 0.0

    def _turn_to_brake(self, motion: Motion) -> tuple[float, float]:
        """Return the angle (rad) by which the thrust axis turns to brake, and the horizontal speed then, m/s.

        A slow vehicle only becomes level.
        """
        tilt, (a_north, a_east, _) = motion.tilt, motion.a
        half_s = 0.5 * self._turn_s(tilt)
        north, east = motion.v[0] + half_s * a_north, motion.v[1] + half_s * a_east
        sideways = math.hypot(north, east)
        if sideways <= IMPACT_SPEED:
            return tilt, sideways
        scale = tilt / max(sideways * math.hypot(a_north, a_east), 1e-6)
        along, across = scale * (north * a_north + east * a_east), scale * (north * a_east - east * a_north)
        return math.hypot(along + math.atan2(self.brakes.gentle, GRAVITY), across), sideways

    def _turn_s(self, angle: float) -> float:
        return angle / self.turn_rate + self.lag_s + TURN_S


def envelope(parameters: Mapping[str, float], thrust_ratio: float, gentle: float) -> Envelope:
    """Return the envelope of the parameters on board.

    thrust_ratio: actual over nominal thrust. gentle: deceleration of stops with room, m/s^2.
    """
    mass = parameters["MASS"]
    most = THRUST_SHARE * 4.0 * parameters["THRUST_MAX"] * min(thrust_ratio, 1.0) / mass
    least = max(parameters["THRUST_FLOOR"] * GRAVITY, 4.0 * parameters["THRUST_MIN"] / mass)
    tilt = min(SIDEWAYS_TILT_DEG, parameters["LIM_TILT_DEG"])
    sideways = min(GRAVITY * math.tan(math.radians(tilt)), math.sqrt(max(0.0, most**2 - GRAVITY**2)))
    sinking = min(max(SINKING_MIN, most - GRAVITY), SINKING_MAX)
    brakes = Brakes(
        gentle=gentle,
        sideways=max(sideways, SINKING_MIN),
        rising=RISING_SHARE * (GRAVITY - least),
        sinking=sinking,
        tilt=math.tan(math.radians(min(parameters["LIM_TILT_DEG"], TILT_MAX_DEG))),
    )
    turn_rate = TURN_SHARE * max(1e-3, min(parameters["ATT_P_X"], parameters["ATT_P_Y"]))
    return Envelope(brakes=brakes, lag_s=parameters["MOTOR_LAG"], turn_rate=turn_rate)


def stops_outside(envelope: Envelope, motion: Motion, fence: Box, margin: float, floor: float) -> bool:
    """Return whether a stop that began now would end outside the fence, or meet the floor too fast.

    margin: distance (m) by which it may end outside. floor: floor of the take-off (m, down). Below it, the
    bottom of the fence is the floor.
    """
    (south, north), (west, east), (top, bottom) = fence
    p = motion.p
    room = p[2] - top
    if envelope.apex(motion) > room + margin:
        return True
    to_north, to_south, to_east, to_west = envelope.sideways(motion, room)
    past = (p[0] + to_north - north, south - p[0] + to_south, p[1] + to_east - east, west - p[1] + to_west)
    if max(past) > margin:
        return True
    height = floor - p[2]
    return envelope.impact_speed(motion, height if height >= 0.0 else bottom + margin - p[2]) > IMPACT_SPEED


def _shares(motion: Motion, after_s: float) -> tuple[float, float]:
    """Return the share of a horizontal deceleration that acts along each axis: a stop is a straight line."""
    north, east = (motion.v[axis] + after_s * motion.a[axis] for axis in (0, 1))
    speed = max(math.hypot(north, east), 1e-6)
    return max(SHARE_MIN, abs(north) / speed), max(SHARE_MIN, abs(east) / speed)


def _stop_distance(v: float, a: float, brakes: tuple[float, float], first_s: float, turn_s: float) -> float:
    """Return the distance to a stop along one axis.

    The acceleration changes linearly from `a` to the first brake within `turn_s`. The first brake acts until
    `first_s`, the second after it.
    """
    first, second = brakes
    after = v + turn_s * (a - first) / 2.0
    if after <= 0.0:
        return max(0.0, v) * min(turn_s, max(0.0, v) / max(first, 1e-6))
    distance = v * (turn_s + DECISION_S) + turn_s**2 * (2.0 * a - first) / 6.0
    first_s = min(max(0.0, first_s - turn_s), after / first)
    distance += first_s * (after - first * first_s / 2.0)
    after -= first * first_s
    ramp_s = 1e-6 * SIDEWAYS_RAMP_US  # in which the deceleration ends
    return max(0.0, distance + after * after / (2.0 * second) + second * ramp_s**2 / 24.0)
