"""The network's functions in the prediction: values of the layout, Jacobian, and no network."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from trimtab.host.control.residual_network import network_functions
from trimtab.host.models.network import Frame, Layout, Network

STATE = [1.5, -2.0, 0.4, 0.3, -0.2, 2.5]


@pytest.mark.parametrize("frame", ["world", "body"])
@pytest.mark.parametrize("hidden", [(5,), (8, 8), (7, 6, 5)])
def test_functions_equal_the_layout_and_its_automatic_jacobian(frame: Frame, hidden: tuple[int, ...]) -> None:
    layout = Layout(hidden=hidden, frame=frame)
    network = Network(layout=layout, xi=layout.initial(np.random.default_rng(1)) + 0.05)
    functions = network_functions(network)
    matrices = functions.matrices.call([ca.DM(network.xi)])
    state = ca.MX.sym("state", 6)
    value = layout.matrices(ca.MX(ca.DM(network.xi)), state)
    expected = ca.Function("expected", [state], [value, ca.jacobian(value, state)])(STATE)
    got, slopes = functions.slopes(*matrices, STATE)
    np.testing.assert_allclose(np.array(got), np.array(expected[0]), rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(np.array(slopes), np.array(expected[1]), rtol=0.0, atol=1e-13)
    np.testing.assert_array_equal(np.array(functions.value(*matrices, STATE)), np.array(got))


def test_without_a_network_the_acceleration_is_zero() -> None:
    functions = network_functions(None)
    assert functions.matrices.call([ca.DM(0, 1)]) == []
    value, slopes = functions.slopes(STATE)
    assert (value.shape, slopes.shape) == ((3, 1), (3, 6))
    assert not np.array(value).any()
    assert not np.array(slopes).any()
    assert not np.array(functions.value(STATE)).any()
