"""The references of section VI-B: numbers, paces, statistics beside table I."""

from __future__ import annotations

import numpy as np
import pytest

from trimtab.host.apps.paper.flight.courses import OOD_PACES, PACES, PATHS, draw, draw_courses
from trimtab.host.apps.paper.flight.published import NUMBERS, STATISTICS
from trimtab.host.apps.paper.paths import Course, statistics
from trimtab.host.plan.table import Table
from trimtab.host.vehicle import load_vehicle
from trimtab.protocol.blobs import Node, Reference

VEHICLE = load_vehicle("research")


@pytest.fixture(scope="module")
def courses() -> list[Course]:
    return draw_courses(VEHICLE, 9100)


def test_draw_courses_are_as_many_as_in_the_paper(courses):
    known = [c for c in courses if not c.out_of_distribution]
    assert (len(known), len(courses) - len(known)) == (NUMBERS["known"], NUMBERS["ood"])
    assert (len(known), len(OOD_PACES)) == (PATHS * len(PACES), NUMBERS["ood"])
    assert len({c.name for c in courses}) == len(courses)


def test_draw_courses_a_path_at_half_the_pace_takes_twice_the_time(courses):
    fast, slow = courses[0], courses[3]
    factor = PACES[0] / PACES[3]
    assert slow.reference.duration_us == pytest.approx(factor * fast.reference.duration_us, rel=1e-6)
    ends = [np.array(c.reference.nodes_ned()[-1].state[:3]) for c in (fast, slow)]
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-5)


def test_draw_courses_have_statistics_near_table_one(courses):
    for which, ood in (("known", False), ("ood", True)):
        ours = statistics([c for c in courses if c.out_of_distribution == ood])
        for quantity, (mean, sd) in STATISTICS[which].items():
            assert ours[f"{quantity}_mean"] == pytest.approx(mean, rel=0.2), (which, quantity)
            assert ours[f"{quantity}_sd"] == pytest.approx(sd, rel=0.35), (which, quantity)


def test_draw_courses_depend_on_the_seed_alone(courses):
    again = draw_courses(VEHICLE, 9100)
    assert [c.reference.id for c in again] == [c.reference.id for c in courses]
    assert draw(1, "world", 0) != draw(1, "world", 1) != draw(2, "world", 1)


def test_statistics_of_a_known_motion_are_those_computed_by_hand():
    # x = t^3 m over 1 s: speed 3 t^2, acceleration 6 t, jerk 6, sampled every 20 ms from 0.
    states = np.zeros((2, 12))
    states[1, [0, 3, 6]] = 1.0, 3.0, 6.0
    states[:, 9] = 6.0
    table = Table(times_us=np.array([0, 1_000_000]), states_ned=states)
    nodes = tuple(Node(int(t), tuple(row)) for t, row in zip(table.times_us, states, strict=True))
    reference = Reference(vehicle_id="0" * 12, origin_ned=(0.0, 0.0, 0.0), nodes=nodes, free_ends=True)
    found = statistics([Course(name="c", out_of_distribution=False, reference=reference, table=table)])
    t = np.arange(50) * 0.02
    assert found["speed_m_s_mean"] == pytest.approx(np.mean(3 * t**2))
    assert found["speed_m_s_sd"] == pytest.approx(np.std(3 * t**2))
    assert found["acceleration_m_s2_mean"] == pytest.approx(6 * 0.49)
    assert found["jerk_m_s3_mean"] == pytest.approx(6.0)
    assert found["jerk_m_s3_sd"] == pytest.approx(0.0, abs=1e-6)
