"""Polynomials for a Crazyflie, evaluated step by step as its firmware does."""

from __future__ import annotations

import csv
from collections.abc import Sequence

import numpy as np
import pytest

from trimtab.host.base.errors import Refused
from trimtab.host.export.crazyflie import (
    HEADER,
    PIECES_MAX,
    POSITION_MAX_M,
    VELOCITY_MAX_M_S,
    YAW_MAX,
    evaluate,
    polynomials,
)
from trimtab.host.export.samples import sample
from trimtab.host.plan import plan
from trimtab.host.route import Route, YawProfile, random_route
from trimtab.host.vehicle import load_vehicle
from trimtab.protocol.blobs import Reference

VEHICLE = load_vehicle("research")
TURNING = Route(
    name="turning",
    total_time_s=6.0,
    waypoints_m=((0.0, 0.0, -1.2), (1.5, 1.0, -1.6), (0.0, 2.0, -1.2)),
    yaw=YawProfile(yaw_deg=(20.0, 140.0), times_s=(0.0, 5.0)),
)
MIN_SNAP = plan(TURNING, VEHICLE).reference
MIN_CONTROL = plan(random_route(5, count=5), VEHICLE, kind="min-control").reference


class Firmware:
    """The trajectory of a table, in float32, one operation at a time."""

    def __init__(self, text: str) -> None:
        header, *rows = csv.reader(text.splitlines())
        assert header == list(HEADER)
        self.pieces = [[np.float32(cell) for cell in row] for row in rows]

    def at(self, t_s: float) -> tuple[list[np.float32], list[np.float32]]:
        """x, y, z, yaw and their rates at a time."""
        left = np.float32(t_s)
        for piece in self.pieces[:-1]:
            if left <= piece[0]:
                break
            left = np.float32(left - piece[0])
        else:
            piece = self.pieces[-1]
        axes = [piece[1 + 8 * k : 9 + 8 * k] for k in range(4)]
        rates = [[np.float32(np.float32(i) * axis[i]) for i in range(1, 8)] for axis in axes]
        return [horner(axis, left) for axis in axes], [horner(rate, left) for rate in rates]


def horner(powers: Sequence[np.float32], t: np.float32) -> np.float32:
    x = np.float32(0.0)
    for value in reversed(powers):
        x = np.float32(np.float32(x * t) + value)
    return x


@pytest.mark.parametrize("reference", [MIN_SNAP, MIN_CONTROL], ids=["min-snap with yaw", "min-control"])
def test_table_evaluated_as_on_board_is_within_the_errors(reference: Reference) -> None:
    found = polynomials(reference)
    firmware = Firmware(found.to_csv())
    assert len(firmware.pieces) <= PIECES_MAX
    end_s = reference.duration_us * 1e-6
    assert sum(float(piece[0]) for piece in firmware.pieces) == pytest.approx(end_s, abs=1e-5)
    t_s = np.random.default_rng(2).uniform(0.0, end_s, 400)
    p, v = (np.array(each, dtype=float) for each in zip(*map(firmware.at, t_s), strict=True))
    wanted = sample(reference, t_s)
    flip = np.array([1.0, -1.0, -1.0])
    assert np.linalg.norm(p[:, :3] - wanted.p_ned * flip, axis=1).max() <= 1.02 * POSITION_MAX_M
    assert np.linalg.norm(v[:, :3] - wanted.v_ned * flip, axis=1).max() <= 1.02 * VELOCITY_MAX_M_S
    assert np.abs(p[:, 3] + wanted.yaw).max() <= 1.02 * YAW_MAX


def test_own_evaluation_has_the_bits_of_the_step_by_step_one() -> None:
    found = polynomials(MIN_CONTROL)
    t_s = np.linspace(0.0, MIN_CONTROL.duration_us * 1e-6, 211)
    p, v = evaluate(found.durations_s, found.coefficients, t_s)
    q, w = (
        np.array(each, dtype=np.float32) for each in zip(*map(Firmware(found.to_csv()).at, t_s), strict=True)
    )
    np.testing.assert_array_equal(p, q)
    np.testing.assert_array_equal(v, w)


def test_pieces_join_in_position_velocity_and_acceleration() -> None:
    found = polynomials(MIN_CONTROL)
    for piece, duration, following in zip(
        found.coefficients, found.durations_s, found.coefficients[1:], strict=False
    ):
        for order, tolerance in enumerate((1e-5, 1e-4, 1e-3)):
            ends, starts = (
                [np.polynomial.Polynomial(axis.astype(float)).deriv(order)(float(at)) for axis in of]
                for of, at in ((piece, duration), (following, 0.0))
            )
            np.testing.assert_allclose(ends, starts, atol=tolerance)


def test_more_error_needs_fewer_pieces_and_none_is_refused_with_the_figure() -> None:
    counts = [len(polynomials(MIN_CONTROL, error_scale=scale).durations_s) for scale in (1.0, 20.0)]
    assert counts[1] < counts[0]
    with pytest.raises(Refused, match=r"^31 pieces.* mm, .* m/s: .* times the allowed errors; .*error-scale"):
        polynomials(MIN_CONTROL, error_scale=1e-4)
