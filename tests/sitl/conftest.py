"""A small host for the simulator's own tests: it forwards poses, keeps the link alive, arms and starts."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest

from trimtab.host.apps.bench.session_parts import figure_eight
from trimtab.host.link.client import Client
from trimtab.host.link.keys import StationKey
from trimtab.protocol.blobs import Kind, Reference
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import CAMERAS, AttPosMocap, CommandLong, FcStatus, Message, mavlink
from trimtab.sitl.vehicle import SimulatedVehicle

STANDBY, TRACKING, FAILSAFE = 1, 4, 7
RETRY_US = 300_000


@dataclass
class Session:
    """What a flight left behind: bytes in both directions, messages, true positions while tracking."""

    received: bytearray = field(default_factory=bytearray)
    messages: list[Message] = field(default_factory=list)
    states: list[int] = field(default_factory=list)
    tracked_us: list[int] = field(default_factory=list)
    tracked_ned: list[tuple[float, float, float]] = field(default_factory=list)
    armed: bool = False
    end_us: int = 0


def put_on_board(vehicle: SimulatedVehicle, reference: Reference, flight: int = 0) -> None:
    """Puts a reference into the vehicle's memory and powers it up anew."""
    vehicle.store.stage(Kind.REFERENCE, reference.to_bytes())
    vehicle.store.commit(Kind.REFERENCE)
    vehicle.power_cycle(flight)


def fly(vehicle: SimulatedVehicle, *, until_s: float = 60.0, key: StationKey | None = None) -> Session:
    """A whole flight: arm, start, until the vehicle is in standby again, or `until_s`."""
    session, client, cameras = Session(), Client(key), Codec(*CAMERAS)
    state, asked_us, asked = 0, 0, False
    while vehicle.now_us < until_s * 1e6:
        now_us = vehicle.run_until(min(client.next_deadline_us, vehicle.now_us + 100_000))
        client.set_time(now_us)
        data = vehicle.serial_read()
        session.received += data
        for message in client.receive(data, now_us):
            session.messages.append(message)
            if isinstance(message, FcStatus):
                state = message.state
                if not session.states or session.states[-1] != state:
                    session.states.append(state)
        for datagram in vehicle.mocap_read():
            for pose in cameras.decode(datagram):
                assert isinstance(pose, AttPosMocap)
                client.send(AttPosMocap(pose.time_usec, list(pose.q), pose.x, pose.y, pose.z))
        if now_us > 1_500_000 and now_us >= asked_us and state in (1, 2) and not asked:
            asked_us = now_us + RETRY_US
            command = mavlink.MAV_CMD_COMPONENT_ARM_DISARM if state == 1 else mavlink.MAV_CMD_MISSION_START
            client.send(CommandLong(1, 1, command, 0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        asked = asked or state > 2
        if state == TRACKING:
            session.tracked_us.append(now_us)
            session.tracked_ned.append(vehicle.true_position())
        if asked and state in (STANDBY, FAILSAFE):
            break
        client.advance(now_us)
        vehicle.serial_write(client.take())
    session.armed = asked
    session.end_us = vehicle.now_us
    return session


@pytest.fixture(scope="session")
def session_tools():
    """figure_eight, put_on_board and fly, for tests in this folder."""
    return figure_eight, put_on_board, fly
