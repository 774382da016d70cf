"""A simulated vehicle flown by raw MAVLink messages: takeoff, setpoints, landing, through radio and noise."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import pytest

from trimtab.host.link.client import Client
from trimtab.host.vehicle import load_vehicle
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import (
    CAMERAS,
    AttPosMocap,
    CommandAck,
    CommandLong,
    FcStatus,
    Message,
    SetAttitudeTarget,
    SetPositionTarget,
    StatusText,
    mavlink,
)
from trimtab.sitl.vehicle import SimulatedVehicle

ARM, TAKEOFF, SET_MODE, LAND = 400, 22, 176, 21
HOLD, LANDING, STANDBY, OFFBOARD = (
    mavlink.TRIMTAB_STATE_HOLD,
    mavlink.TRIMTAB_STATE_LANDING,
    mavlink.TRIMTAB_STATE_STANDBY,
    mavlink.TRIMTAB_STATE_OFFBOARD,
)
POSITION_AND_YAW = 0b1001_1111_1000
SETPOINT_US = 50_000


class Pilot:
    """The host: forwards poses, streams what `setpoint` gives 20 times a second, asks until obeyed."""

    def __init__(self, simulated: SimulatedVehicle) -> None:
        self.simulated = simulated
        self.client, self.cameras = Client(), Codec(*CAMERAS)
        self.setpoint: Callable[[], Message] | None = None
        self.status: FcStatus | None = None
        self.texts: list[str] = []
        self.states: list[int] = []
        self.acks: list[tuple[int, int]] = []
        self._next_us = 0

    @property
    def state(self) -> int:
        return -1 if self.status is None else self.status.state

    def run(self, seconds: float, until: int | None = None) -> None:
        simulated, client = self.simulated, self.client
        end_us = simulated.now_us + round(1e6 * seconds)
        while simulated.now_us < end_us:
            now_us = simulated.run_until(min(client.next_deadline_us, self._next_us, end_us))
            for message in client.receive(simulated.serial_read(), now_us):
                if isinstance(message, FcStatus):
                    self.status = message
                    if not self.states or self.states[-1] != message.state:
                        self.states.append(message.state)
                elif isinstance(message, StatusText):
                    self.texts.append(message.text)
                elif isinstance(message, CommandAck):
                    self.acks.append((message.command, message.result))
            for datagram in simulated.mocap_read():
                for pose in self.cameras.decode(datagram):
                    assert isinstance(pose, AttPosMocap)
                    client.send(AttPosMocap(pose.time_usec, list(pose.q), pose.x, pose.y, pose.z))
            if now_us >= self._next_us:
                self._next_us = now_us + SETPOINT_US
                if self.setpoint is not None:
                    client.send(self.setpoint())
            client.advance(now_us)
            simulated.serial_write(client.take())
            if until is not None and self.state == until:
                return
        assert until is None, (until, self.states, self.texts)

    def ask(self, command: int, *parameters: float, until: int) -> None:
        for _ in range(10):
            self.client.send(CommandLong(1, 1, command, 0, *(*parameters, *(0.0,) * 7)[:7]))
            self.run(0.3)
            if self.state == until or (command, 0) in self.acks:
                break
        self.run(20.0, until=until)

    def take_off(self, height: float) -> None:
        self.run(1.5)
        self.ask(ARM, 1.0, until=mavlink.TRIMTAB_STATE_ARMED)
        self.ask(TAKEOFF, 0, 0, 0, 0, 0, 0, height, until=HOLD)


def position(x: float, y: float, z: float, yaw: float = 0.0) -> Message:
    return SetPositionTarget(0, 1, 1, 1, POSITION_AND_YAW, x, y, z, 0, 0, 0, 0, 0, 0, yaw, 0)


@pytest.fixture
def pilot() -> Pilot:
    return Pilot(SimulatedVehicle.create(load_vehicle("research"), world="lossy-link", world_seed=41_001))


def test_square_by_setpoints_from_takeoff_to_landing_over_a_lossy_link(pilot: Pilot) -> None:
    pilot.take_off(1.2)
    pilot.setpoint = lambda: position(0.0, 0.0, -1.2)
    pilot.run(0.3)
    pilot.ask(SET_MODE, 129.0, 6.0, until=OFFBOARD)
    for x, y in ((1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0)):
        pilot.setpoint = lambda x=x, y=y: position(x, y, -1.2)
        pilot.run(3.0)
        assert math.dist(pilot.simulated.true_position(), (x, y, -1.2)) < 0.12
        assert pilot.state == OFFBOARD
    pilot.ask(LAND, until=LANDING)
    pilot.run(10.0, until=STANDBY)
    assert pilot.status is not None
    assert pilot.status.failsafe == 0
    assert pilot.states[-5:] == [mavlink.TRIMTAB_STATE_TAKEOFF, HOLD, OFFBOARD, LANDING, STANDBY]


@pytest.mark.parametrize("lean", [0.1, -0.1])
def test_camera_frame_that_leans_as_far_as_a_world_may_say_is_armed_with(tmp_path: Path, lean: float) -> None:
    world = tmp_path / "lean.toml"
    effect = f"[effects.frame-tilt]\ntilt_x = {lean}\ntilt_y = 0.1\n"
    world.write_text(f'description = "leaning cameras"\ntolerances = true\n{effect}')
    pilot = Pilot(SimulatedVehicle.create(load_vehicle("research"), world=str(world), world_seed=41_002))
    pilot.run(1.5)
    pilot.ask(ARM, 1.0, until=mavlink.TRIMTAB_STATE_ARMED)


def test_armed_vehicle_lifts_off_by_setpoints_as_stock_examples_do(pilot: Pilot) -> None:
    pilot.run(1.5)
    pilot.ask(ARM, 1.0, until=mavlink.TRIMTAB_STATE_ARMED)
    pilot.setpoint = lambda: position(0.0, 0.0, 0.0)
    pilot.run(0.3)
    pilot.ask(SET_MODE, 129.0, 6.0, until=OFFBOARD)
    pilot.setpoint = lambda: position(0.0, 0.0, -1.2)
    pilot.run(4.0)
    assert math.dist(pilot.simulated.true_position(), (0.0, 0.0, -1.2)) < 0.12
    pilot.setpoint = lambda: position(0.8, -0.4, -1.0)
    pilot.run(4.0)
    assert math.dist(pilot.simulated.true_position(), (0.8, -0.4, -1.0)) < 0.12
    pilot.ask(LAND, until=LANDING)
    pilot.run(10.0, until=STANDBY)
    assert pilot.status is not None
    assert (pilot.status.failsafe, pilot.status.flight_ticks > 8_000) == (0, True)
    armed = mavlink.TRIMTAB_STATE_ARMED
    assert pilot.states[-5:] == [STANDBY, armed, OFFBOARD, LANDING, STANDBY]


def test_host_that_falls_silent_in_offboard_leaves_a_hold_and_then_a_landing(pilot: Pilot) -> None:
    pilot.take_off(1.0)
    pilot.setpoint = lambda: position(0.5, 0.0, -1.0)
    pilot.run(0.3)
    pilot.ask(SET_MODE, 129.0, 6.0, until=OFFBOARD)
    pilot.run(1.0)
    pilot.setpoint = None
    pilot.run(1.0, until=HOLD)
    pilot.run(11.0, until=LANDING)
    pilot.run(10.0, until=STANDBY)
    assert "setpoints lost: holding, then landing" in pilot.texts
    assert math.dist(pilot.simulated.true_position()[:2], (0.5, 0.0)) < 0.3


def test_body_rates_turn_it_about_its_own_axis(pilot: Pilot) -> None:
    pilot.take_off(1.5)
    vehicle = load_vehicle("research")
    hover = vehicle.mass_kg * 9.81 / (4.0 * vehicle.thrust_max_n)
    pilot.setpoint = lambda: SetAttitudeTarget(0, 1, 1, 128, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 1.0, hover)
    pilot.run(0.3)
    pilot.ask(SET_MODE, 129.0, 6.0, until=OFFBOARD)
    start = pilot.simulated.now_us
    while pilot.simulated.now_us - start < 1_000_000:
        pilot.run(0.05)
    assert pilot.state == OFFBOARD
    assert pilot.simulated._sensed[2] == pytest.approx(1.0, abs=0.1)
    pilot.setpoint = None
    pilot.run(1.0, until=HOLD)
    pilot.run(2.0)
    pilot.ask(LAND, until=LANDING)
    pilot.run(12.0, until=STANDBY)
    assert pilot.status is not None
    assert pilot.status.failsafe == 0
