"""Running sums and field encodings of the FC_ messages, which the vehicle sends at a fixed rate.

The vehicle sums motor commands, gyro and specific force over all ticks since boot, in counts. It sends the
floor of each sum modulo 2^32 and carries the remainder along. The difference of two messages is therefore the
exact sum between them: a lost message widens the interval but loses no data. Differences are signed. They are
unambiguous below 2^31 counts: over the longest interval, 10 s, that is a mean of 52 rad/s or 209 m/s^2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from trimtab.protocol.messages import FcControl, FcEstimate, FcObserver, FcRotors

TICK_US = 1000
"""Base tick: step of the control law and of the plant, and unit of ticks in messages."""
MOTOR_COUNTS = 65536.0
"""Counts per unit of motor command and tick."""
GYRO_COUNTS = 4096.0
"""Counts per rad/s and tick."""
FORCE_COUNTS = 1024.0
"""Counts per m/s^2 and tick."""
ROTOR_COUNTS = 50_000.0
"""Counts of FC_ROTORS for the speed at the greatest thrust; the code reaches 1.31 times that."""
GAP_MAX_TICKS = 10_000
"""Longest valid interval between two FC_CONTROL messages."""
OVERTAKEN_TICKS = 1_000
"""A message is late if its tick is less than this behind the newest; if more, the vehicle has rebooted."""
QUATERNION_SCALE = 32767
AGE_TICK_US = 100
AGE_NONE = 0xFFFF
"""FC_ESTIMATE.mocap_age if the newest pose is 6.5 s old or older, or if none has arrived."""

_CODE_MAX = 0xFFFF
_MODULUS = 1 << 32
_HALF = 1 << 31
_MASK = _MODULUS - 1


def encode_sums(counts: Sequence[float]) -> list[int]:
    """Return the wire values of running sums: their floors modulo 2^32."""
    return [math.floor(count) & _MASK for count in counts]


def difference(later: int, earlier: int) -> int:
    """Return the signed counts from `earlier` to `later`: -2^31 to 2^31 - 1."""
    return ((later - earlier + _HALF) & _MASK) - _HALF


def encode_quaternion(q: Sequence[float]) -> tuple[int, int, int, int]:
    """Return the FC_ESTIMATE code of a unit quaternion, in steps of 1/32767 for each component."""
    w, x, y, z = q
    scale = QUATERNION_SCALE
    w, x, y, z = round(scale * w), round(scale * x), round(scale * y), round(scale * z)
    if max(w, x, y, z) > scale or min(w, x, y, z) < -scale:  # by rounding
        w, x, y, z = [max(-scale, min(scale, code)) for code in (w, x, y, z)]
    return (w, x, y, z)


def decode_quaternion(q: Sequence[int]) -> tuple[float, float, float, float]:
    """Return the unit quaternion of an FC_ESTIMATE code, w first; the identity if all components are 0."""
    w, x, y, z = q
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    return (w / norm, x / norm, y / norm, z / norm) if norm else (1.0, 0.0, 0.0, 0.0)


def unwrap_tick(tick: int, now: int) -> int:
    """Return the tick nearest to `now` whose last 32 bits are `tick`. The 32 bits wrap after 49.7 days."""
    return now + difference(tick, now)


def encode_age(age_us: int | None) -> int:
    """Return the FC_ESTIMATE code of a pose age, rounded to 0.1 ms. None stands for no pose."""
    if age_us is None:
        return AGE_NONE
    return max(0, min(AGE_NONE, (age_us + AGE_TICK_US // 2) // AGE_TICK_US))


def decode_age(age: int) -> int | None:
    """Return the age in us, or None if it is 6.5 s or more or if no pose has arrived."""
    return None if age >= AGE_NONE else age * AGE_TICK_US


def control_message(
    tick: int,
    *,
    collective_n: float,
    rate_cmd: Sequence[float],
    torque: Sequence[float],
    motor_sum: Sequence[float],
    gyro_sum: Sequence[float],
    force_sum: Sequence[float],
    rate_integral: Sequence[float],
) -> FcControl:
    """Return FC_CONTROL at this tick. The sums are unwrapped counts."""
    return FcControl(
        tick & _MASK,
        collective_n,
        rate_cmd,
        torque,
        encode_sums(motor_sum),
        encode_sums(gyro_sum),
        encode_sums(force_sum),
        rate_integral,
    )


def estimate_message(
    tick: int,
    *,
    p_ned: Sequence[float],
    v_ned: Sequence[float],
    q_ned_frd: Sequence[float],
    rate_frd: Sequence[float],
    mocap_age_us: int | None,
    gyro_bias_frd: Sequence[float],
) -> FcEstimate:
    """Return FC_ESTIMATE at this tick."""
    return FcEstimate(
        tick & _MASK,
        p_ned,
        v_ned,
        encode_quaternion(q_ned_frd),
        rate_frd,
        encode_age(mocap_age_us),
        gyro_bias_frd,
    )


def observer_message(tick: int, *, disturbance_ned: Sequence[float]) -> FcObserver:
    """Return FC_OBSERVER at this tick."""
    return FcObserver(tick & _MASK, disturbance_ned)


def rotors_message(tick: int, *, speed: Sequence[float]) -> FcRotors:
    """Return FC_ROTORS at this tick; speed: of each rotor, over that at the greatest thrust.

    Raises ValueError or OverflowError if a speed is not finite.
    """
    codes = [max(0, min(_CODE_MAX, round(ROTOR_COUNTS * each))) for each in speed]
    return FcRotors(tick & _MASK, codes)


def decode_rotor_speed(codes: Sequence[int]) -> list[float]:
    """Return the rotor speeds of an FC_ROTORS message, over that at the greatest thrust."""
    return [code / ROTOR_COUNTS for code in codes]


class ControlInterval(NamedTuple):
    """Means between two FC_CONTROL messages, over the ticks `start_tick` + 1 to `end_tick`."""

    start_tick: int
    end_tick: int
    motor_mean: tuple[float, ...]
    """4, in 0..1."""
    gyro_mean: tuple[float, ...]
    """3, rad/s, FRD."""
    force_mean: tuple[float, ...]
    """3, m/s^2, FRD."""


class IntervalDecoder:
    """Converts the FC_CONTROL messages of one vehicle to intervals.

    Attributes, counts since construction:
        invalid: messages that restarted the decoder: the tick ran back (a reboot) or more than 10 s were
            missing.
        ignored: repeated messages and late ones. A message is late if it was overtaken by less than
            OVERTAKEN_TICKS, or if it lies within the last interval returned.
    """

    def __init__(self) -> None:
        self.invalid = 0
        self.ignored = 0
        self._last: FcControl | None = None
        self._previous_tick = 0

    def push(self, message: FcControl) -> ControlInterval | None:
        """Return the interval that ends with this message, or None.

        A first, invalid, late or repeated message ends no interval.
        """
        last = self._last
        if last is None:
            self._restart(message)
            return None
        ticks = message.tick - last.tick
        if -OVERTAKEN_TICKS < ticks <= 0 or self._previous_tick < message.tick < last.tick:
            self.ignored += 1
            return None
        if not 0 < ticks <= GAP_MAX_TICKS:
            self.invalid += 1
            self._restart(message)
            return None
        self._last, self._previous_tick = message, last.tick
        return ControlInterval(
            start_tick=last.tick,
            end_tick=message.tick,
            motor_mean=_means(message.motor_sum, last.motor_sum, ticks * MOTOR_COUNTS),
            gyro_mean=_means(message.gyro_sum, last.gyro_sum, ticks * GYRO_COUNTS),
            force_mean=_means(message.force_sum, last.force_sum, ticks * FORCE_COUNTS),
        )

    def _restart(self, message: FcControl) -> None:
        self._last, self._previous_tick = message, message.tick


def _means(later: Sequence[int], earlier: Sequence[int], counts: float) -> tuple[float, ...]:
    # `difference` inlined: this runs ten times for each message.
    return tuple([((b - a + _HALF & _MASK) - _HALF) / counts for b, a in zip(later, earlier, strict=True)])
