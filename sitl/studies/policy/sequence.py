"""A random sequence of commands, setpoints, uploads and faults, which its seed alone decides."""

from __future__ import annotations

import math
from collections.abc import Callable
from random import Random

from trimtab.firmware_model.flight.invariants import DESCENT_S
from trimtab.firmware_model.flight.supervisor import FLYING, State
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Kind
from trimtab.protocol.messages import HOST, Station, mavlink
from trimtab.protocol.telemetry import TICK_US
from trimtab.protocol.upload import UploadSender
from trimtab.sitl.studies.policy import draws
from trimtab.sitl.studies.policy.rig import STATIONS, Rig

WORLDS = ("empty", "draughty", "rich")
SETTING_US = 500_000
"""Time from power-up until parameters are set: those of a sequence's vehicle."""
READY_US = 1_200_000
"""Time from power-up until the gyro is calibrated."""
ALIVE_US = 400_000
"""Interval at which a station shows that it is alive."""
ACTION_S = 0.35
"""Mean time between two actions."""
REST_US = 300_000
"""Time on the floor after which a sequence ends."""

Choice = tuple[float, Callable[[], None]]


class Sequence:
    """One sequence: a vehicle, its stations, and their actions until they fall silent."""

    def __init__(self, seed: int) -> None:
        rng = self._rng = Random(f"policy {seed}")
        self.rig = Rig(rng.choice(WORLDS), seed, rng)
        self._link_faults = rng.random() < 0.35
        self._poses = rng.choice(("true", "true", "true", "bad", "bad", "wrong"))
        self._crowd = rng.random() < 0.4
        self._attitudes = rng.choice((0.0, 0.3, 1.0))
        self._end_us = READY_US + round(1e6 * rng.uniform(4.0, 12.0))
        self._stream: draws.Stream | None = None
        self._streamer: Station = HOST
        self._setpoint_us = self._alive_us = self._link_us = self._poses_us = 0
        self._action_us = READY_US

    def run(self) -> None:
        """Fly the sequence: actions, then silence until the vehicle is on the floor."""
        rig, rng = self.rig, self._rng
        while rig.now_us < SETTING_US:
            rig.step()
        for _ in range(rng.choice((0, 3, 10, 30))):
            self._set_parameter()
        while rig.now_us < self._end_us:
            self._advance()
            rig.step()
        rig.link.silent, rig.upload = True, None
        limit_us = rig.now_us + round(1e6 * (rig.flight.parameters["FS_LINK_S"] + DESCENT_S + 1.0))
        rest_us = 0
        while rig.now_us < limit_us and rest_us < REST_US:
            self._end_faults()
            rig.step()
            rest_us = 0 if rig.flight.state in (*FLYING, State.ARMED) else rest_us + TICK_US * 10

    def _advance(self) -> None:
        """Send what is due."""
        rig, now_us = self.rig, self.rig.now_us
        self._end_faults()
        if now_us >= self._alive_us:
            self._alive_us = now_us + ALIVE_US
            for station in STATIONS if self._crowd else STATIONS[:1]:
                rig.send(station, m.Timesync(0, 1000 * now_us))
        if self._stream is not None and now_us >= self._setpoint_us:
            self._setpoint_us = now_us + self._stream.interval_us
            rig.send(self._streamer, self._stream.make())
            if now_us >= self._stream.until_us:
                self._stream = None
        if now_us >= self._action_us:
            self._action_us = now_us + round(1e6 * self._rng.expovariate(1.0 / ACTION_S))
            self._act()

    def _act(self) -> None:
        choices = self._choices()
        weights = [weight for weight, _ in choices]
        self._rng.choices([action for _, action in choices], weights)[0]()

    def _choices(self) -> list[Choice]:
        """Return the actions that a station may take now, with their weights."""
        state = self.rig.flight.state
        always: list[Choice] = [
            (3.0, self._set_parameter),
            (3.0, self._upload),
            (2.0, self._command_at_random),
            (3.0 if self._link_faults else 0.0, self._fail_link),
            (0.0 if self._poses == "true" else 3.0, self._fail_poses),
            (2.0 if self._crowd else 0.0, self._send_foreign_pose),
        ]
        if state in (State.BOOT, State.STANDBY):
            return [*always, (20.0, self._arm), (1.0, self._begin_stream)]
        if state is State.ARMED:
            return [*always, (12.0, self._take_off), (6.0, self._start), (6.0, self._go_offboard)]
        return [
            *always,
            (12.0, self._begin_stream),
            (14.0, self._go_offboard),
            (4.0, lambda: self._mode(4, 3)),
            (2.0, lambda: self._mode(4, 6)),
            (3.0, self._start),
            (3.0, self._swap),
            (0.15, self._kill),
        ]

    # Stations.

    def _station(self) -> Station:
        """Return a station: mostly the first, in a crowd also others."""
        if not self._crowd or self._rng.random() < 0.7:
            return STATIONS[0]
        return self._rng.choice(STATIONS[1:])

    def _command(self, number: int, *parameters: float) -> None:
        values = (*parameters, *(0.0,) * 7)[:7]
        self.rig.send(self._station(), m.CommandLong(1, 1, number, 0, *values))

    def _arm(self) -> None:
        self._command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)

    def _take_off(self) -> None:
        height = self._rng.choice((math.nan, 0.0, self._rng.uniform(0.3, 8.0)))
        self._command(mavlink.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, math.nan, 0.0, 0.0, height)

    def _start(self) -> None:
        self._command(mavlink.MAV_CMD_MISSION_START)

    def _kill(self) -> None:
        if self._rng.random() < 0.5:
            self._command(mavlink.MAV_CMD_DO_FLIGHTTERMINATION, 1.0)
        else:
            self._command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, m.FORCE)

    def _mode(self, main: int, sub: int) -> None:
        flag = float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
        self._command(mavlink.MAV_CMD_DO_SET_MODE, flag, float(main), float(sub))

    def _begin_stream(self) -> None:
        self._stream, self._streamer = self._draw_stream(), self._station()

    def _draw_stream(self) -> draws.Stream:
        return draws.stream(self._rng, self.rig.now_us, self._attitudes)

    def _go_offboard(self) -> None:
        """Stream setpoints, and ask for OFFBOARD behind the first."""
        self._begin_stream()
        assert self._stream is not None
        self._setpoint_us = self.rig.now_us + self._stream.interval_us
        self.rig.send(self._streamer, self._stream.make())
        self._mode(6, 0)

    def _command_at_random(self) -> None:
        """Send a command that mostly does not fit the state, or has odd parameters."""
        rng = self._rng
        number = rng.choice(
            (
                mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
                mavlink.MAV_CMD_NAV_TAKEOFF,
                mavlink.MAV_CMD_NAV_LAND,
                mavlink.MAV_CMD_MISSION_START,
                mavlink.MAV_CMD_DO_SET_MODE,
                mavlink.MAV_CMD_RUN_PREARM_CHECKS,
                mavlink.MAV_CMD_USER_1,
            )
        )
        self._command(number, *(rng.choice((0.0, 1.0, 4.0, 6.0, 129.0, math.nan, 1e9)) for _ in range(7)))

    def _set_parameter(self) -> None:
        flying = self.rig.flight.state is not State.STANDBY
        self.rig.send(self._station(), draws.parameter(self._rng, flying=flying))

    # Uploads.

    def _upload(self) -> None:
        """Upload a reference or a feed-forward: whole, damaged, elsewhere, or cut by the next upload."""
        rng, vehicle_id = self._rng, self.rig.vehicle.id
        kind = Kind.FEEDFORWARD if rng.random() < 0.2 else Kind.REFERENCE
        if kind is Kind.FEEDFORWARD:
            blob = draws.feedforward(rng, vehicle_id).to_bytes()
        else:
            reference = draws.reference(vehicle_id, rng.randrange(200))
            blob = (draws.shifted(reference, rng) if rng.random() < 0.1 else reference).to_bytes()
        if rng.random() < 0.15:
            blob = draws.damaged(rng, blob)
        self.rig.begin_upload(self._station(), UploadSender(blob, kind, commit=rng.random() < 0.8))

    def _swap(self) -> None:
        """Upload a reference that takes over in flight, if one is being tracked."""
        flight, rng = self.rig.flight, self._rng
        if flight.state is not State.TRACKING or flight.reference is None or flight.tracking_us is None:
            return
        at_us = self.rig.now_us + TICK_US * rng.randint(100, 1500)
        along_us = min(at_us - flight.tracking_us, flight.reference.end_us)
        reference = draws.following(rng, self.rig.vehicle.id, flight.reference, along_us)
        if rng.random() < 0.2:
            reference = draws.shifted(reference, rng)
        sender = UploadSender(reference.to_bytes(), Kind.REFERENCE, at_tick=at_us // TICK_US)
        self.rig.begin_upload(self._station(), sender)

    # Faults.

    def _fail_link(self) -> None:
        """Let the link fail for a time."""
        rng, link = self._rng, self.rig.link
        link.repair()
        self._link_us = self.rig.now_us + round(1e6 * rng.choice((0.2, 1.0, 5.0)))
        fault = rng.randrange(4)
        if fault == 0:
            link.silent = True
        elif fault == 1:
            link.loss = rng.random()
        elif fault == 2:
            link.twice = 0.5
        else:
            link.delay_us = rng.randrange(1_000_000)

    def _fail_poses(self) -> None:
        """Let the poses fail for a time."""
        rng, cameras = self._rng, self.rig.cameras
        cameras.repair()
        self._poses_us = self.rig.now_us + round(1e6 * rng.choice((0.1, 0.4, 1.0, 3.0, 60.0)))
        if self._poses == "wrong":
            reach = rng.choice((0.3, 1.0, 5.0))
            x, y, z = (rng.uniform(-reach, reach) for _ in range(3))
            cameras.offset = (x, y, z)
            return
        fault = rng.randrange(5)
        if fault == 0:
            cameras.lost = True
        elif fault == 1:
            cameras.loss = rng.random()
        elif fault == 2:
            cameras.delay_us = TICK_US * rng.randrange(400)
        elif fault == 3:
            cameras.frozen = True
        else:
            cameras.outliers = rng.choice((0.05, 0.5))

    def _send_foreign_pose(self) -> None:
        """Send a wrong pose of a station that does not own the cameras."""
        x, y, z = (self._rng.uniform(-3.0, 3.0) for _ in range(3))
        pose = m.AttPosMocap(self.rig.now_us, [1.0, 0.0, 0.0, 0.0], x, y, z)
        self.rig.send(STATIONS[2], pose)

    def _end_faults(self) -> None:
        if self.rig.now_us >= self._poses_us:
            self.rig.cameras.repair()
            self._poses_us = 1 << 62
        if self.rig.now_us >= self._link_us and not self._is_over():
            self.rig.link.repair()
            self._link_us = 1 << 62

    def _is_over(self) -> bool:
        return self.rig.now_us >= self._end_us
