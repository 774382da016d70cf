"""The region that a model's data covers."""

from __future__ import annotations

import numpy as np

from trimtab.host.models.region import Region


def test_region_of_data_holds_all_of_it_and_tells_what_is_beyond():
    rng = np.random.default_rng(0)
    x, thrust = rng.normal(0.0, 0.3, (50, 12)), rng.uniform(4.0, 12.0, 50)
    region = Region.of(x, thrust)
    assert not region.outside(x, thrust).any()
    state = np.zeros((1, 12))
    hover = np.array([7.4])
    assert not region.outside(state, hover).any()
    fast, leaning = state.copy(), state.copy()
    fast[0, 4] = region.speed_max_m_s + 0.01
    leaning[0, 7] = np.deg2rad(region.tilt_max_deg + 0.1)
    for beyond, load in (
        (fast, hover),
        (leaning, hover),
        (state, np.array([region.thrust_max_n + 0.1])),
        (state, np.array([region.thrust_min_n - 0.1])),
    ):
        assert region.outside(beyond, load).all()
