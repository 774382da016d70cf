"""Whole flights by a controller on the host: what is flown, when commands act, and what the log says."""

from __future__ import annotations

import dataclasses
import os
import signal
from collections.abc import Callable
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.rate_controller import RateController
from trimtab.firmware_model.flight.flight import Flight as Firmware
from trimtab.firmware_model.flight.setpoints import AttitudeTarget, Target
from trimtab.host.base.errors import UsageError
from trimtab.host.base.parts import part_path
from trimtab.host.control.interface import SolveStatus
from trimtab.host.link.control_stream import HOLD_US, LEAD_US
from trimtab.host.link.drivers import run_lockstep
from trimtab.host.link.flight import FlightDirector
from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.fly import FlightEnded
from trimtab.host.link.host_control import HostControl
from trimtab.host.link.summary import FlightResult
from trimtab.host.log import Flight, read_flight, recover, topics
from trimtab.host.log.export import csv_tables
from trimtab.host.log.scan import scan
from trimtab.host.log.tracking import reference_at, tracking_error
from trimtab.host.trace.data.audit import audit
from trimtab.host.trace.data.logs import drive_of, repeat_flights_of
from trimtab.host.trace.data.signals import FlightData
from trimtab.host.trace.decision.findings import Code
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import Reference
from trimtab.protocol.generated import flight_pb2

Fly = Callable[..., FlightResult]
Simulate = Callable[..., Any]
HOLD, LANDING, OFFBOARD = 5, 6, 8


def by_host(vehicle: Vehicle, controller: RateController | None = None, **settings: Any) -> HostControl:
    """A control by the test's controller."""
    controller = controller or RateController(vehicle)
    return HostControl(controller=controller, name="outer-loop", settings_id="0123456789ab", **settings)


@pytest.fixture(scope="module")
def steered(
    vehicle: Vehicle, reference: Reference, tmp_path_factory: pytest.TempPathFactory
) -> tuple[FlightResult, Flight]:
    """One flight in the empty world, for all tests that only look at what it left."""
    from trimtab.host.link.fly import fly_lockstep
    from trimtab.host.link.vehicle import vehicle_class

    log = tmp_path_factory.mktemp("steered") / "flight.mcap"
    order = FlightRequest(vehicle=vehicle, reference=reference, log_path=log, control=by_host(vehicle))
    result = fly_lockstep(order, vehicle_class().create(vehicle))
    return result, read_flight(log)


def test_controller_flies_the_reference_over_the_radio(
    steered: tuple[FlightResult, Flight], reference: Reference
) -> None:
    result, flight = steered
    assert result.end is not None
    assert result.end.whole
    assert flight.status is not None
    order = list(dict.fromkeys(flight.status.state.tolist()))
    assert order[-5:] == [3, HOLD, OFFBOARD, LANDING, 1]  # takeoff, hold, offboard, landing, standby
    assert flight.tracking is not None
    assert flight.tracking[1] - flight.tracking[0] == reference.duration_us
    assert flight.tracking_whole
    error = tracking_error(flight)
    assert error is not None
    assert error.rmse_m == result.tracking_rmse_m
    assert error.rmse_m < 0.05
    assert error.poses == pytest.approx(reference.duration_us * 1e-4, abs=6)


