"""The stream of a controller on the host, driven by messages and times alone."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest

from tests.rate_controller import RateController
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.host.base.errors import UsageError
from trimtab.host.control.interface import ControlStep, RateCommand, SolveStatus
from trimtab.host.link.client import NEVER_US, Client
from trimtab.host.link.control_stream import (
    APPROACH_MAX_US,
    ESTIMATE_AGE_MAX_US,
    HOLD_US,
    LEAD_US,
    RESTING_US,
    ControlStream,
    StepRecord,
)
from trimtab.host.link.host_control import ControlStop, HostControl
from trimtab.host.vehicle import load_vehicle
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Node, Reference
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import Message, mavlink
from trimtab.protocol.telemetry import TICK_US, estimate_message

VEHICLE = load_vehicle("research")
HOVER = Reference(
    vehicle_id=VEHICLE.id,
    origin_ned=(0.0, 0.0, -1.0),
    nodes=(Node(0, (0.0,) * 12), Node(500_000, (0.0,) * 12)),
)
HOLD, OFFBOARD, LANDING = (
    mavlink.TRIMTAB_STATE_HOLD,
    mavlink.TRIMTAB_STATE_OFFBOARD,
    mavlink.TRIMTAB_STATE_LANDING,
)
OFFSET_US = 40_000_000
"""Vehicle clock minus host clock."""
UP_US, DOWN_US = 6_000, 4_000
"""Delays of the link in `Bench`; the clocks are compared as if both were their mean."""


class Bench:
    """A stream between a client and a vehicle that only rests at its setpoint and reports every 10 ms."""

    def __init__(self, controller: Any = None, *, computing_us: int = 10_000) -> None:
        self.controller = controller or RateController(VEHICLE)
        control = HostControl(
            controller=self.controller, name="test", settings_id="0" * 12, computing_us=computing_us
        )
        self.client = Client()
        self.records: list[tuple[StepRecord, int]] = []
        self.begun: list[tuple[int, int]] = []
        self.stream = ControlStream(
            control,
            HOVER,
            mass_kg=VEHICLE.mass_kg,
            thrust_max_n=VEHICLE.thrust_max_n,
            on_begin=lambda start_us, now_us: self.begun.append((start_us, now_us)),
            on_step=lambda record, now_us: self.records.append((record, now_us)),
        )
        self.now_us = 0
        self.sent: list[tuple[int, Message]] = []
        self.state = mavlink.TRIMTAB_STATE_TAKEOFF
        self.estimates = True
        self.p_ned = (0.0, 0.0, -1.0)
        for k in range(20):
            sent_us = 1000 * k - 1_000_000
            self.client.clock.answer(sent_us, sent_us + UP_US + OFFSET_US, sent_us + UP_US + DOWN_US)
        self.codec = Codec(*m.VEHICLE)

    def run(self, seconds: float) -> None:
        """Advance in ticks, as in lock-step."""
        end_us = self.now_us + round(1e6 * seconds)
        while self.now_us < end_us:
            self.now_us += TICK_US
            if self.estimates and self.now_us % 10_000 == 0:
                tick = (self.now_us + OFFSET_US - DOWN_US) // TICK_US
                still = (0.0, 0.0, 0.0)
                self.stream.receive(
                    self.client,
                    estimate_message(
                        tick,
                        p_ned=self.p_ned,
                        v_ned=still,
                        q_ned_frd=(1.0, 0.0, 0.0, 0.0),
                        rate_frd=still,
                        mocap_age_us=0,
                        gyro_bias_frd=still,
                    ),
                    self.now_us,
                )
            if self.now_us >= self.stream.deadline_us:
                self.stream.advance(self.client, self.now_us)
            self.sent += [(self.now_us, message) for message in self.codec.decode(self.client.take())]

    def report(self, state: int) -> None:
        """Report a state of the vehicle."""
        self.state = state
        fields: dict[str, Any] = {name: [0] * 6 if "_id" in name else 0 for name in m.FcStatus.fieldnames}
        self.stream.status(self.client, m.FcStatus(**{**fields, "state": state}), self.now_us)

    def stream_now(self) -> None:
        """Get the vehicle to rest at the first node, offboard, and the controller to its first step."""
        self.report(HOLD)
        self.run(0.2)
        self.report(OFFBOARD)
        self.run(1e-6 * RESTING_US + 0.02)
        assert self.begun

    def of(self, kind: type[Message]) -> list[tuple[int, Any]]:
        return [(now_us, message) for now_us, message in self.sent if isinstance(message, kind)]


def test_setpoints_come_before_the_mode_and_end_when_the_controller_takes_over() -> None:
    bench = Bench()
    bench.run(1.0)
    assert not bench.sent  # the vehicle is still climbing
    bench.stream_now()
    positions, modes = bench.of(m.SetPositionTarget), bench.of(m.CommandLong)
    assert (positions[0][1].x, positions[0][1].y, positions[0][1].z) == (0.0, 0.0, -1.0)
    assert modes[0][1].command == mavlink.MAV_CMD_DO_SET_MODE
    assert positions[0][0] < modes[0][0]
    bench.run(0.5)
    assert bench.of(m.SetPositionTarget)[-1][0] <= bench.begun[0][1]


def test_controller_waits_until_the_vehicle_rests_at_the_first_node() -> None:
    bench = Bench()
    bench.p_ned = (0.3, 0.0, -1.0)
    bench.report(HOLD)
    bench.run(0.2)
    bench.report(OFFBOARD)
    bench.run(3.0)
    assert not bench.begun
    bench.p_ned = (0.0, 0.0, -1.0)
    bench.run(1e-6 * RESTING_US + 0.02)
    assert bench.begun


def test_vehicle_that_never_rests_is_landed() -> None:
    bench = Bench()
    bench.p_ned = (0.3, 0.0, -1.0)
    bench.report(HOLD)
    bench.run(0.1)
    bench.report(OFFBOARD)
    bench.run(1e-6 * APPROACH_MAX_US)
    assert bench.stream.stop is ControlStop.START_MISSED
    assert bench.of(m.CommandLong)[-1][1].command == mavlink.MAV_CMD_NAV_LAND
    assert bench.stream.deadline_us == NEVER_US


def test_vehicle_that_lands_on_the_way_gets_no_more_setpoints() -> None:
    bench = Bench()
    bench.report(HOLD)
    bench.run(0.2)
    bench.report(LANDING)
    sent = len(bench.sent)
    bench.run(1.0)
    assert len(bench.sent) == sent
    assert bench.stream.stop is ControlStop.START_MISSED


@pytest.mark.parametrize("computing_us", [0, 3_000, 10_000, 25_000])
def test_command_is_sent_when_the_computing_time_has_passed(computing_us: int) -> None:
    bench = Bench(computing_us=computing_us)
    bench.stream_now()
    bench.run(0.5)
    (start_us, _), sent = bench.begun[0], bench.of(m.SetAttitudeTarget)
    assert start_us % TICK_US == 0
    steps = [record.t_us + start_us - OFFSET_US for record, _ in bench.records]
    assert len(steps) > 15
    # The clocks are compared with half the difference of the two delays as their error.
    error_us = (UP_US - DOWN_US) // 2
    assert [now_us - computing_us + error_us for now_us, _ in sent] == steps[: len(sent)]
    assert {b - a for (a, _), (b, _) in pairwise(sent)} == {25_000}
    for record, now_us in bench.records:
        assert record.act_us == record.t_us + computing_us + (UP_US + DOWN_US) // 2
        assert now_us + OFFSET_US - start_us + error_us == record.t_us + computing_us
        assert record.late_us == 0


def test_controller_gets_the_commands_since_its_estimate_and_the_one_in_effect_then() -> None:
    bench = Bench(computing_us=25_000)
    bench.stream_now()
    bench.run(1.0)
    calls, acted = bench.controller.calls, [record.act_us for record, _ in bench.records]
    first_estimate, first_sent, _ = calls[0]
    assert first_sent == (RateCommand(first_estimate.t_us, (0.0, 0.0, 0.0), VEHICLE.mass_kg * GRAVITY),)
    assert max(len(sent) for _, sent, _ in calls) == 2
    for k, (estimate, sent, act_us) in enumerate(calls[3:], start=3):
        times = [command.t_us for command in sent]
        before = max(t_us for t_us in acted[:k] if t_us <= estimate.t_us)
        assert times == [before, *(t_us for t_us in acted[:k] if t_us > estimate.t_us)]
        assert act_us > times[-1]


def test_estimate_that_is_overtaken_is_left_out() -> None:
    bench = Bench()
    bench.stream_now()
    newest = bench.controller.calls[-1][0].t_us
    old = estimate_message(
        5, p_ned=(9.0, 9.0, 9.0), v_ned=(0.0,) * 3, q_ned_frd=(1.0, 0.0, 0.0, 0.0), rate_frd=(0.0,) * 3,
        mocap_age_us=0, gyro_bias_frd=(0.0,) * 3,
    )  # fmt: skip
    bench.stream.receive(bench.client, old, bench.now_us)
    bench.run(0.05)
    assert bench.controller.calls[-1][0].t_us > newest
    assert bench.controller.calls[-1][0].p_ned == (0.0, 0.0, -1.0)


def test_command_of_a_solver_that_takes_too_long_is_sent_late_and_acts_late() -> None:
    bench = Bench()
    bench.stream_now()
    while len(bench.of(m.SetAttitudeTarget)) < 3:
        bench.run(0.001)
    while len(bench.controller.calls) < 4:
        bench.run(0.001)
    bench.now_us += 13_000  # 3 ms longer than declared
    bench.run(0.1)
    late = [record.late_us for record, _ in bench.records]
    assert late[:3] == [0, 0, 0]
    assert late[3] == 4_000
    assert set(late[4:]) == {0}
    sent = bench.controller.calls[4][1]
    assert sent[-1].t_us == bench.records[3][0].act_us + 4_000


def test_steps_that_a_stalled_host_missed_are_left_out() -> None:
    bench = Bench()
    bench.stream_now()
    bench.run(0.2)
    count, t_us = len(bench.controller.calls), bench.records[-1][0].t_us
    bench.now_us += 100_000
    bench.run(0.05)
    assert len(bench.controller.calls) - count <= 3
    assert (bench.records[-1][0].t_us - t_us) % 25_000 < 10_000


def test_lost_estimates_are_predicted_over_and_then_end_the_stream() -> None:
    bench = Bench()
    bench.stream_now()
    bench.run(0.2)
    bench.estimates = False
    bench.run(0.24)
    assert bench.stream.stop is None
    assert 200_000 < bench.records[-1][0].estimate_age_us <= ESTIMATE_AGE_MAX_US
    bench.run(0.1)
    assert bench.stream.stop is ControlStop.ESTIMATES_LOST
    sent = len(bench.sent)
    bench.run(1.0)
    assert len(bench.sent) == sent


def test_controller_without_a_command_ends_the_stream_and_is_logged() -> None:
    def outcome(t_us: int) -> tuple[SolveStatus, bool]:
        return (SolveStatus.SOLVED, True) if t_us < -500_000 else (SolveStatus.INFEASIBLE, False)

    bench = Bench(RateController(VEHICLE, outcome=outcome))
    bench.stream_now()
    bench.run(1.0)
    assert bench.stream.stop is ControlStop.NO_COMMAND
    assert not bench.stream.finished
    last = bench.records[-1][0].step
    assert (last.command, last.status) == (None, SolveStatus.INFEASIBLE)
    assert len(bench.of(m.SetAttitudeTarget)) == len(bench.records) - 1
    assert bench.stream.deadline_us == NEVER_US


def test_vehicle_that_leaves_offboard_ends_the_stream() -> None:
    bench = Bench()
    bench.stream_now()
    bench.run(0.2)
    bench.report(mavlink.TRIMTAB_STATE_FAILSAFE)
    assert bench.stream.stop is ControlStop.LEFT_OFFBOARD
    sent = len(bench.sent)
    bench.run(0.5)
    assert len(bench.sent) == sent


def test_end_of_the_reference_and_its_hold_command_the_landing_until_it_begins() -> None:
    bench = Bench()
    bench.stream_now()
    bench.run(1e-6 * (LEAD_US + HOVER.duration_us + HOLD_US) + 1.0)
    lands = [now_us for now_us, each in bench.of(m.CommandLong) if each.command == mavlink.MAV_CMD_NAV_LAND]
    assert len(lands) >= 3
    end_us = bench.begun[0][0] + HOVER.duration_us + HOLD_US - OFFSET_US
    assert abs(lands[0] - end_us) <= 25_000  # the stream looks at the time at each step
    assert bench.stream.finished
    # Commands go on: the vehicle is to hover until it lands.
    assert bench.of(m.SetAttitudeTarget)[-1][0] > lands[-1] - 300_000
    bench.report(LANDING)
    sent = len(bench.sent)
    bench.run(1.0)
    assert len(bench.sent) == sent
    assert bench.stream.stop is None


def test_controller_without_a_command_after_the_reference_still_lands() -> None:
    def outcome(t_us: int) -> tuple[SolveStatus, bool]:
        return SolveStatus.SOLVED, t_us < HOVER.duration_us + HOLD_US + 50_000

    bench = Bench(RateController(VEHICLE, outcome=outcome))
    bench.stream_now()
    bench.run(1e-6 * (LEAD_US + HOVER.duration_us + HOLD_US) + 1.0)
    lands = [each for _, each in bench.of(m.CommandLong) if each.command == mavlink.MAV_CMD_NAV_LAND]
    assert len(lands) >= 3
    assert bench.stream.finished


def test_collective_thrust_is_a_share_of_all_rotors() -> None:
    bench = Bench()
    bench.stream_now()
    bench.run(0.1)
    record, target = bench.records[0][0], bench.of(m.SetAttitudeTarget)[0][1]
    assert record.step.command is not None
    assert target.thrust * 4.0 * VEHICLE.thrust_max_n == pytest.approx(record.step.command.collective_n)
    assert target.type_mask == mavlink.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE
    rates = (target.body_roll_rate, target.body_pitch_rate, target.body_yaw_rate)
    assert rates == pytest.approx(record.step.command.rate_frd)


def test_command_that_is_not_finite_raises(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench()
    command = RateCommand(0, (0.0, float("nan"), 0.0), 7.0)
    step: Callable[..., ControlStep] = lambda *_: ControlStep(  # noqa: E731
        command=command, status=SolveStatus.SOLVED, iterations=1
    )
    monkeypatch.setattr(bench.controller, "step", step)
    with pytest.raises(ValueError, match="not finite"):
        bench.stream_now()


@pytest.mark.parametrize("computing_us", [-1, 25_001])
def test_computing_time_beyond_the_period_is_refused(computing_us: int) -> None:
    with pytest.raises(UsageError, match="not within the period"):
        HostControl(
            controller=RateController(VEHICLE), name="slow", settings_id="0" * 12, computing_us=computing_us
        )
