"""What thin worlds fly, and what is left in the copies of their logs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trimtab.host.log import Control, Flight, read_flight
from trimtab.host.trace.data.audit import audit
from trimtab.host.trace.data.signals import FlightData
from trimtab.host.trace.decision.findings import Code
from trimtab.sitl.studies import cut
from trimtab.sitl.studies.commandline import run_apart
from trimtab.sitl.studies.files import read_json, sha256_of
from trimtab.sitl.studies.flights import BLIND, VERDICT, Programme, fly_and_seal, trace
from trimtab.sitl.studies.scoring.world import is_told
from trimtab.sitl.studies.thin import CASES, OTHER, copier_of, plan_thin_references, programme_of
from trimtab.sitl.studies.worlds import THIN, PlannedWorld

LOG = Path(__file__).parents[2] / "data" / "a1.mcap"


@pytest.fixture(scope="module")
def flight() -> Flight:
    return read_flight(LOG)


def controls(flight: Flight) -> Control:
    assert flight.control is not None
    return flight.control


def test_every_case_that_is_drawn_is_known() -> None:
    assert tuple(CASES) == THIN


@pytest.mark.parametrize(
    ("case", "flown", "held_out"),
    [
        (None, 8, 2),
        ("one flight", 1, 0),
        ("no twins", 4, 2),
        ("no gyro", 8, 2),
        ("two vehicles", 2, 0),
        ("three seconds", 1, 0),
        ("constant hover", 2, 0),
    ],
)
def test_programme_of_a_case_flies_so_many(case: str | None, flown: int, held_out: int) -> None:
    found = programme_of(case, BLIND)
    assert len(found.logs(found.learning)) == flown
    assert len(found.logs(found.held_out)) == held_out


def test_copy_without_gyro_keeps_the_rest_of_what_an_import_holds(flight: Flight, tmp_path: Path) -> None:
    cut.without_gyro(LOG, tmp_path / "log.mcap")
    left = read_flight(tmp_path / "log.mcap")
    assert left.control is left.reference is left.firmware_parameters is None
    assert left.recorded_imu is not None
    assert left.recorded_imu.gyro is None
    assert left.recorded_imu.specific_force is not None
    assert left.mocap is not None
    assert flight.mocap is not None
    assert left.tracking == flight.tracking
    np.testing.assert_array_equal(left.mocap.p, flight.mocap.p[flight.mocap.t_us >= 0])
    assert left.recorded_inputs is not None
    assert left.recorded_inputs.motor is not None
    c = controls(flight)
    np.testing.assert_allclose(left.recorded_inputs.motor, c.motor_mean[c.t0_us >= 0], atol=1e-6)


def test_sampled_commands_are_those_of_the_instant(flight: Flight, tmp_path: Path) -> None:
    cut.sampled(LOG, tmp_path / "log.mcap")
    left = read_flight(tmp_path / "log.mcap")
    assert left.recorded_imu is not None
    assert left.recorded_imu.gyro is not None
    assert left.recorded_inputs is not None
    assert left.recorded_inputs.motor is not None
    c = controls(flight)
    assert flight.tracking is not None
    inside = (c.t1_us > flight.tracking[0]) & (c.t1_us < flight.tracking[1])
    instant = cut.motor_commands(flight.vehicle, c)[inside]
    means = c.motor_mean[inside]
    # Between the means over the ten milliseconds before and after, but for what happens within them.
    off = instant[:-1] - 0.5 * (means[:-1] + means[1:])
    assert np.abs(off.mean(axis=0)).max() < 1e-3
    assert 1e-4 < off.std() < 0.02


def test_copy_without_reference_keeps_the_flight(flight: Flight, tmp_path: Path) -> None:
    cut.without_reference(LOG, tmp_path / "log.mcap")
    left = read_flight(tmp_path / "log.mcap")
    assert left.reference is left.reference_id is left.firmware_parameters is None
    assert left.kind == "flight"
    assert left.tracking is not None
    assert flight.tracking is not None
    assert left.tracking[0] == flight.tracking[0]
    assert abs(left.tracking[1] - flight.tracking[1]) < 200_000
    np.testing.assert_array_equal(controls(left).motor_mean, controls(flight).motor_mean)
    assert Code.NO_REFERENCE in {finding.code for finding in audit(FlightData.of(left)).findings}


@pytest.fixture(scope="module")
def references(tmp_path_factory: pytest.TempPathFactory, short_programme: Programme) -> Path:
    folder = tmp_path_factory.mktemp("thin")
    (folder / "references").mkdir()
    route = short_programme.route("one")
    assert run_apart(["plan", route, "-o", "one.ref"], folder / "references").code == 0
    plan_thin_references(folder, "research", short_programme)
    return folder / "references"


@pytest.mark.full  # flies two vehicles; the refusal itself is tested with the logs
def test_two_vehicles_are_flown_and_the_answer_says_so(
    references: Path, tmp_path: Path, short_programme: Programme
) -> None:
    case = "two vehicles"
    world = PlannedWorld(
        name="0000", kind_class="thin", kinds=("motor-lag",), seed=5, turbulence=1.0, case=case
    )
    programme = programme_of(case, short_programme)
    fly_and_seal(world, tmp_path, references, "research", programme)
    one, other = (read_flight(log) for log in sorted((tmp_path / "flights").iterdir()))
    assert other.path.name == f"{OTHER}-1.mcap"
    assert other.vehicle.mass_kg == pytest.approx(1.1 * one.vehicle.mass_kg)
    assert other.tracking_whole
    trace(tmp_path, programme, copier_of(case))
    verdict = read_json(tmp_path / VERDICT)
    assert verdict["exit_code"] == 2
    assert is_told(case, verdict)


def test_tracing_sees_the_cut_logs_alone(tmp_path: Path, short_programme: Programme) -> None:
    (tmp_path / "flights").mkdir()
    names = short_programme.logs(short_programme.learning)
    for name in names:
        (tmp_path / "flights" / name).write_bytes(LOG.read_bytes())
    before = sha256_of(LOG)
    seen: list[str] = []
    places: set[Path] = set()

    def copy(log: Path, target: Path) -> None:
        seen.append(log.name)
        places.add(target.parent)
        target.write_bytes(b"no log")

    trace(tmp_path, Programme(routes=tmp_path, learning=("one",), held_out=()), copy)
    assert sorted(seen) == names
    (place,) = places
    assert not place.exists()
    assert not place.is_relative_to(tmp_path)
    assert '"exit_code": 5' in (tmp_path / VERDICT).read_text()
    assert sha256_of(tmp_path / "flights" / names[0]) == before