def test_log_holds_every_step_of_the_controller(
    steered: tuple[FlightResult, Flight], reference: Reference
) -> None:
    result, flight = steered
    steps = flight.host_control
    assert steps is not None
    assert (steps.controller, steps.settings_id) == ("outer-loop", "0123456789ab")
    assert (steps.period_us, steps.computing_us) == (25_000, 10_000)
    assert len(steps) == pytest.approx((LEAD_US + reference.duration_us + HOLD_US) / 25_000, abs=3)
    assert flight.tracking is not None
    assert steps.start_us == flight.tracking[0]
    assert abs(steps.t_us[0] - steps.start_us + LEAD_US) <= 2_000
    np.testing.assert_allclose(np.diff(steps.t_us), 25_000, atol=500)
    assert steps.commanded.all()
    assert not steps.late_us.any()
    # Ten milliseconds of computing, and the uplink's delay as the clocks' exchange gives it.
    ahead_us = steps.act_us - steps.t_us - steps.computing_us
    assert 7_000 < ahead_us.min() <= ahead_us.max() < 11_000
    answer = result.to_dict()["control"]
    assert answer["steps"] == answer["solved"] == answer["sent"] == len(steps)
    assert (answer["late"], answer["budget_spent"], answer["infeasible"]) == (0, 0, 0)
    assert answer["stopped"] is None
    assert read_flight(result.log).to_dict()["control"] | {"stopped": None} == answer
    assert any(line.startswith("controller outer-loop (0123456789ab): ") for line in result.to_lines())
    rows, table = csv_tables(result.log)["host-control.csv"]
    assert rows == len(steps)
    assert "rate_cmd_rad_s_2" in table.partition("\n")[0]


def test_reference_in_the_log_starts_with_the_host_s_start(
    steered: tuple[FlightResult, Flight], reference: Reference
) -> None:
    result, flight = steered
    entries = scan(result.log).by_topic()[topics.REFERENCE]
    messages = [flight_pb2.Reference.FromString(entry.data) for entry in entries]
    t_us = np.array([message.reference_us for message in messages])
    assert len(messages) >= 0.97 * (reference.duration_us + HOLD_US) * 1e-4
    assert t_us[0] < 50_000
    np.testing.assert_allclose(
        [list(message.p_ned_m) for message in messages], reference_at(reference, t_us)[:, :3], atol=1e-12
    )
    assert flight.tracking is not None
    inside = t_us < reference.duration_us
    published = np.array([entry.publish_time_us for entry in entries])
    np.testing.assert_allclose(published[inside] - t_us[inside], flight.tracking[0], atol=500)


def test_telemetry_has_the_commands_of_the_host_within_the_vehicle_s_limits(
    steered: tuple[FlightResult, Flight],
) -> None:
    flight = steered[1]
    steps, control = flight.host_control, flight.control
    assert steps is not None
    assert control is not None
    assert flight.tracking is not None
    inside = (control.t1_us > flight.tracking[0]) & (control.t1_us < flight.tracking[1])
    assert flight.firmware_parameters is not None
    limit = np.array([flight.firmware_parameters[f"LIM_RATE_{axis}"] for axis in "XYZ"])
    bounded = np.clip(steps.rate_cmd, -limit, limit)
    assert (bounded != steps.rate_cmd).any()
    known = steps.collective[:, None], *bounded.T[:, :, None]
    sampled = control.collective[inside], *control.rate_cmd[inside].T
    for sent, telemetry in zip(known, sampled, strict=True):
        assert np.abs(sent - telemetry).min(axis=0).max() < 1e-5


@pytest.mark.parametrize("world", ["empty", "wired"])
@pytest.mark.parametrize("computing_us", [0, 10_000])
def test_command_never_acts_before_the_computing_time_has_passed(
    fly: Fly,
    simulate: Simulate,
    vehicle: Vehicle,
    monkeypatch: pytest.MonkeyPatch,
    world: str,
    computing_us: int,
) -> None:
    received: dict[Any, int] = {}
    take = Firmware.setpoint

    def setpoint(firmware: Firmware, target: Target, now_us: int) -> None:
        if isinstance(target, AttitudeTarget):
            received.setdefault(target.rate[0], now_us)
        take(firmware, target, now_us)

    monkeypatch.setattr(Firmware, "setpoint", setpoint)
    controller = RateController(vehicle)
    result = fly(simulate(world=world), control=by_host(vehicle, controller, computing_us=computing_us))
    flight = read_flight(result.log)
    steps = flight.host_control
    assert steps is not None
    arm_us = int(flight.metadata["arm_host_us"])
    first = steps.rate_cmd[:, 0].astype(np.float32).tolist()
    step_us, act_us = steps.t_us + arm_us, steps.act_us + arm_us
    arrived = np.array([received.get(rate, -1) for rate in first])
    known = arrived >= 0
    assert known.mean() > 0.95
    delay_us = (arrived - step_us)[known] - computing_us
    assert delay_us.min() >= 1_000 - 500  # the clocks' comparison is exact to half a millisecond
    # The controller is told the time of its effect to a few ticks.
    assert np.abs(np.median((arrived - act_us)[known])) <= 1_500
    if world == "wired":
        assert np.percentile(delay_us, 99) <= 1_500


