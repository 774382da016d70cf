"""How much the predicted residual changes off the reference: against differences and closed forms."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.parts import part
from trimtab.firmware_model.law.rotations import euler_to_matrix, matrix_to_euler
from trimtab.host.codegen import NUMPY
from trimtab.host.effects import load_effects
from trimtab.host.models.airframe import THETA, V
from trimtab.host.models.network import Layout, Network
from trimtab.host.models.residual import residual_acceleration_ned
from trimtab.host.plan import ResidualModel
from trimtab.host.plan.sensitivity import Sensitivity, sensitivity
from trimtab.host.plan.table import flat_states, snap_table
from trimtab.host.vehicle import load_vehicle
from trimtab.protocol.blobs import YawNode

Array = NDArray[np.float64]

VEHICLE = load_vehicle("research")
EFFECTS = load_effects()
TABLE = snap_table(np.array([[0.0, 0.0, -1.2], [2.0, 1.0, -2.0], [0.0, 3.0, -1.5]]), np.array([1.3, 1.4]))
YAWS = (YawNode(0, 0.7, 0.0),)
STEP = 1e-5


def drag(dx: float, dy: float, dz: float) -> ResidualModel:
    return ResidualModel(parts=(part("linear-drag", dx, dy, dz),))


def network(frame: str) -> ResidualModel:
    layout = Layout(hidden=(8, 8), frame="body" if frame == "body" else "world")
    xi = 0.7 * np.random.default_rng(4).standard_normal(layout.size)
    lift = part("quadratic-drag", 0.05)
    return ResidualModel(parts=(lift,), network=Network(layout=layout, xi=xi))


def predicted(model: ResidualModel, x: Array) -> Array:
    """(3,) of one state."""
    value = np.array(residual_acceleration_ned(NUMPY, VEHICLE, model.parts, list(x)), dtype=float)
    if model.network is not None:
        value += model.network.acceleration_ned(x[V, None], x[THETA, None])[:, 0]
    return value


def turned(x: Array, turn: Array) -> Array:
    """The state with its attitude turned by a small rotation vector, FRD: R (I + [turn] + [turn]^2 / 2)."""
    R = np.array(euler_to_matrix(NUMPY, list(x[THETA]))).reshape(3, 3)
    cross = np.array([[0.0, -turn[2], turn[1]], [turn[2], 0.0, -turn[0]], [-turn[1], turn[0], 0.0]])
    out = x.copy()
    out[THETA] = matrix_to_euler(NUMPY, list((R @ (np.eye(3) + cross + 0.5 * cross @ cross)).ravel()))
    return out


@pytest.mark.parametrize("model", [drag(0.5, 0.3, 0.1), network("world"), network("body")])
def test_sensitivity_is_the_greatest_singular_value_of_slopes_by_differences(model: ResidualModel) -> None:
    found = sensitivity(VEHICLE, model, TABLE, YAWS)
    assert found is not None
    x = flat_states(VEHICLE, TABLE, YAWS, TABLE.times_us)
    assert len(found.velocity) == len(found.attitude) == len(TABLE.times_us)
    for k in range(0, x.shape[1], 3):
        by_v, by_turn = np.empty((3, 3)), np.empty((3, 3))
        for axis, step in enumerate(STEP * np.eye(3)):
            away = np.zeros(16)
            away[V] = step
            by_v[:, axis] = predicted(model, x[:, k] + away) - predicted(model, x[:, k] - away)
            by_turn[:, axis] = predicted(model, turned(x[:, k], step)) - predicted(
                model, turned(x[:, k], -step)
            )
        for slopes, value in ((by_v, found.velocity[k]), (by_turn, found.attitude[k])):
            assert np.linalg.svd(slopes / (2.0 * STEP))[1][0] == pytest.approx(value, rel=1e-6, abs=1e-8)


def test_sensitivity_to_velocity_under_linear_drag_is_the_greatest_coefficient() -> None:
    found = sensitivity(VEHICLE, drag(0.5, 0.3, 0.1), TABLE, YAWS)
    assert found is not None
    assert found.velocity == pytest.approx(0.5, abs=1e-12)


def test_equal_drag_on_all_axes_does_not_depend_on_attitude() -> None:
    found = sensitivity(VEHICLE, drag(0.4, 0.4, 0.4), TABLE, YAWS)
    assert found is not None
    assert found.attitude == pytest.approx(0.0, abs=1e-12)


def test_sensitivity_without_a_predicted_residual_is_none() -> None:
    assert sensitivity(VEHICLE, ResidualModel(), TABLE, YAWS) is None
    bias = ResidualModel(parts=(part("torque-bias", 2.0, 1.0, -0.5),))
    assert sensitivity(VEHICLE, bias, TABLE, YAWS) is None


def test_sensitivity_is_nan_only_where_an_effect_has_no_slope() -> None:
    def force(ops: Any, theta: Any, ctx: Any) -> tuple[Any, Any, Any]:
        x, y, z = ctx.v_air_frd
        slowed = -theta[0] * ops.sqrt(x * x + y * y + z * z)
        return slowed * x, slowed * y, slowed * z

    rooted = replace(EFFECTS["linear-drag"], specific_force_frd=force)
    found = sensitivity(
        VEHICLE, ResidualModel(parts=((rooted, part("linear-drag", 0.1, 0.1, 0.1)[1]),)), TABLE, YAWS
    )
    assert found is not None
    assert np.isnan(found.velocity[0])  # at rest
    assert np.isfinite(found.velocity[1:-1]).all()


def test_peaks_name_the_node_and_leave_out_what_has_no_slope() -> None:
    nan = float("nan")
    t_s = np.array([0.0, 0.1, 0.2])
    off = Sensitivity(t_s=t_s, velocity=np.array([nan, 0.2, 0.1]), attitude=np.array([nan, 0.3, 0.9]))
    assert off.to_json() == {
        "velocity": {"greatest_per_s": 0.2, "node": 1, "t_s": 0.1},
        "attitude": {"greatest_m_s2_per_rad": 0.9, "node": 2, "t_s": 0.2},
    }
    nowhere = Sensitivity(t_s=t_s, velocity=np.full(3, nan), attitude=np.full(3, nan))
    assert nowhere.to_json() is None
