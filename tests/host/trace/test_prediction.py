"""Held-out errors: predictions do not use later measurements, and each pose counts at its stamp."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trimtab.host.effects import load_effects
from trimtab.host.log import Flight, Mocap, read_flight, write_imported
from trimtab.host.log.errors import TooLittleData
from trimtab.host.trace.data.cutting import DT_S
from trimtab.host.trace.data.logs import read_logs
from trimtab.host.trace.data.signals import FlightData, unknowns
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.parameters import space
from trimtab.host.trace.prediction import Errors, noise_floor, predict_segments
from trimtab.host.trace.segment_fit.model import SegmentModel
from trimtab.host.vehicle import load_vehicle

VEHICLE = load_vehicle("research")


def flight(
    path: Path, *, seconds: float = 16.0, turned_from_s: float = np.inf, every_us: int = 10_000
) -> Flight:
    """Return a slowly swinging flight of only poses; its attitude later has an error of 0.03 rad."""
    t_us = np.arange(0, round(seconds * 1e6), every_us)
    t = t_us * 1e-6
    p = np.column_stack([0.5 * np.sin(t), 0.3 * np.cos(1.3 * t), np.full(len(t), -1.5)])
    roll = np.where(t > turned_from_s, 0.03, 0.0)
    q = Rotation.from_euler("x", roll[:, None]).as_quat(scalar_first=True)
    write_imported(path, vehicle=VEHICLE, mocap=Mocap(t_us=t_us, t_arrival_us=t_us, p=p, q=q))
    return read_flight(path)


def errors_of(held_out: Flight) -> Errors:
    form = form_for(held_out)
    return predict_segments([FlightData.of(held_out)], form, np.zeros(len(form.space.columns)))[0]


def form_for(flight: Flight) -> SegmentModel:
    chosen = space(VEHICLE, load_effects(), unknowns([flight]))
    return SegmentModel(VEHICLE, chosen, dt_s=DT_S, in_newton=True, rate_driven=True)


def test_predictions_do_not_use_later_measurements(tmp_path: Path) -> None:
    one = errors_of(flight(tmp_path / "a.mcap"))
    other = errors_of(flight(tmp_path / "b.mcap", turned_from_s=10.0))
    earlier = one.t_s < 9.0
    assert earlier.sum() > 100
    np.testing.assert_array_equal(one.p_predicted_ned[earlier], other.p_predicted_ned[earlier])
    assert np.abs(one.p_predicted_ned[~earlier] - other.p_predicted_ned[~earlier]).max() > 1e-3


def test_predictions_begin_after_the_calibration_part(tmp_path: Path) -> None:
    assert errors_of(flight(tmp_path / "a.mcap")).t_s.min() >= RULES.calibration_share * 15.9


def test_predicted_and_measured_positions_are_of_the_same_time(tmp_path: Path) -> None:
    # Poses 13 ms apart fall between the grid's 10 ms: at 0.5 m/s half a step would show as millimetres.
    errors = errors_of(flight(tmp_path / "odd.mcap", every_us=13_000))
    north = 0.5 * np.sin(errors.t_s)
    np.testing.assert_allclose((errors.p_error_ned + errors.p_predicted_ned)[:, 0], north, atol=2e-4)


@pytest.mark.parametrize("every_us", [10_000, 8_000])
def test_errors_of_predicted_speeds_change_slowly_at_any_rate_of_poses(tmp_path: Path, every_us: int) -> None:
    """Poses 8 ms apart are up to 4 ms away from the grid: a wrong time step would show as 0.1 m/s."""
    speed_error = errors_of(flight(tmp_path / "poses.mcap", every_us=every_us)).v_error_ned[:, 0]
    assert np.quantile(np.abs(np.diff(speed_error)), 0.9) < 0.02


def test_a_held_out_flight_too_short_to_predict_is_refused_by_name(tmp_path: Path) -> None:
    short, long = flight(tmp_path / "short.mcap", seconds=1.1), flight(tmp_path / "long.mcap")
    form = form_for(long)
    with pytest.raises(TooLittleData, match=r"short\.mcap: too short"):
        predict_segments([FlightData.of(long), FlightData.of(short)], form, np.zeros(len(form.space.columns)))


def test_noise_floor_without_repeat_flights_is_none(tmp_path: Path) -> None:
    floor = noise_floor(read_logs([flight(tmp_path / "a.mcap")], [], None), None, {}, jobs=1)
    assert floor == {"position_rmse_m": None, "velocity_rmse_m_s": None}