def test_law_uses_a_command_in_the_tick_in_which_it_arrives(
    fly: Fly, simulate: Simulate, vehicle: Vehicle, monkeypatch: pytest.MonkeyPatch
) -> None:
    take, tick = Firmware.setpoint, Firmware.tick
    newest: list[tuple[int, AttitudeTarget]] = []
    checked: list[int] = []

    def setpoint(firmware: Firmware, target: Target, now_us: int) -> None:
        if isinstance(target, AttitudeTarget):
            newest[:] = [(now_us, target)]
        take(firmware, target, now_us)

    def ticked(firmware: Firmware, now_us: int, *samples: Any) -> None:
        tick(firmware, now_us, *samples)
        if newest and newest[0][0] == now_us and firmware.state == OFFBOARD:
            target = newest[0][1]
            if max(map(abs, target.rate)) < 3.0:  # within every limit of the vehicle
                checked.append(now_us)
                assert firmware.outputs["rate_cmd"].tolist() == list(target.rate)
                collective_n = 4.0 * firmware.parameters["THRUST_MAX"] * target.thrust
                assert firmware.outputs["collective_n"][0] == collective_n

    monkeypatch.setattr(Firmware, "setpoint", setpoint)
    monkeypatch.setattr(Firmware, "tick", ticked)
    fly(simulate(world="wired"), control=by_host(vehicle))
    assert len(checked) > 250


def test_wired_host_has_no_radio_and_hardly_any_delay(fly: Fly, simulate: Simulate, vehicle: Vehicle) -> None:
    simulated = simulate(world="wired")
    result = fly(simulated, control=by_host(vehicle, computing_us=0))
    assert result.end is not None
    assert result.end.whole
    assert all(count == 0 for counts in simulated.radio_counts().values() for count in counts.values())
    link = result.link
    assert (link["up_sent"], link["messages_lost"], link["poses_lost"]) == (None, 0, 0)
    assert link["rtt_ms"] <= 3.0
    assert link["mocap_age_ms_p50"] <= 11.0  # at 100 Hz a pose is used for 10 ms
    flight = read_flight(result.log)
    assert flight.mocap is not None
    assert (flight.mocap.t_arrival_us - flight.mocap.t_us).max() <= 1_000
    assert result.tracking_rmse_m is not None
    assert result.tracking_rmse_m < 0.03


@pytest.mark.parametrize("world", ["lossy-link", "wired"])
def test_flight_by_a_controller_is_reproducible(
    fly: Fly, simulate: Simulate, vehicle: Vehicle, tmp_path: Path, world: str
) -> None:
    logs = [
        fly(
            simulate(world=world, world_seed=6), control=by_host(vehicle), log_path=tmp_path / f"{k}.mcap"
        ).log.read_bytes()
        for k in range(2)
    ]
    assert logs[0] == logs[1]


