"""Samples of a reference, and the tables made of them."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest

from trimtab.host.export.samples import at_rate, sample
from trimtab.host.export.tables import csv_table, json_table, px4_table
from trimtab.protocol.blobs import Node, Reference, YawNode

END = (1.0, 0.0, -1.0, *[0.0] * 9)
REFERENCE = Reference(
    vehicle_id="0" * 12,
    origin_ned=(0.0, 0.0, 0.0),
    nodes=(Node(0, (0.0, 0.0, -1.0, *[0.0] * 9)), Node(1_010_000, END)),
    yaws=(YawNode(0, 0.0, 0.0), YawNode(1_010_000, 1.0, 0.0)),
)


def test_sample_is_the_septic_piece_and_its_derivatives() -> None:
    held = sample(REFERENCE, [0.0, 0.505, 1.01])
    assert held.p_ned[1] == pytest.approx([0.5, 0.0, -1.0])
    assert held.v_ned[1, 0] == pytest.approx(35.0 / 16.0 / 1.01)  # of 35 s^4 - 84 s^5 + 70 s^6 - 20 s^7
    assert held.yaw.tolist() == pytest.approx([0.0, 0.5, 1.0])
    assert held.yaw_rate[1] == pytest.approx(1.5 / 1.01)
    assert np.abs(held.v_ned[[0, 2]]).max() < 1e-12


@pytest.mark.parametrize("t_s", [-1e-3, 1.02, float("nan")])
def test_sample_outside_the_reference_is_refused(t_s: float) -> None:
    with pytest.raises(ValueError, match="outside"):
        sample(REFERENCE, t_s)


def test_samples_at_a_rate_end_with_the_end() -> None:
    assert at_rate(REFERENCE, 4.0).t_s.tolist() == pytest.approx([0.0, 0.25, 0.5, 0.75, 1.0, 1.01])
    assert at_rate(REFERENCE, 1000.0).t_s[-2:].tolist() == pytest.approx([1.009, 1.01])


def test_csv_and_json_hold_the_same_samples_with_units() -> None:
    header, *rows = csv.reader(csv_table(REFERENCE, 10.0).splitlines())
    assert header[:4] == ["t_s", "position_north_m", "position_east_m", "position_down_m"]
    assert header[-2:] == ["yaw_rad", "yaw_rate_rad_s"]
    told = json.loads(json_table(REFERENCE, 10.0))
    assert (told["reference"], told["frame"]) == (REFERENCE.id, "NED")
    held = np.array(rows, dtype=float)
    np.testing.assert_allclose(held[:, 0], told["t_s"])
    np.testing.assert_allclose(held[:, 4:7], told["velocity_m_s"], rtol=1e-8)
    np.testing.assert_allclose(held[:, -2], told["yaw_rad"], rtol=1e-8)


def test_px4_table_has_the_fields_of_its_setpoint_and_microseconds() -> None:
    header, first, second, *_ = csv.reader(px4_table(REFERENCE, 50.0).splitlines())
    assert header[0] == "timestamp"
    assert header[1:4] == ["position[0]", "position[1]", "position[2]"]
    assert header[-3:] == ["jerk[2]", "yaw", "yawspeed"]
    assert (first[0], second[0]) == ("0", "20000")
