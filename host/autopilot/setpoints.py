"""Setpoints for another autopilot: the way to the reference, the reference, and their message."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from trimtab.host.log.tracking import FLAT_SIZE, ReferencePath
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Reference
from trimtab.protocol.messages import Message, mavlink

Vector = tuple[float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)
_PEAK = 15.0 / 8.0
"""Peak over mean speed of a quintic from rest to rest."""
_LEG_MIN_S = 2.0


class Setpoint(NamedTuple):
    """Position (m), velocity (m/s) and acceleration (m/s^2) in NED; yaw (rad) and its rate (rad/s)."""

    p: Vector
    v: Vector = ZERO
    a: Vector = ZERO
    yaw: float = 0.0
    yaw_rate: float = 0.0

    def at_rest(self) -> Setpoint:
        """Return the setpoint that holds this position and yaw."""
        return Setpoint(self.p, yaw=self.yaw)

    def message(self, time_us: int) -> Message:
        """Return SET_POSITION_TARGET_LOCAL_NED with all fields in use, stamped with the host's time."""
        boot_ms = time_us // 1000 & 0xFFFF_FFFF
        frame, all_fields = mavlink.MAV_FRAME_LOCAL_NED, 0
        return m.SetPositionTarget(
            boot_ms, *m.VEHICLE, frame, all_fields, *self.p, *self.v, *self.a, self.yaw, self.yaw_rate
        )


class Way:
    """Straight legs through `corners`, at rest at each, by quintics with peak speed `speed_m_s`.

    Yaw turns in the shorter direction during the last leg, and ends at `yaw_end`.
    """

    def __init__(self, corners: Sequence[Vector], yaw: float, yaw_end: float, *, speed_m_s: float) -> None:
        self._corners = [np.array(corner) for corner in corners]
        spans_m = [math.dist(a, b) for a, b in pairwise(corners)]
        self._legs_s = [max(_LEG_MIN_S, _PEAK * span / speed_m_s) for span in spans_m]
        self._turn = math.remainder(yaw_end - yaw, 2.0 * math.pi)
        self._yaw_end = yaw_end

    @property
    def duration_us(self) -> int:
        """Time from the first corner to the last."""
        return round(1e6 * sum(self._legs_s))

    def at(self, t_us: int) -> Setpoint:
        """Return the setpoint at a time after the start; after the end, that of the last corner."""
        t_s, last = 1e-6 * max(0, t_us), len(self._legs_s) - 1
        k = 0
        while k < last and t_s >= self._legs_s[k]:
            t_s -= self._legs_s[k]
            k += 1
        span_s = self._legs_s[k]
        s = min(t_s / span_s, 1.0)
        share = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        rate = 30.0 * s**2 * (1.0 - s) ** 2 / span_s
        curve = 60.0 * s * (1.0 - 3.0 * s + 2.0 * s**2) / span_s**2
        begin, step = self._corners[k], self._corners[k + 1] - self._corners[k]
        turned, turn_rate = (share, rate) if k == last else (0.0, 0.0)
        return Setpoint(
            _vector(begin + share * step),
            _vector(rate * step),
            _vector(curve * step),
            self._yaw_end - self._turn * (1.0 - turned),
            self._turn * turn_rate,
        )


class Course:
    """A reference as setpoints."""

    def __init__(self, reference: Reference) -> None:
        self._path = ReferencePath(reference)
        self.duration_us = reference.duration_us

    def flat_at(self, t_us: int) -> list[float]:
        """Return the flat outputs (14) at a time after the start; outside it, those of the end nodes."""
        flat: list[float] = self._path.at(np.array([t_us]))[0].tolist()
        assert len(flat) == FLAT_SIZE
        return flat

    def at(self, t_us: int) -> Setpoint:
        """Return the setpoint at a time after the start; outside it, at rest at an end node."""
        return setpoint_of(self.flat_at(t_us))


def setpoint_of(flat: Sequence[float]) -> Setpoint:
    """Return the setpoint of flat outputs: p, v, a, j (3 each), yaw, yaw rate."""
    return Setpoint(_vector(flat[0:3]), _vector(flat[3:6]), _vector(flat[6:9]), flat[12], flat[13])


def _vector(values: Sequence[float] | np.ndarray) -> Vector:
    x, y, z = map(float, values)
    return x, y, z
