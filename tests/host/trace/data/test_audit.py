"""The audit of logs: no findings on ordinary flights, and one log with each defect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trimtab.host.log import Flight, RecordedImu, RecordedInputs, read_flight
from trimtab.host.trace import words
from trimtab.host.trace.answer import audit_json
from trimtab.host.trace.data.audit import UnusedStretch, audit, with_missing_repeats
from trimtab.host.trace.data.cutting import segments_of
from trimtab.host.trace.data.signals import FlightData
from trimtab.host.trace.decision.findings import Code, Finding

DATA = Path(__file__).parents[3] / "data"
BEGIN_S, END_S = 3.0, 3.5


@pytest.fixture(scope="module")
def flight() -> Flight:
    return read_flight(DATA / "a1.mcap")


def between(flight: Flight, t_us: np.ndarray, begin_s: float = BEGIN_S, end_s: float = END_S) -> np.ndarray:
    """Return the mask of samples from begin_s to end_s since tracking began."""
    assert flight.tracking is not None
    t_s = (t_us - flight.tracking[0]) * 1e-6
    return (t_s >= begin_s) & (t_s < end_s)


def poses(flight: Flight, keep: Any = None, **arrays: np.ndarray) -> Flight:
    """Return the flight with other poses, restricted to the rows `keep`."""
    assert flight.mocap is not None
    new = replace(flight.mocap, **arrays)
    if keep is not None:
        new = new.rows(keep)
    return replace(flight, mocap=new)


def commands(flight: Flight, keep: Any = None, **arrays: np.ndarray) -> Flight:
    assert flight.control is not None
    new = replace(flight.control, **arrays)
    if keep is not None:
        new = new.rows(keep)
    return replace(flight, control=new)


def changed(values: np.ndarray, where: np.ndarray, to: Any) -> np.ndarray:
    out = values.copy()
    out[where] = to
    return out


def codes(findings: Sequence[Finding]) -> set[Code]:
    return {finding.code for finding in findings}


def the_stretch(flight: Flight, code: Code) -> UnusedStretch:
    """Return the only stretch of the flight, after checking that no segment overlaps it."""
    health = audit(FlightData.of(flight))
    assert [stretch.code for stretch in health.stretches] == [code]
    (stretch,) = health.stretches
    data, (cut,) = segments_of([FlightData.of(flight)], rate_driven=False)
    assert not ((data.start_s < stretch.end_s) & (data.start_s + 0.6 > stretch.start_s)).any()
    assert [f.subject for f in cut.findings if f.code is Code.SEGMENTS_LEFT_OUT] == [(str(code),)]
    assert 0 < cut.left_out <= 3
    assert f"not used from {words.stretch(stretch)}" in words.audit_lines([cut])[0]
    return stretch


@pytest.mark.parametrize("name", ["a1", "a2", "b1", "b2", "c1"])
def test_ordinary_flights_are_used_whole_without_findings(name: str) -> None:
    health = audit(FlightData.of(read_flight(DATA / f"{name}.mcap")))
    assert health.stretches == ()
    assert health.findings == ()


def test_rates_are_those_of_the_topics_with_their_sampling(flight: Flight) -> None:
    rates = {rate.topic: rate for rate in audit(FlightData.of(flight)).rates}
    assert rates["/mocap/pose"].median_hz == pytest.approx(100.0)
    assert rates["/mocap/pose"].sampling == "sampled"
    assert rates["/fc/control"].sampling == "averaged"
    assert 90.0 < rates["/fc/control"].worst_hz <= 100.0


def test_audit_reports_poses_that_drop_for_a_second(flight: Flight) -> None:
    assert flight.mocap is not None
    count = np.arange(len(flight.mocap))
    thin = poses(flight, ~between(flight, flight.mocap.t_us, 2.0, 3.5) | (count % 4 == 0))
    (finding,) = audit(FlightData.of(thin)).findings
    assert finding.code is Code.RATE_DROPS
    assert finding.subject == ("/mocap/pose",)
    assert 20.0 <= (finding.value or 0.0) < 30.0
    assert finding.details["median_hz"] == pytest.approx(100.0)


def test_a_gap_in_the_poses_is_left_out(flight: Flight) -> None:
    assert flight.mocap is not None
    stretch = the_stretch(poses(flight, ~between(flight, flight.mocap.t_us)), Code.GAP_IN_POSES)
    assert stretch.start_s == pytest.approx(BEGIN_S, abs=0.015)
    assert stretch.end_s == pytest.approx(END_S, abs=0.015)


def test_a_part_that_the_import_left_out_is_ground_contact_and_covers_what_shows_in_it(
    flight: Flight,
) -> None:
    assert flight.tracking is not None
    assert flight.mocap is not None
    begin_us, _ = flight.tracking
    landed = (begin_us + round(1e6 * (BEGIN_S - 0.2)), begin_us + round(1e6 * (END_S + 0.2)))
    hidden = poses(flight, ~between(flight, flight.mocap.t_us))
    stretch = the_stretch(replace(hidden, unused=(landed,)), Code.GROUND_CONTACT)
    assert (stretch.start_s, stretch.end_s) == pytest.approx((BEGIN_S - 0.2, END_S + 0.2))


def test_a_gap_in_the_commands_is_left_out(flight: Flight) -> None:
    assert flight.control is not None
    gone = between(flight, flight.control.t1_us)
    assert the_stretch(commands(flight, ~gone), Code.GAP_IN_COMMANDS).end_s == pytest.approx(END_S, abs=0.015)
    last = int(np.flatnonzero(gone)[-1])
    one = commands(flight, ~gone | (np.arange(len(gone)) == last))
    assert one.control is not None
    t0_us = changed(one.control.t0_us, one.control.t1_us == flight.control.t1_us[last], 0)
    t0_us[1:] = np.where(t0_us[1:] == 0, one.control.t1_us[:-1], t0_us[1:])
    wide = commands(one, t0_us=t0_us)  # one mean over the whole gap
    assert the_stretch(wide, Code.GAP_IN_COMMANDS).start_s == pytest.approx(BEGIN_S, abs=0.02)


def test_a_jump_of_the_camera_clock_is_left_out(flight: Flight) -> None:
    assert flight.mocap is not None
    assert flight.tracking is not None
    t_us = flight.mocap.t_us.copy()
    t_us[t_us > flight.tracking[0] + 3_000_000] -= 5_000
    stretch = the_stretch(poses(flight, t_us=t_us), Code.CLOCK_JUMP)
    assert stretch.start_s <= BEGIN_S <= stretch.end_s


def test_a_backward_jump_of_the_vehicle_clock_is_left_out(flight: Flight) -> None:
    assert flight.control is not None
    late = np.arange(len(flight.control)) >= np.flatnonzero(between(flight, flight.control.t1_us))[0]
    stepped = commands(
        flight, t0_us=flight.control.t0_us - 4_000 * late, t1_us=flight.control.t1_us - 4_000 * late
    )
    the_stretch(stepped, Code.CLOCK_JUMP)


def test_audit_reports_clock_drift(flight: Flight) -> None:
    link = flight.link
    assert link is not None
    ramp = np.linspace(0.0, 8_000.0, len(link))
    (finding,) = audit(
        FlightData.of(replace(flight, link=replace(link, clock_offset_us=link.clock_offset_us + ramp)))
    ).findings
    assert finding.code is Code.CLOCK_DRIFT


def test_repeated_time_stamps_are_counted(flight: Flight) -> None:
    assert flight.mocap is not None
    twice = np.flatnonzero(between(flight, flight.mocap.t_us))[[3, 9, 20]]
    t_us = changed(flight.mocap.t_us, twice + 1, flight.mocap.t_us[twice])
    (finding,) = audit(FlightData.of(poses(flight, t_us=t_us))).findings
    assert (finding.code, finding.value, finding.subject) == (Code.REPEATED_STAMPS, 3, ("/mocap/pose",))


def test_a_vehicle_at_its_resting_height_touches_the_ground(flight: Flight) -> None:
    assert flight.mocap is not None
    p = flight.mocap.p.copy()
    p[between(flight, flight.mocap.t_us), 2] = flight.mocap.p[0, 2] - 0.02
    stretch = the_stretch(poses(flight, p=p), Code.GROUND_CONTACT)
    assert stretch.start_s == pytest.approx(BEGIN_S, abs=0.35)
    assert stretch.end_s == pytest.approx(END_S, abs=0.35)


def test_a_vehicle_with_thrust_below_weight_that_does_not_fall_touches_the_ground(flight: Flight) -> None:
    assert flight.mocap is not None
    assert flight.control is not None
    where = between(flight, flight.mocap.t_us)
    airborne = flight.mocap.p[:, 2] < -0.4
    p = flight.mocap.p.copy()
    p[where, 2] = p[airborne, 2].max()
    motor = flight.control.motor_mean.copy()
    motor[between(flight, flight.control.t1_us)] *= 0.8
    # A log that begins in the air and never reaches the floor.
    started = flight.control.t1_us > flight.mocap.t_us[airborne][0]
    low = commands(poses(flight, airborne, p=p), started, motor_mean=motor)
    the_stretch(replace(low, kind="imported"), Code.GROUND_CONTACT)
    assert audit(FlightData.of(commands(poses(flight, airborne), started))).stretches == ()


def test_an_impact_is_left_out(flight: Flight) -> None:
    assert flight.control is not None
    hit = np.flatnonzero(between(flight, flight.control.t1_us))[:2]
    the_stretch(
        commands(flight, force_mean=changed(flight.control.force_mean, hit, [30.0, 0.0, -9.8])), Code.IMPACT
    )


@pytest.mark.parametrize("limit", [0.0, 1.0])
def test_a_motor_at_its_limit_is_left_out(flight: Flight, limit: float) -> None:
    assert flight.control is not None
    motor = flight.control.motor_mean.copy()
    motor[between(flight, flight.control.t1_us), 2] = limit
    assert the_stretch(commands(flight, motor_mean=motor), Code.MOTOR_AT_LIMIT).end_s == pytest.approx(
        END_S, abs=0.02
    )


def test_audit_reports_saturated_rotors(flight: Flight) -> None:
    assert flight.status is not None
    clipped = replace(flight.status, saturated_ticks=flight.status.flight_ticks // 20)
    (finding,) = audit(FlightData.of(replace(flight, status=clipped))).findings
    assert finding.code is Code.ROTORS_SATURATED
    assert finding.value == pytest.approx(0.05, abs=0.001)


@pytest.mark.parametrize(
    ("angles_deg", "code"), [((0.0, 0.0, 78.0), Code.TILTED), ((0.0, 85.0, 0.0), Code.PITCH_SINGULAR)]
)
def test_singular_and_steep_attitudes_are_left_out(
    flight: Flight, angles_deg: tuple[float, float, float], code: Code
) -> None:
    assert flight.mocap is not None
    q = Rotation.from_euler("ZYX", angles_deg, degrees=True).as_quat(scalar_first=True)
    turned = changed(flight.mocap.q, between(flight, flight.mocap.t_us), q)
    assert the_stretch(poses(flight, q=turned), code).start_s == pytest.approx(BEGIN_S, abs=0.03)


def test_audit_reports_sampled_and_slow_commands(flight: Flight) -> None:
    assert flight.control is not None
    c = flight.control
    inputs = RecordedInputs(t_us=c.t1_us, level="motor", motor=c.motor_mean)
    imu = RecordedImu(t_us=c.t1_us, gyro=c.gyro_mean, specific_force=c.force_mean)
    sampled = replace(flight, control=None, recorded_inputs=inputs, recorded_imu=imu)
    (finding,) = audit(FlightData.of(sampled)).findings
    assert finding.code is Code.SAMPLED_COMMANDS
    deaf = audit(FlightData.of(replace(sampled, recorded_imu=None)))
    assert Code.NO_GYRO in codes(deaf.findings)
    slow = RecordedInputs(t_us=c.t1_us[::5], level="motor", motor=c.motor_mean[::5])
    assert Code.SLOW_COMMANDS in codes(audit(FlightData.of(replace(sampled, recorded_inputs=slow))).findings)


def test_audit_reports_missing_inputs(flight: Flight) -> None:
    findings = audit(FlightData.of(replace(flight, control=None))).findings
    assert {Code.NO_INPUTS, Code.NO_GYRO} <= codes(findings)


def test_with_missing_repeats_adds_a_finding_to_single_flights(flight: Flight) -> None:
    health = with_missing_repeats([audit(FlightData.of(flight))] * 3, [(0, 2)])
    assert [codes(one.findings) for one in health] == [set(), {Code.NO_REPEAT}, set()]


def test_audit_json_holds_the_audit(flight: Flight) -> None:
    assert flight.mocap is not None
    _, (cut,) = segments_of(
        [FlightData.of(poses(flight, ~between(flight, flight.mocap.t_us)))],
        rate_driven=False,
    )
    entry = audit_json(cut)
    assert entry["stretches"][0]["code"] == Code.GAP_IN_POSES
    assert entry["stretches"][0]["reason"] == words.reason(cut.stretches[0])
    assert entry["segments"] == cut.segments
    assert entry["used_s"] == pytest.approx(0.6 * cut.segments)
    assert set(entry["rates"][0]) == {"topic", "median_hz", "worst_hz", "sampling"}
