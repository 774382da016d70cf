"""The record of the plant's motion: it changes no byte of a flight, and its clock is that of the log."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trimtab.host.apps.demo.flights import Airfield
from trimtab.host.log import read_flight
from trimtab.host.log.prepare import Prepared, prepare
from trimtab.host.plan import plan
from trimtab.host.route import Route
from trimtab.host.vehicle import load_vehicle
from trimtab.protocol.blobs import Reference
from trimtab.sitl.studies.labels.witness import GRID_TICKS, Motion, WitnessedField, vehicle_s

VEHICLE = load_vehicle("research")
POINTS = ((0.0, 0.0, -1.0), (1.5, 1.0, -1.6), (-1.0, 1.5, -1.2), (0.5, -0.5, -1.0))
AGE_S = 0.02
WORLD = """
description = "drag, and poses that are older than their stamps"
tolerances = false
[effects.linear-drag]
dx = 0.5
dy = 0.5
dz = 0.1
[effects.mocap-latency]
latency_s = {age_s}
"""


@pytest.fixture(scope="module")
def reference() -> Reference:
    return plan(Route(name="short", waypoints_m=POINTS, total_time_s=4.0), VEHICLE).reference


@pytest.fixture(scope="module", params=[0.0, AGE_S])
def flown(
    request: pytest.FixtureRequest, reference: Reference, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Prepared, Motion, float]:
    """A prepared flight, the true motion, and the age of its poses, s."""
    folder: Path = tmp_path_factory.mktemp("flown")
    (folder / "world.toml").write_text(WORLD.format(age_s=request.param))
    field = WitnessedField(vehicle=VEHICLE, world=str(folder / "world.toml"), world_seed=3, session={})
    field.fly(reference, 1, folder / "flight.mcap")
    (prepared,) = prepare([read_flight(folder / "flight.mcap")])
    return prepared, field.vehicles[1].plant.motion(), request.param


def test_flight_has_the_same_bytes_with_and_without_a_witness(reference: Reference, tmp_path: Path) -> None:
    logs = [tmp_path / "plain.mcap", tmp_path / "witnessed.mcap"]
    for kind, log in zip((Airfield, WitnessedField), logs, strict=True):
        field = kind(vehicle=VEHICLE, world="paper-drag", world_seed=3, session={})
        field.fly(reference, 1, log)
    assert logs[0].read_bytes() == logs[1].read_bytes()


def test_true_positions_agree_with_those_of_the_log_within_camera_noise(
    flown: tuple[Prepared, Motion, float],
) -> None:
    prepared, motion, age_s = flown
    at_s = vehicle_s(prepared)
    error = prepared.x[:, :3] - motion.positions(at_s - age_s)
    # The camera's noise is 1 mm; the smoothed path has less. A millisecond is 2 mm at 2 m/s.
    assert np.sqrt((error**2).mean()) < 0.7e-3
    velocity = prepared.x[:, 3:6]
    shift_s = (error * velocity).sum() / (velocity**2).sum()
    assert abs(shift_s) < 0.5e-3  # half a tick


def test_true_accelerations_are_those_of_the_recorded_path(flown: tuple[Prepared, Motion, float]) -> None:
    _, motion, _ = flown
    step_s = motion.t_s[1] - motion.t_s[0]
    assert step_s == pytest.approx(1e-3 * GRID_TICKS)
    flying = slice(len(motion.t_s) // 4, -len(motion.t_s) // 4)
    second = np.gradient(np.gradient(motion.p, step_s, axis=0), step_s, axis=0)
    assert np.sqrt(((second - motion.a)[flying] ** 2).mean()) < 0.1 * np.sqrt((motion.a[flying] ** 2).mean())


def test_times_outside_of_the_record_are_refused(flown: tuple[Prepared, Motion, float]) -> None:
    _, motion, _ = flown
    with pytest.raises(ValueError, match="recorded"):
        motion.accelerations(np.array([1.0, 1e3]))
