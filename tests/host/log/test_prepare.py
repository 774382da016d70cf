"""Preparing a flight: smoothing with covariance, gaps, and what Euler angles cannot tell."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.fly import fly_lockstep
from trimtab.host.log import Flight, read_flight
from trimtab.host.log import prepare as module
from trimtab.host.log.errors import TooLittleData
from trimtab.host.log.prepare import prepare
from trimtab.host.plan import plan
from trimtab.host.route import load_route
from trimtab.host.vehicle import load_vehicle
from trimtab.sitl.vehicle import SimulatedVehicle


@pytest.fixture(scope="module")
def flight(tmp_path_factory) -> Flight:
    vehicle = load_vehicle("research")
    reference = plan(load_route("doublets"), vehicle, kind="min-snap").reference
    path = tmp_path_factory.mktemp("flight") / "flight.mcap"
    start = reference.nodes_ned()[0].state
    simulated = SimulatedVehicle.create(vehicle, flight=1, start_ned=(start[0], start[1], 0.0))
    with closing(simulated):
        fly_lockstep(FlightRequest(vehicle=vehicle, reference=reference, log_path=path), simulated)
    return read_flight(path)


def without_poses(flight: Flight, start_s: float, end_s: float) -> Flight:
    """The flight with no pose between these times of its tracking phase."""
    mocap, tracking = flight.mocap, flight.tracking
    assert mocap is not None
    assert tracking is not None
    t_s = 1e-6 * (mocap.t_us - tracking[0])
    keep = (t_s < start_s) | (t_s > end_s)
    return replace(flight, mocap=mocap.rows(keep))


def test_prepare_follows_the_reference_with_a_covariance_and_nothing_to_note(flight):
    (found,) = prepare([flight])
    assert found.notes == ()
    assert found.seen.all()
    assert found.x.shape == (len(found.at_s), 12)
    assert flight.tracking is not None
    assert found.start_s == pytest.approx(1e-6 * flight.tracking[0])
    # The smoothed acceleration is what the velocity's slope says; each derivative is known less.
    slope = np.gradient(found.x[:, 3:6], found.step_s, axis=0)
    assert np.sqrt(((found.a - slope) ** 2).mean()) < 0.2
    variances = np.einsum("nii->ni", found.path_covariance)
    assert (variances > 0.0).all()
    assert (np.diff(variances, axis=1) > 0.0).all()
    eigenvalues = np.linalg.eigvalsh(found.path_covariance)
    assert (eigenvalues > -1e-12).all()


def test_prepare_gap_does_not_count_and_is_noted(flight):
    (whole,) = prepare([flight])
    (found,) = prepare([without_poses(flight, 2.0, 2.5)])
    inside = (found.at_s - found.start_s > 2.02) & (found.at_s - found.start_s < 2.48)
    assert not found.seen[inside].any()
    assert found.seen[~inside].mean() > 0.98
    (note,) = found.notes
    assert "flight.mcap: no pose for more than 0.25 s, first at 2.0" in note
    # What lies in the gap is known less, and says so.
    assert found.path_covariance[inside, 0, 0].max() > 20.0 * whole.path_covariance[inside, 0, 0].max()


def test_prepare_rows_that_are_no_number_are_noted(flight):
    assert flight.mocap is not None
    (found,) = prepare([replace(flight, mocap=replace(flight.mocap, left_out=3))])
    assert found.notes == ("flight.mcap: 3 rows of poses with values that are not finite were left out",)


def test_prepare_cuts_a_flight_where_it_leaves_the_range_of_euler_angles(flight, monkeypatch):
    (whole,) = prepare([flight])
    leaning = np.abs(whole.x[:, 6:8]).max(1)
    monkeypatch.setattr(module, "_TILT_MAX", 0.7 * leaning.max())
    (found,) = prepare([flight])
    assert len(found.x) == np.flatnonzero(leaning > 0.7 * leaning.max())[0]
    assert np.array_equal(found.x, whole.x[: len(found.x)])
    assert "flight.mcap: leaves the range of Euler angles" in found.notes[0]
    assert found.notes[0].endswith("cut there")
    monkeypatch.setattr(module, "_TILT_MAX", 1e-3)
    with pytest.raises(TooLittleData, match=r"flight\.mcap: leaves the range .* stays below 80 deg"):
        prepare([flight])
