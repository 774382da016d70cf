"""Measurements of the vehicle and the camera system. Noise and bias are drawn in blocks for speed."""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np

from trimtab.firmware_model.clock import NEVER_US
from trimtab.protocol.telemetry import TICK_US
from trimtab.sitl.camera_faults import CameraFaults
from trimtab.sitl.world import ImuSettings, MocapSettings

_BLOCK = 1024
_LEAST_NOISE = 1e-9  # an IMU never repeats a value exactly; the vehicle would take it for stuck
_BOW_PER_M = 0.02  # a tilted camera frame is also curved: its tilt changes along the direction of the lean
_ROTOR_SPEED_NOISE = 0.003  # relative: a design choice, the time between commutations is counted coarsely
_SEVEN = struct.Struct("7d")
_STAMP_JITTER = (
    0.15  # of an undeclared latency: a busy computer that stamps the poses delays them by varying amounts
)


class Imu:
    """Noise and bias of gyro, accelerometer and voltage: seven numbers per tick.

    Parameters
    ----------
    settings
        Standard deviations.
    rng
        Generator of the flight. The biases are its first draws.
    """

    def __init__(self, settings: ImuSettings, rng: np.random.Generator) -> None:
        s = settings
        self._rng = rng
        self._noise = np.array(
            [s.gyro_noise_rad_s] * 3 + [s.accelerometer_noise_m_s2] * 3 + [s.voltage_noise_v]
        )
        self._noise[:6] = np.maximum(self._noise[:6], _LEAST_NOISE)
        bias = np.array([s.gyro_bias_rad_s] * 3 + [s.accelerometer_bias_m_s2] * 3 + [0.0])
        self.bias = bias * rng.standard_normal(7)

    def errors(self) -> Iterator[tuple[float, ...]]:
        """Return the errors of each tick without end: gyro 3, specific force 3, voltage 1.

        They are drawn in blocks, and each block is used from its last row.
        """
        return chain.from_iterable(self._blocks())

    def _blocks(self) -> Iterator[Iterator[tuple[float, ...]]]:
        while True:
            block = self._rng.standard_normal((_BLOCK, 7)) * self._noise + self.bias
            yield _SEVEN.iter_unpack(block[::-1].tobytes())


class RotorSpeedSensor:
    """Rotor speeds as motor controllers measure them, with noise.

    Parameters
    ----------
    speeds
        Returns the true speeds (4,), over that at the greatest thrust.
    rng
        Generator of the flight.
    """

    def __init__(self, speeds: Callable[[], Sequence[float]], rng: np.random.Generator) -> None:
        self._speeds = speeds
        self._rng = rng

    def read(self) -> list[float]:
        """Return the measured speeds (4,), over that at the greatest thrust."""
        noise = self._rng.standard_normal(4).tolist()
        return [n * (1.0 + _ROTOR_SPEED_NOISE * e) for n, e in zip(self._speeds(), noise, strict=True)]


class Pose(NamedTuple):
    """One measured pose: stamp and arrival at the host in us, position in NED, attitude q_ned_frd."""

    stamp_us: int
    arrival_us: int
    p_ned: tuple[float, float, float]
    q_ned_frd: tuple[float, float, float, float]