def test_vehicle_that_stands_elsewhere_goes_to_the_first_node_first(
    fly: Fly, simulate: Simulate, vehicle: Vehicle, reference: Reference
) -> None:
    elsewhere = simulate(start_ned=(0.8, -0.5, 0.0), start_yaw=1.0)
    result = fly(elsewhere, control=by_host(vehicle))
    assert result.end is not None
    assert result.end.whole
    assert result.tracking_rmse_m is not None
    assert result.tracking_rmse_m < 0.05
    flight = read_flight(result.log)
    assert flight.estimate is not None
    assert flight.tracking is not None
    k = np.searchsorted(flight.estimate.t_us, flight.tracking[0])
    first = reference.nodes_ned()[0].state[:3]
    assert np.linalg.norm(flight.estimate.p[k] - first) < 0.03


def test_controller_flies_over_a_radio_that_loses_a_fifth_of_its_frames(
    fly: Fly, simulate: Simulate, vehicle: Vehicle
) -> None:
    result = fly(simulate(world="lossy-link", world_seed=3), control=by_host(vehicle))
    assert result.end is not None
    assert result.end.whole
    assert result.tracking_rmse_m is not None
    assert result.tracking_rmse_m < 0.1
    assert result.control is not None
    assert result.control["estimate_age_ms_p99"] > 30.0
    assert result.link["up_lost"] > 0


def test_controller_without_a_command_leaves_the_vehicle_to_its_hold(
    fly: Fly, simulate: Simulate, vehicle: Vehicle, reference: Reference
) -> None:
    def outcome(t_us: int) -> tuple[SolveStatus, bool]:
        if t_us < 2_000_000:
            return SolveStatus.SOLVED, True
        return SolveStatus.BUDGET_SPENT, t_us < 2_200_000

    controller = RateController(vehicle, outcome=outcome)
    with pytest.raises(FlightEnded, match=r"outer-loop gave no command any more") as caught:
        fly(simulate(), control=by_host(vehicle, controller), parameters={"FS_OFFB_HOLD_S": 1.0})
    assert caught.value.exit_code == 1
    answer = caught.value.result.to_dict()
    assert (answer["whole"], answer["failsafe"], answer["interrupted"]) == (False, None, False)
    assert answer["control"]["stopped"] == "no-command"
    assert answer["control"]["budget_spent"] == 9
    assert answer["control"]["sent"] == answer["control"]["steps"] - 1
    flight = read_flight(caught.value.result.log)
    assert flight.status is not None
    assert [state for state, _ in groupby(flight.status.state.tolist())][-4:] == [OFFBOARD, HOLD, LANDING, 1]
    assert not flight.tracking_whole
    assert flight.tracking is not None
    assert (flight.tracking[1] - flight.tracking[0]) * 1e-6 == pytest.approx(2.2, abs=0.03)
    held_us = flight.status.t_us[flight.status.state == HOLD]
    # FS_OFFB_S after the last setpoint.
    assert (held_us.max() - flight.tracking[1]) * 1e-6 > 0.5


def test_radio_that_is_cut_ends_the_stream_and_the_vehicle_lands(
    fly: Fly, simulate: Simulate, vehicle: Vehicle
) -> None:
    with pytest.raises(FlightEnded) as caught:
        fly(simulate(radio={"cuts_s": [[9.0, 2.0]]}), control=by_host(vehicle))
    end = caught.value.result.end
    assert end is not None
    assert not end.whole
    flight = read_flight(caught.value.result.log)
    steps = flight.host_control
    assert steps is not None
    # The controller went on by prediction for a quarter of a second.
    assert 200_000 < steps.estimate_age_us.max() <= 250_000
    assert flight.failsafe == "mocap-lost"


