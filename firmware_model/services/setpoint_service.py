"""Setpoint messages: converts each message to a target, or refuses it with a reason."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from trimtab.firmware_model.flight.setpoints import AttitudeTarget, PositionTarget, Target
from trimtab.protocol import messages as m
from trimtab.protocol.messages import mavlink

_LOCAL, _OFFSET, _BODY = (
    mavlink.MAV_FRAME_LOCAL_NED,
    mavlink.MAV_FRAME_LOCAL_OFFSET_NED,
    mavlink.MAV_FRAME_BODY_NED,
)
_FORCE = mavlink.POSITION_TARGET_TYPEMASK_FORCE_SET
_RATES = (
    mavlink.ATTITUDE_TARGET_TYPEMASK_BODY_ROLL_RATE_IGNORE,
    mavlink.ATTITUDE_TARGET_TYPEMASK_BODY_PITCH_RATE_IGNORE,
    mavlink.ATTITUDE_TARGET_TYPEMASK_BODY_YAW_RATE_IGNORE,
)
_NO_ATTITUDE = mavlink.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE

NOT_FINITE = "setpoint: numbers that are not finite are left out"


class SetpointService:
    """Handlers of setpoint messages. Each reason for a refusal is reported once.

    Parameters
    ----------
    take
        Receives target and time.
    text
        Sends severity and text to the host.

    Attributes
    ----------
    source
        System and component that sent the last setpoint, or None.
    """

    def __init__(self, *, take: Callable[[Target, int], None], text: Callable[[int, str], None]) -> None:
        self._take = take
        self._text = text
        self._reported: set[str] = set()
        self.source: tuple[int, int] | None = None

    def position(self, message: m.SetPositionTarget, now_us: int) -> None:
        """Follow or refuse SET_POSITION_TARGET_LOCAL_NED."""
        mask, frame = message.type_mask, message.coordinate_frame
        numbers = (
            message.x, message.y, message.z, message.vx, message.vy, message.vz,
            message.afx, message.afy, message.afz,
        )  # fmt: skip
        fields = self._fields(numbers, mask)
        p, v, a = fields[0:3], fields[3:6], fields[6:9]
        (yaw,) = self._fields((message.yaw,), mask >> 10)
        (yaw_rate,) = self._fields((message.yaw_rate,), mask >> 11)
        if frame not in (_LOCAL, _OFFSET, _BODY):
            self._refuse(f"setpoint refused: frame {frame} not known")
        elif mask & _FORCE and any(x is not None for x in a):
            self._refuse("setpoint refused: forces are not followed")
        elif frame != _LOCAL and any(x is not None for x in p):
            self._refuse("setpoint refused: position in LOCAL_NED only")
        elif any(x is None and y is None for x, y in zip(p, v, strict=True)):
            self._refuse("setpoint refused: axis without position, velocity")
        else:
            target = PositionTarget(
                p=(p[0], p[1], p[2]),
                v=(v[0], v[1], v[2]),
                a=(a[0] or 0.0, a[1] or 0.0, a[2] or 0.0),
                yaw=yaw,
                yaw_rate=yaw_rate,
                ahead=frame == _BODY,
            )
            self.source = m.sender_of(message)
            self._take(target, now_us)

    def attitude(self, message: m.SetAttitudeTarget, now_us: int) -> None:
        """Follow or refuse SET_ATTITUDE_TARGET."""
        mask = message.type_mask
        rates = (message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate)
        ignored = sum(bool(mask & bit) << k for k, bit in enumerate(_RATES))
        rate = self._fields(rates, ignored)
        (thrust,) = self._fields((message.thrust,), mask >> 6)
        q = None if mask & _NO_ATTITUDE else tuple(message.q)
        length = 1.0 if q is None else math.hypot(*q)
        if thrust is None:
            self._refuse("setpoint refused: attitude or rate without thrust")
        elif not 0.9 < length < 1.1:
            self._refuse("setpoint refused: no unit quaternion")
        elif q is None and None in rate:
            self._refuse("setpoint refused: body rate not whole")
        else:
            target = AttitudeTarget(
                thrust=min(max(thrust, 0.0), 1.0),
                rate=(rate[0] or 0.0, rate[1] or 0.0, rate[2] or 0.0),
                q=None if q is None else (q[0] / length, q[1] / length, q[2] / length, q[3] / length),
            )
            self.source = m.sender_of(message)
            self._take(target, now_us)

    def _fields(self, numbers: Sequence[float], ignored: int) -> list[float | None]:
        """Return the numbers, with None for those that are masked out (bits of `ignored`) or not finite."""
        fields: list[float | None] = []
        for k, number in enumerate(numbers):
            used = not ignored >> k & 1
            if used and not math.isfinite(number):
                self._refuse(NOT_FINITE)
            fields.append(number if used and math.isfinite(number) else None)
        return fields

    def _refuse(self, text: str) -> None:
        if text not in self._reported:
            self._reported.add(text)
            self._text(mavlink.MAV_SEVERITY_WARNING, text)
