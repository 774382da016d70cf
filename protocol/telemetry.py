"""What the vehicle reports at rate: running sums, and the field encodings of the FC_ messages.

The vehicle adds up motor commands, gyro and specific force over all ticks since boot, in counts. It sends the
floor of each sum modulo 2^32, so the remainder is carried along. The difference of two messages is the exact
sum between them: a lost message widens the interval and loses nothing. Differences are read as signed, which
is unambiguous below 2^31 counts: over the longest interval, 10 s, a mean of 52 rad/s or 209 m/s^2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from trimtab.protocol.messages import FcControl, FcEstimate, FcObserver

TICK_US = 1000
"""Everybody's base tick: the law's step, the plant's, and the unit of ticks in messages."""
MOTOR_COUNTS = 65536.0
"""Counts per unit of motor command and tick."""
GYRO_COUNTS = 4096.0
"""Counts per rad/s and tick."""
FORCE_COUNTS = 1024.0
"""Counts per m/s^2 and tick."""
GAP_MAX_TICKS = 10_000
"""A longer interval is invalid."""
OVERTAKEN_TICKS = 1_000
"""A message whose tick is less than this behind the newest is late; further back, the vehicle rebooted."""
QUATERNION_SCALE = 32767
AGE_TICK_US = 100
AGE_NONE = 0xFFFF
"""FC_ESTIMATE.mocap_age of a pose that is 6.5 s old or more, or that never came."""

_MODULUS = 1 << 32
_HALF = 1 << 31
_MASK = _MODULUS - 1


def encode_sum(counts: float) -> int:
    """Return the running sum as it is sent: its floor modulo 2^32."""
    return math.floor(counts) & _MASK


def difference(later: int, earlier: int) -> int:
    """Return counts from `earlier` to `later`, signed: -2^31 to 2^31 - 1."""
    return ((later - earlier + _HALF) & _MASK) - _HALF


def encode_quaternion(q: Sequence[float]) -> tuple[int, int, int, int]:
    """Return a unit quaternion as FC_ESTIMATE carries it; each part is off by at most half a step of
    1/32767.
    """
    w, x, y, z = (max(-QUATERNION_SCALE, min(QUATERNION_SCALE, round(QUATERNION_SCALE * part))) for part in q)
    return (w, x, y, z)


def decode_quaternion(q: Sequence[int]) -> tuple[float, float, float, float]:
    """Return the unit quaternion in FC_ESTIMATE, w first; the identity where all parts are 0."""
    w, x, y, z = q
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    return (w / norm, x / norm, y / norm, z / norm) if norm else (1.0, 0.0, 0.0, 0.0)


def whole_tick(tick: int, now: int) -> int:
    """Return the tick nearest to `now` of which a message has the last 32 bits; they begin anew after 49.7
    days.
    """
    return now + difference(tick, now)


def encode_age(age_us: int | None) -> int:
    """Age of a pose as FC_ESTIMATE carries it, rounded to 0.1 ms; None is for no pose."""
    if age_us is None:
        return AGE_NONE
    return max(0, min(AGE_NONE, (age_us + AGE_TICK_US // 2) // AGE_TICK_US))


def decode_age(age: int) -> int | None:
    """Age in us; None where it is 6.5 s or more, or there was no pose."""
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
    """FC_CONTROL at this tick. The sums come in counts, as floats that nothing has wrapped yet."""
    return FcControl(
        tick & _MASK,
        collective_n,
        rate_cmd,
        torque,
        [encode_sum(counts) for counts in motor_sum],
        [encode_sum(counts) for counts in gyro_sum],
        [encode_sum(counts) for counts in force_sum],
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
    """FC_ESTIMATE at this tick."""
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
    """FC_OBSERVER at this tick."""
    return FcObserver(tick & _MASK, disturbance_ned)


class ControlInterval(NamedTuple):
    """Means between two FC_CONTROL messages, over the ticks after `start_tick` up to and with `end_tick`."""

    start_tick: int
    end_tick: int
    motor_mean: tuple[float, ...]
    """4, in 0..1."""
    gyro_mean: tuple[float, ...]
    """3, rad/s, FRD."""
    force_mean: tuple[float, ...]
    """3, m/s^2, FRD."""


class IntervalDecoder:
    """Turns the FC_CONTROL messages of one vehicle into intervals.

    Attributes, counts since construction:
        invalid: messages that began anew: the tick ran back (a reboot) or more than 10 s were missing.
        ignored: repeated messages, and late ones: overtaken by less than OVERTAKEN_TICKS, or from within the
            last interval given.
    """

    def __init__(self) -> None:
        self.invalid = 0
        self.ignored = 0
        self._last: FcControl | None = None
        self._before = 0

    def push(self, message: FcControl) -> ControlInterval | None:
        """Return the interval that this message ends; None for a first message, an invalid, late or repeated
        one.
        """
        last = self._last
        if last is None:
            self._begin(message)
            return None
        ticks = message.tick - last.tick
        if -OVERTAKEN_TICKS < ticks <= 0 or self._before < message.tick < last.tick:
            self.ignored += 1
            return None
        if not 0 < ticks <= GAP_MAX_TICKS:
            self.invalid += 1
            self._begin(message)
            return None
        self._last, self._before = message, last.tick
        return ControlInterval(
            start_tick=last.tick,
            end_tick=message.tick,
            motor_mean=_means(message.motor_sum, last.motor_sum, ticks * MOTOR_COUNTS),
            gyro_mean=_means(message.gyro_sum, last.gyro_sum, ticks * GYRO_COUNTS),
            force_mean=_means(message.force_sum, last.force_sum, ticks * FORCE_COUNTS),
        )

    def _begin(self, message: FcControl) -> None:
        self._last, self._before = message, message.tick


def _means(later: Sequence[int], earlier: Sequence[int], counts: float) -> tuple[float, ...]:
    # `difference` written out: this runs ten times a message.
    return tuple([((b - a + _HALF & _MASK) - _HALF) / counts for b, a in zip(later, earlier, strict=True)])