class Mocap:
    """A camera system: noisy poses at a fixed rate that arrive with a delay, or not at all.

    A pose shows the vehicle `latency_s` before its stamp, with a small variation between poses. Positions and
    attitudes are rotated about the origin by `tilt`. `due_us` is the next time that `tick` has work; `ready`
    holds the poses that were not read yet.

    Parameters
    ----------
    settings
        Rate, noise, delay and gaps.
    latency_s
        Undeclared age of a pose at its stamp.
    rng
        Generator of the flight.
    tilt
        Rotation of the camera frame about north and east, rad.
    faults
        What else is wrong with the cameras.
    """

    def __init__(
        self,
        settings: MocapSettings,
        latency_s: float,
        rng: np.random.Generator,
        tilt: tuple[float, float] = (0.0, 0.0),
        faults: CameraFaults | None = None,
    ) -> None:
        self._settings = settings
        self._latency_us = latency_s * 1e6
        self._rng = rng
        self._tilt = tilt
        self._faults = faults
        self._period_us = 1_000_000 // settings.rate_hz
        self._gaps_us = [
            (round(start * 1e6), round((start + length) * 1e6)) for start, length in settings.gaps_s
        ]
        self._rows: list[list[float]] = []
        self._exposure_us = 0.0
        self._stamp_us = 0
        self._in_transit: deque[Pose] = deque()
        self.ready: list[Pose] = []
        self._next_exposure()
        self.due_us = self._exposure_due_us

    def tick(self, now_us: int, pose: Sequence[float], rate_frd: Sequence[float]) -> None:
        """Take the exposures that are due, and move arrived poses to `ready`.

        `pose` is p_ned, v_ned, q_ned_frd of the vehicle at `now_us`; its motion within a tick is uniform.
        """
        while self._exposure_due_us <= now_us:
            self._expose((self._exposure_us - now_us) * 1e-6, pose, rate_frd)
            self._next_exposure()
        while self._in_transit and self._in_transit[0].arrival_us <= now_us:
            self.ready.append(self._in_transit.popleft())
        arrival = self._in_transit[0].arrival_us if self._in_transit else NEVER_US
        self.due_us = min(self._exposure_due_us, arrival)

    def read(self) -> list[Pose]:
        """Return the poses that have arrived since the last call, oldest first."""
        ready, self.ready = self.ready, []
        return ready

    def _next_exposure(self) -> None:
        """Draw the next frame: its true time of exposure and the tick of that time."""
        if not self._rows:
            self._rows = self._draw()
        self._row = self._rows.pop()
        self._stamp_us += self._period_us
        late = self._latency_us * (1.0 + self._row[6])
        self._exposure_us = max(self._stamp_us - late, 0.0)
        self._exposure_due_us = int(self._exposure_us) // TICK_US * TICK_US

    def _expose(self, dt_s: float, pose: Sequence[float], rate_frd: Sequence[float]) -> None:
        noise = self._row
        if noise[7] < self._settings.dropout:
            return
        if self._gaps_us and any(a <= self._stamp_us < b for a, b in self._gaps_us):
            return
        x, y, z, vx, vy, vz, *q = pose
        p = (x + vx * dt_s, y + vy * dt_s, z + vz * dt_s)
        if self._tilt != (0.0, 0.0):
            p, q = _tilted(p, q, self._tilt)
        if self._faults is not None:
            p, q = self._faults.seen(self._stamp_us, p, q)
        p = (p[0] + noise[0], p[1] + noise[1], p[2] + noise[2])
        roll, pitch, yaw = rate_frd
        turn = (dt_s * roll + noise[3], dt_s * pitch + noise[4], dt_s * yaw + noise[5])
        arrival = self._stamp_us + self._settings.delay_us + int(noise[8] * self._settings.delay_jitter_us)
        if self._in_transit:
            arrival = max(arrival, self._in_transit[-1].arrival_us)
        self._in_transit.append(Pose(self._stamp_us, arrival, p, _turned(q, turn)))

    def _draw(self) -> list[list[float]]:
        """Return rows of position noise 3, attitude noise 3, jitter, two uniform numbers; last row first."""
        s, rng = self._settings, self._rng
        angle = math.radians(s.attitude_noise_deg)
        normal = rng.standard_normal((_BLOCK, 6)) * ([s.position_noise_m] * 3 + [angle] * 3)
        jitter = rng.uniform(-_STAMP_JITTER, _STAMP_JITTER, (_BLOCK, 1))
        return np.hstack([normal, jitter, rng.random((_BLOCK, 2))])[::-1].tolist()


def _turned(q: Sequence[float], turn: Sequence[float]) -> tuple[float, float, float, float]:
    """Return the unit quaternion q, w first, followed by a small rotation vector in the body."""
    w, x, y, z = q
    a, b, c = 0.5 * turn[0], 0.5 * turn[1], 0.5 * turn[2]
    scale = 1.0 / math.sqrt(1.0 + a * a + b * b + c * c)
    return (
        scale * (w - x * a - y * b - z * c),
        scale * (x + w * a + y * c - z * b),
        scale * (y + w * b + z * a - x * c),
        scale * (z + w * c + x * b - y * a),
    )


def _tilted(
    p: Sequence[float], q: Sequence[float], tilt: tuple[float, float]
) -> tuple[tuple[float, float, float], list[float]]:
    """Return position and attitude in a tilted frame: both rotated by the vector (tilt_x, tilt_y, 0)."""
    size = math.hypot(*tilt)
    lean = (tilt[1] * p[0] - tilt[0] * p[1]) / size
    half = 0.5 * size * (1.0 + _BOW_PER_M * lean)
    w, share = math.cos(half), math.sin(half) / size
    x, y = share * tilt[0], share * tilt[1]
    r, a, b, c = q
    turned = [w * r - x * a - y * b, w * a + x * r + y * c, w * b + y * r - x * c, w * c + x * b - y * a]
    twice = (2.0 * y * p[2], -2.0 * x * p[2], 2.0 * (x * p[1] - y * p[0]))
    return (
        (
            p[0] + w * twice[0] + y * twice[2],
            p[1] + w * twice[1] - x * twice[2],
            p[2] + w * twice[2] + x * twice[1] - y * twice[0],
        ),
        turned,
    )
