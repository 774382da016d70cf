"""A crashed simulated vehicle: rebooted by any ground station, it stands at its start and flies again."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.fly import fly_lockstep
from trimtab.host.link.poses import forward_session
from trimtab.host.vehicle import Vehicle
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Kind, Reference
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import mavlink
from trimtab.protocol.telemetry import TICK_US

ARM, TAKEOFF = mavlink.MAV_CMD_COMPONENT_ARM_DISARM, mavlink.MAV_CMD_NAV_TAKEOFF
REBOOT, SET_MODE = mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, mavlink.MAV_CMD_DO_SET_MODE
START = (0.4, -0.2, 0.0)
FORCE = 21196.0
"""Parameter 2 of a disarming that is forced."""
ROLL_STEPS = 2


class Station:
    """A ground station beside `trimtab poses`, on one port of the vehicle."""

    def __init__(self, vehicle: Any) -> None:
        self.vehicle = vehicle
        self.codec = Codec(255, 190)
        self.poses = forward_session("here", 4000, ready=lambda: None, look=lambda session: None)
        self.state = -1
        self.texts: list[str] = []
        self.acks: list[tuple[int, int]] = []

    def send(self, message: m.Message) -> None:
        self.vehicle.serial_write(self.codec.encode(message))

    def run(self, seconds: float, *, until: int | None = None) -> None:
        """Run until the vehicle is in state `until`, or for `seconds` without one."""
        vehicle, now_us = self.vehicle, self.vehicle.now_us
        end_us = now_us + round(1e6 * seconds)
        while now_us < end_us:
            data = vehicle.serial_read()
            vehicle.serial_write(self.poses.step(now_us, data, vehicle.mocap_read()))
            for message in self.codec.decode(data):
                if isinstance(message, m.FcStatus):
                    self.state = message.state
                elif isinstance(message, m.StatusText):
                    self.texts.append(message.text)
                elif isinstance(message, m.CommandAck):
                    self.acks.append((message.command, message.result))
            if self.state == until:
                return
            now_us = vehicle.run_until(min(max(self.poses.next_deadline_us, now_us + TICK_US), end_us))
        assert until is None, (until, self.state, self.texts)

    def result_of(self, number: int, *parameters: float) -> int:
        """What the vehicle answers to a command, which is sent again until it does."""
        self.acks.clear()
        for _ in range(10):
            self.send(m.CommandLong(1, 1, number, 0, *(*parameters, *(0.0,) * 7)[:7]))
            self.run(0.4)
            if self.acks:
                return self.acks[-1][1]
        raise AssertionError(f"no answer to {number}: {self.texts}")

    def crash(self) -> None:
        """Take off, roll and stop the motors in the air, so that the vehicle falls on its back."""
        self.run(2.0)
        assert self.result_of(ARM, 1.0) == mavlink.MAV_RESULT_ACCEPTED
        assert self.result_of(TAKEOFF, *(0.0,) * 6, 1.5) == mavlink.MAV_RESULT_ACCEPTED
        self.run(20.0, until=mavlink.TRIMTAB_STATE_HOLD)
        self.roll()
        self.send(m.CommandLong(1, 1, SET_MODE, 0, 129.0, 6.0, *(0.0,) * 5))
        for _ in range(ROLL_STEPS):
            self.roll()
            self.run(0.05)
        assert self.result_of(ARM, 0.0, FORCE) == mavlink.MAV_RESULT_ACCEPTED
        self.run(3.0)

    def roll(self) -> None:
        self.send(m.SetAttitudeTarget(0, 1, 1, 128, [1.0, 0.0, 0.0, 0.0], 15.0, 0.0, 0.0, 0.3))


@pytest.fixture
def crashed(simulate: Callable[..., Any], reference: Reference) -> Station:
    """A vehicle on its back, with a reference on board, and its ground station."""
    vehicle = simulate(start_ned=START)
    vehicle.store.stage(Kind.REFERENCE, reference.to_bytes())
    vehicle.store.commit(Kind.REFERENCE)
    vehicle.power_cycle(0)
    station = Station(vehicle)
    station.crash()
    return station


def test_crashed_vehicle_refuses_to_arm_until_it_is_rebooted_and_flies_again(crashed: Station) -> None:
    assert math.dist(crashed.vehicle.true_position(), START) > 0.1
    assert crashed.result_of(ARM, 1.0) == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    assert crashed.texts[-1] == "arm refused: tilted"
    before_us = crashed.vehicle.now_us
    assert crashed.result_of(REBOOT, 1.0) == mavlink.MAV_RESULT_ACCEPTED
    crashed.run(2.0)
    assert crashed.vehicle.now_us >= before_us + 2_000_000
    assert math.dist(crashed.vehicle.true_position(), START) < 0.01
    # The poses are still forwarded by the same session, although the vehicle's clock began anew.
    assert crashed.result_of(ARM, 1.0) == mavlink.MAV_RESULT_ACCEPTED
    assert crashed.result_of(TAKEOFF, *(0.0,) * 6, 1.0) == mavlink.MAV_RESULT_ACCEPTED
    crashed.run(20.0, until=mavlink.TRIMTAB_STATE_HOLD)
    x, y, z = crashed.vehicle.true_position()
    assert math.dist((x, y, z), (START[0], START[1], -1.0)) < 0.1


def test_rebooted_vehicle_flies_the_reference_that_it_kept(
    crashed: Station, vehicle: Vehicle, reference: Reference, tmp_path: Path
) -> None:
    assert crashed.result_of(REBOOT, 1.0) == mavlink.MAV_RESULT_ACCEPTED
    crashed.run(2.0)
    request = FlightRequest(
        vehicle=vehicle, reference=reference, log_path=tmp_path / "again.mcap", upload=False
    )
    result = fly_lockstep(request, crashed.vehicle)
    assert result.end is not None
    assert result.end.whole
    assert result.tracking_rmse_m is not None
    assert result.tracking_rmse_m < 0.05
