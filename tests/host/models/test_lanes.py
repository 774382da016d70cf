"""A lane program computes what CasADi computes, lane by lane."""

from __future__ import annotations

import casadi
import numpy as np
import pytest

from trimtab.host.models.lanes import FEW, lane_program


def every_operation() -> casadi.Function:
    x = casadi.SX.sym("x", 4)
    u = casadi.SX.sym("u", 2)
    a, b, c, d = (x[i] for i in range(4))
    small = casadi.tanh(a) * 0.9
    first = casadi.vertcat(
        casadi.sin(a) + casadi.cos(b) * casadi.tan(small) - casadi.exp(-c * c) / (1 + d**2),
        casadi.sqrt(1 + a * a) * casadi.log(2 + b * b) + casadi.fabs(c) + casadi.floor(d),
        casadi.asin(small) + casadi.acos(small) + casadi.atan(a) + casadi.atan2(b, c),
        casadi.if_else(a < b, c, d) + casadi.if_else(casadi.logic_and(a > 0, b > 0), 1, -c),
        casadi.fmin(a, b) + casadi.fmax(c, d) + casadi.sign(a) + a**3 + casadi.fabs(b) ** 1.5,
        casadi.sinh(small) + casadi.cosh(small) + 1 / (2 + casadi.sin(b)) + 2 * a,
    )
    second = casadi.vertcat(u[0] * a, 7.0, u[1])
    return casadi.Function("every", [x, u], [first, second], ["x", "u"], ["first", "second"])


@pytest.mark.parametrize("lanes", [1, 5, FEW, FEW + 1])
def test_lane_program_every_operation_equals_casadi(lanes):
    function = every_operation()
    bound = lane_program(function).bind(lanes)
    rng = np.random.default_rng(1)
    for name, array in bound.inputs.items():
        array[:] = rng.standard_normal(array.shape)
        assert array.shape[1] == lanes, name
    bound()
    for lane in range(lanes):
        expected = function(bound.inputs["x"][:, lane], bound.inputs["u"][:, lane])
        for got, want in zip(bound.outputs.values(), expected, strict=True):
            np.testing.assert_allclose(got[:, lane], np.array(want).ravel(), rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("lanes", [3, FEW])
def test_compiled_lanes_have_the_same_bits_as_the_virtual_machine(lanes):
    program = lane_program(every_operation())
    interpreted, compiled = program.bind(lanes), program.bind(lanes, compiled=True)
    rng = np.random.default_rng(2)
    for name, array in interpreted.inputs.items():
        array[:] = rng.standard_normal(array.shape)
        compiled.inputs[name][:] = array
    interpreted()
    compiled()
    for name, array in interpreted.outputs.items():
        assert array.tobytes() == compiled.outputs[name].tobytes(), name


@pytest.mark.parametrize("lanes", [3, FEW + 3])
def test_lane_program_two_bindings_do_not_share_arrays(lanes):
    program = lane_program(every_operation())
    one, two = program.bind(lanes), program.bind(lanes)
    one.inputs["u"][:] = 5.0
    two()
    assert not two.inputs["u"].any()
    assert two.outputs["second"][1].tolist() == [7.0] * lanes


def test_lane_program_common_subexpressions_are_computed_once():
    x = casadi.SX.sym("x")
    function = casadi.Function("f", [x], [casadi.sin(x) ** 2 + casadi.sin(x)], ["x"], ["y"])
    assert lane_program(function).operations == 4


def test_lane_program_matrix_input_is_refused():
    x = casadi.SX.sym("x", 2, 2)
    function = casadi.Function("f", [x], [x[0, 0]], ["x"], ["y"])
    with pytest.raises(ValueError, match="not a dense column"):
        lane_program(function)


def test_lanes_none_is_refused():
    with pytest.raises(ValueError, match="at least 1"):
        lane_program(every_operation()).bind(0)
