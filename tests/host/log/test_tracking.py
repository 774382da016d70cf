"""A reference as arrays: the law's interpolation at every time, and held ends."""

from __future__ import annotations

import numpy as np
import pytest

from tests.host.control.examples import reference
from trimtab.firmware_model.law.reference import hermite_yaw, septic
from trimtab.host.log.tracking import ReferencePath, reference_at


@pytest.mark.parametrize("route", ["pretzel", "sprint"])
def test_path_is_the_law_s_interpolation(route: str) -> None:
    flown = reference(route)
    nodes, rows = flown.nodes_ned(), flown.yaw_nodes()
    path = ReferencePath(flown)
    for first, last in ((0, 1), (7, 8), (len(nodes) - 2, len(nodes) - 1)):
        t_us = (nodes[first].t_us + nodes[last].t_us) // 2
        dt_s, s_s = (nodes[last].t_us - nodes[first].t_us) * 1e-6, (t_us - nodes[first].t_us) * 1e-6
        expected = septic(dt_s, s_s, nodes[first].state, nodes[last].state)[:4]
        row = path.at(np.array([t_us]))[0]
        np.testing.assert_allclose(row[:12], np.ravel(expected), rtol=0.0, atol=1e-9)
        if len(rows) > 1:
            k = max(i for i, each in enumerate(rows[:-1]) if each.t_us <= t_us)
            dt_s, s_s = (rows[k + 1].t_us - rows[k].t_us) * 1e-6, (t_us - rows[k].t_us) * 1e-6
            ends = (rows[k].yaw, rows[k].yaw_rate, rows[k + 1].yaw, rows[k + 1].yaw_rate)
            np.testing.assert_allclose(row[12:], hermite_yaw(dt_s, s_s, *ends), atol=1e-12)


def test_ends_are_held_and_one_evaluation_equals_many() -> None:
    flown = reference("sprint")
    times = np.array([-500_000, 0, 1_234_567, flown.duration_us, flown.duration_us + 1_000_000])
    rows = reference_at(flown, times)
    np.testing.assert_array_equal(rows[0], rows[1])
    np.testing.assert_array_equal(rows[3, :13], rows[4, :13])
    path = ReferencePath(flown)
    np.testing.assert_array_equal(np.concatenate([path.at(times[k : k + 1]) for k in range(5)]), rows)
