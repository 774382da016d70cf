"""A flood of packets at a vehicle's port, in lock-step, through the port's fair share."""

from __future__ import annotations

from collections.abc import Sequence
from random import Random
from typing import Protocol

from trimtab.host.link.vehicle import Vehicle
from trimtab.protocol import messages as m
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import Message, mavlink
from trimtab.protocol.telemetry import TICK_US
from trimtab.sitl.fair_share import FairShare
from trimtab.sitl.studies.attack.stranger import ADDRESS, Wrapper

STEP_US = 2 * TICK_US
"""Interval at which the port of a served vehicle lets data in."""
_KINDS = 6


def flood_frames(count: int, seed: int) -> list[bytes]:
    """Return valid frames of one stranger: commands, poses, heartbeats, questions, setpoints, parameters."""
    codec, rng = Codec(*ADDRESS), Random(seed)
    return [codec.encode(_message(rng, index)) for index in range(count)]


def _message(rng: Random, index: int) -> Message:
    kind = index % _KINDS
    if kind == 0:
        return m.CommandLong(*m.VEHICLE, mavlink.MAV_CMD_DO_SET_MODE, 0, 1.0, 4.0, 3.0, 0.0, 0.0, 0.0, 0.0)
    if kind == 1:
        x, y, z = (rng.uniform(-2.0, 2.0) for _ in range(3))
        return m.AttPosMocap(rng.randrange(20_000_000), (1.0, 0.0, 0.0, 0.0), x, y, z)
    if kind == 2:
        return m.Heartbeat(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0, 3)
    if kind == 3:
        return m.Timesync(0, rng.randrange(1 << 40))
    if kind == 4:
        return m.SetAttitudeTarget(0, *m.VEHICLE, 0, (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, rng.random())
    return m.ParamRequestList(*m.VEHICLE)


class Served(Vehicle, Protocol):
    """A vehicle whose serial line can be served through a fair share, as in `sitl.serve`."""

    def serial_room(self) -> int: ...


class FloodedVehicle(Wrapper):
    """A vehicle whose port a host shares with a flood of `rate_hz` frames.

    `sent`: number of frames of the flood.
    """

    def __init__(self, vehicle: Served, frames: Sequence[bytes], rate_hz: int) -> None:
        super().__init__(vehicle)
        self.sent = 0
        self._served = vehicle
        self._frames = frames
        self._rate_hz = rate_hz
        self._share = FairShare()
        self._step_us = 0

    def run_until(self, t_us: int) -> int:
        """Run until `t_us`, until bytes wait for the host, or until the port's next step."""
        vehicle = self._served
        if vehicle.now_us >= self._step_us:
            self._let_in(vehicle.now_us)
        self.now_us = vehicle.run_until(min(t_us, self._step_us))
        return self.now_us

    def serial_write(self, data: bytes) -> None:
        """Queue bytes of the host; the port lets them in at its next step."""
        self._share.offer("host", data, self.now_us)

    def _let_in(self, now_us: int) -> None:
        self._step_us = now_us + STEP_US
        while self.sent < now_us * self._rate_hz // 1_000_000:
            self._share.offer("flood", self._frames[self.sent % len(self._frames)], now_us)
            self.sent += 1
        data = self._share.take(self._served.serial_room(), now_us)
        if data:
            self._served.serial_write(data)