def test_interrupted_flight_lands_and_its_log_is_read(
    vehicle: Vehicle, reference: Reference, simulate: Simulate, tmp_path: Path
) -> None:
    controller = RateController(vehicle)
    pressed: list[int] = []

    def outcome(t_us: int) -> tuple[SolveStatus, bool]:
        if t_us > 1_500_000 and not pressed:
            pressed.append(t_us)
            os.kill(os.getpid(), signal.SIGINT)
        return SolveStatus.SOLVED, True

    controller = RateController(vehicle, outcome=outcome)
    log = tmp_path / "x.mcap"
    order = FlightRequest(
        vehicle=vehicle, reference=reference, log_path=log, control=by_host(vehicle, controller)
    )
    director = FlightDirector(order)
    run_lockstep(director.session, simulate(), interrupt=director.interrupt)
    director.close()
    assert director.end is not None
    assert (director.end.interrupted, director.end.whole) == (True, False)
    flight = read_flight(log)
    assert flight.mocap is not None
    assert abs(flight.mocap.p[-1, 2]) < 0.1
    assert flight.tracking is not None
    assert (flight.tracking[1] - flight.tracking[0]) * 1e-6 == pytest.approx(1.5, abs=0.1)
    assert tracking_error(flight) is not None


def test_controller_that_raises_lands_the_vehicle_first(fly: Fly, vehicle: Vehicle, tmp_path: Path) -> None:
    def outcome(t_us: int) -> tuple[SolveStatus, bool]:
        if t_us > 500_000:
            raise ZeroDivisionError("a bug in a controller")
        return SolveStatus.SOLVED, True

    with pytest.raises(ZeroDivisionError):
        fly(control=by_host(vehicle, RateController(vehicle, outcome=outcome)))
    status = read_flight(tmp_path / "flight.mcap").status
    assert status is not None
    assert status.state.tolist()[-2:] == [LANDING, 1]


def test_recovered_log_has_the_tracking_phase_up_to_its_end(
    steered: tuple[FlightResult, Flight], reference: Reference, tmp_path: Path
) -> None:
    whole = steered[0].log.read_bytes()
    cut = tmp_path / "cut.mcap"
    part_path(cut).write_bytes(whole[: round(0.6 * len(whole))])
    recovery = recover(cut)
    assert recovery.output is not None
    flight = read_flight(recovery.output)
    assert flight.host_control is not None
    assert flight.host_control.controller == "outer-loop"
    assert flight.tracking is not None
    assert not flight.tracking_whole
    assert 1_000_000 < flight.tracking[1] - flight.tracking[0] < reference.duration_us
    assert steered[1].tracking is not None
    assert abs(flight.tracking[0] - steered[1].tracking[0]) <= 500
    error = tracking_error(flight)
    assert error is not None
    assert error.rmse_m < 0.06


def test_flight_by_a_controller_is_predicted_from_its_inputs_and_repeats_only_itself(
    steered: tuple[FlightResult, Flight], flown: tuple[FlightResult, Flight]
) -> None:
    by_controller, by_law = steered[1], flown[1]
    assert by_law.flown_by_own_law
    assert not by_controller.flown_by_own_law
    assert drive_of([by_law]) == "reference"
    assert drive_of([by_law, by_controller]) == "inputs"
    for flight, without_law in ((by_law, False), (by_controller, True)):
        findings = {finding.code: finding for finding in audit(FlightData.of(flight)).findings}
        assert (Code.NO_REFERENCE in findings) == without_law
        if without_law:
            assert findings[Code.NO_REFERENCE].subject == ("host-control",)
    assert by_controller.host_control is not None
    other = dataclasses.replace(by_controller.host_control, settings_id="ba9876543210")
    again = dataclasses.replace(by_controller, host_control=other)
    assert repeat_flights_of([by_law, by_controller, again, by_controller]) == [(1, 3)]


def test_second_reference_with_a_controller_is_refused(
    fly: Fly, vehicle: Vehicle, reference: Reference
) -> None:
    with pytest.raises(UsageError, match="flies one reference"):
        fly(control=by_host(vehicle), then=reference)


def test_log_without_a_controller_has_no_channel_for_one(flown: tuple[FlightResult, Flight]) -> None:
    result, flight = flown
    assert flight.host_control is None
    assert result.to_dict()["control"] is None
    assert topics.HOST_CONTROL not in scan(result.log).by_topic()
