"""A function over lanes computes what CasADi computes, lane by lane, in C or without it."""

from __future__ import annotations

import casadi
import numpy as np
import pytest

from trimtab.host.codegen.batch import Batch
from trimtab.host.codegen.compiler import find_compiler
from trimtab.host.codegen.lanes import lane_source
from trimtab.host.codegen.simd import aligned, lane_count, lanes_of, pointer, simd_library


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
    return casadi.Function("every", [x, u], [first, second], ["x", "u"], ["first", "second"], {"cse": True})


def in_c(function: casadi.Function, inputs: list[np.ndarray]) -> list[np.ndarray]:
    """Return the outputs (rows, lanes) of the function over one group of lanes in C."""
    compiler = find_compiler()
    assert compiler is not None
    names = "abcd"[: function.n_in() + function.n_out()]
    source = lane_source(function, "evaluate")
    source += f"void run({', '.join(f'V *{name}' for name in names)}) {{ evaluate({', '.join(names)}); }}"
    library = simd_library(source, compiler)
    width = lane_count(library)
    arrays = [lanes_of(array[:, :width].T, width)[0] for array in inputs]
    arrays += [aligned((function.size1_out(i), width)) for i in range(function.n_out())]
    library.run(*map(pointer, arrays))
    return arrays[function.n_in() :]


def test_every_operation_in_c_equals_casadi(require):
    require("compiler")
    function = every_operation()
    rng = np.random.default_rng(1)
    inputs = [rng.standard_normal((size, 8)) for size in (4, 2)]
    outputs = in_c(function, inputs)
    for lane in range(outputs[0].shape[1]):
        expected = function(*(array[:, lane] for array in inputs))
        for got, want in zip(outputs, expected, strict=True):
            np.testing.assert_allclose(got[:, lane], np.array(want).ravel(), rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("lanes", [1, 7, 8, 19])
def test_batch_every_operation_equals_casadi(lanes):
    function = every_operation()
    batch = Batch(function, lanes)
    rng = np.random.default_rng(1)
    for name, array in batch.inputs.items():
        array[:] = rng.standard_normal(array.shape)
        assert array.shape[1] == lanes, name
    batch()
    for lane in range(lanes):
        expected = function(batch.inputs["x"][:, lane], batch.inputs["u"][:, lane])
        for got, want in zip(batch.outputs.values(), expected, strict=True):
            np.testing.assert_allclose(got[:, lane], np.array(want).ravel(), rtol=1e-13, atol=1e-14)


def test_batch_has_the_same_bits_for_any_number_of_lanes():
    x = np.random.default_rng(2).standard_normal((4, 20))
    results = []
    for lanes in (3, 20):
        batch = Batch(every_operation(), lanes)
        batch.inputs["x"][:] = x[:, :lanes]
        batch()
        results.append(batch.outputs["first"][:, :3].copy())
    assert results[0].tobytes() == results[1].tobytes()


def test_two_batches_do_not_share_arrays():
    function = every_operation()
    one, two = Batch(function, 9), Batch(function, 9)
    one.inputs["u"][:] = 5.0
    two()
    assert not two.inputs["u"].any()
    assert two.outputs["second"][1].tolist() == [7.0] * 9


def test_batch_of_a_matrix_input_is_refused():
    x = casadi.SX.sym("x", 2, 2)
    function = casadi.Function("f", [x], [x[0, 0]], ["x"], ["y"])
    with pytest.raises(ValueError, match="input x of f is not a dense column"):
        Batch(function, 3)


def test_batch_of_no_lanes_is_refused():
    with pytest.raises(ValueError, match="at least 1"):
        Batch(every_operation(), 0)
