"""Profiles along a reference: the same margins as the vehicle's checks, the same figures as the plan's."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.parts import part
from trimtab.host.models.region import Region
from trimtab.host.plan import Plan, ResidualModel, plan
from trimtab.host.plan.profile import profile, sample_times, with_nodes
from trimtab.host.plan.table import from_reference
from trimtab.host.route import Route, YawProfile
from trimtab.host.route.shapes import Sphere
from trimtab.host.vehicle import load_vehicle

VEHICLE = load_vehicle("research")
MODEL = ResidualModel(
    parts=(part("linear-drag", 0.5, 0.4, 0.1),),
    region=Region(speed_max_m_s=1.5, tilt_max_deg=90.0, thrust_min_n=0.0, thrust_max_n=100.0),
)
ROUTE = Route(
    name="turning",
    waypoints_m=((-1.6, -0.9, -1.2), (1.7, 1.2, -1.6), (0.0, 2.4, -2.0)),
    total_time_s=4.6,
    yaw=YawProfile(yaw_deg=(0.0, 120.0, 40.0), times_s=(0.0, 2.0, 4.6)),
    keep_out=(Sphere(kind="sphere", centre_m=(-1.0, 1.6, -1.4), radius_m=0.3),),
)


@pytest.fixture(scope="module")
def made() -> Plan:
    return plan(ROUTE, VEHICLE, kind="min-snap", model=MODEL)


def test_profile_margins_are_those_of_the_vehicles_own_checks(made: Plan) -> None:
    table = from_reference(made.reference)
    along = profile(VEHICLE, MODEL, table, made.reference.yaw_nodes(), with_nodes(table))
    margins = along.margins(made.limits, ROUTE.keep_out)
    assert set(margins) == set(made.margins)
    for name, distance in margins.items():
        # Both sample; the checks every 12.5 ms.
        assert distance.min() == pytest.approx(made.margins[name], rel=2e-3, abs=2e-3), name
    k = int(margins["speed_m_s"].argmin())
    assert table.times_us[along.node[k]] <= 1e6 * along.t_s[k] + 1e-6
    assert 1e6 * along.t_s[k] < table.times_us[along.node[k] + 1]


def test_margin_shares_are_the_margins_over_their_limits(made: Plan) -> None:
    along = profile(VEHICLE, MODEL, from_reference(made.reference), made.reference.yaw_nodes())
    margins, shares, limits = along.margins(made.limits), along.margin_shares(made.limits), made.limits
    np.testing.assert_allclose(shares["speed"] * limits.speed_max_m_s, margins["speed_m_s"])
    np.testing.assert_allclose(shares["tilt"] * limits.tilt_max_deg, margins["tilt_deg"])
    np.testing.assert_allclose(shares["jerk"] * limits.jerk_max_m_s3, margins["jerk_m_s3"])
    low, high = limits.thrust_headroom
    nearer = np.minimum(margins["thrust_low"], margins["thrust_high"])
    np.testing.assert_allclose(shares["thrust"] * 0.5 * (high - low), nearer)
    k = int(shares["body rate"].argmin())
    used = np.abs(along.rate_frd[:, k]) / limits.body_rate_max_rad_s
    assert shares["body rate"][k] == pytest.approx(1.0 - used.max())


def test_profile_figures_are_those_of_the_plan(made: Plan) -> None:
    along = profile(VEHICLE, MODEL, from_reference(made.reference), made.reference.yaw_nodes())
    assert along.residual_m_s2 is not None
    assert math.sqrt((along.residual_m_s2**2).mean()) == made.residual_rms_m_s2
    assert along.outside is not None
    np.testing.assert_array_equal(along.outside, along.speed_m_s > 1.5)
    assert along.outside.mean() == made.outside_region


def test_profile_without_a_model_has_no_residual_and_no_region(made: Plan) -> None:
    table = from_reference(made.reference)
    along = profile(VEHICLE, ResidualModel(), table, made.reference.yaw_nodes())
    assert along.residual is along.residual_m_s2 is along.outside is None


def test_sample_times_with_nodes_hold_both_sides_of_every_node(made: Plan) -> None:
    table = from_reference(made.reference)
    at = with_nodes(table)
    assert set(table.times_us) <= set(at)
    assert set(table.times_us[1:] - 1) <= set(at)
    assert np.diff(sample_times(table)).max() <= 10_000.0
