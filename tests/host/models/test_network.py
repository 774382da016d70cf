"""One network in three forms, and its derivative."""

from __future__ import annotations

import casadi
import numpy as np
import pytest

from trimtab.firmware_model.law.ops import FLOAT
from trimtab.host.models.network import Layout, Network


@pytest.mark.parametrize("hidden", [(32, 32), (32, 32, 32), (5,)])
def test_network_three_forms_agree(hidden):
    layout = Layout(hidden=hidden)
    rng = np.random.default_rng(0)
    xi = layout.initial(rng) + 0.1 * rng.standard_normal(layout.size)
    inputs = rng.standard_normal((6, 7))
    arrays = layout.arrays(xi, inputs)
    weights, columns = casadi.MX.sym("xi", layout.size), casadi.MX.sym("u", 6, 7)
    matrices = casadi.Function("net", [weights, columns], [layout.matrices(weights, columns)])
    np.testing.assert_allclose(np.array(matrices(xi, inputs)), arrays, rtol=1e-12, atol=1e-13)
    for lane in range(7):
        scalars = layout.scalars(FLOAT, xi.tolist(), inputs[:, lane].tolist())
        np.testing.assert_allclose(scalars, arrays[:, lane], rtol=1e-12, atol=1e-13)


def test_layout_size_three_by_32_fits_the_block_on_board():
    assert Layout(hidden=(32, 32)).size == 1379
    assert Layout(hidden=(32, 32, 32)).size == 2435


def test_layout_initial_starts_near_zero():
    layout = Layout(hidden=(32, 32))
    out = layout.arrays(layout.initial(np.random.default_rng(1)), np.ones((6, 1)))
    assert np.abs(out).max() < 0.5


def test_network_wrong_or_infinite_weights_are_refused():
    layout = Layout(hidden=(4,))
    with pytest.raises(ValueError, match="has 43 weights"):
        Network(layout=layout, xi=np.zeros(3))
    with pytest.raises(ValueError, match="finite"):
        Network(layout=layout, xi=np.full(layout.size, np.nan))
    with pytest.raises(ValueError, match="hidden layers"):
        Layout(hidden=())
    network = Network(layout=layout, xi=np.zeros(layout.size))
    with pytest.raises(ValueError, match="read-only"):
        network.xi[0] = 1.0


def test_network_whole_turns_of_yaw_do_not_count():
    layout = Layout(hidden=(6,))
    xi = layout.initial(np.random.default_rng(3)) * 10.0
    inputs = np.random.default_rng(4).standard_normal((6, 5))
    turned = inputs + np.array([[0.0], [0.0], [0.0], [0.0], [0.0], [2.0 * np.pi]])
    np.testing.assert_allclose(layout.arrays(xi, turned), layout.arrays(xi, inputs), atol=1e-12)
