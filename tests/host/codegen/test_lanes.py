"""Functions as C over lanes: products in place of quotients, and what is computed once."""

from __future__ import annotations

import casadi
import numpy as np
import pytest

from trimtab.host.codegen.compiler import find_compiler
from trimtab.host.codegen.lanes import lane_source
from trimtab.host.codegen.simd import aligned, lane_count, pointer, simd_library


def quotients() -> casadi.Function:
    """Return a function of x and of a theta that stays constant, with quotients of every kind."""
    x, theta = casadi.SX.sym("x", 3), casadi.SX.sym("theta", 2)
    size = casadi.sqrt(x[0] ** 2 + 1.0)
    lag = 0.03 + theta[0] ** 2
    outputs = casadi.vertcat(
        x[0] / 3.0,
        x[1] / lag + 1.0 / lag,
        (x[0] + x[2]) / size - x[1] / size,
        x[2] / (2.0 + x[1] ** 2),
        lag,
        theta[1],
        4.0,
    )
    return casadi.Function("quotients", [x, theta], [outputs], ["x", "theta"], ["out"], {"cse": True})


def body(source: str, name: str) -> str:
    return source.split(f"void {name}(")[1].split("\n}")[0]


def test_quotients_by_one_value_take_one_division() -> None:
    source = lane_source(quotients(), "evaluate", ["theta"])
    # 1 / size, and one quotient by a value that occurs once.
    assert body(source, "evaluate").count(" / ") == 2
    assert body(source, "evaluate_constants").count(" / ") == 1
    assert body(lane_source(quotients(), "evaluate"), "evaluate").count(" / ") == 3


def test_constants_are_what_the_constant_inputs_give() -> None:
    source = lane_source(quotients(), "evaluate", ["theta"])
    assert "#define EVALUATE_CONSTANTS 2\n" in source  # lag and 1 / lag
    assert "i0[" not in body(source, "evaluate_constants")
    assert "#define EVALUATE_CONSTANTS 1\n" in lane_source(casadi_sum(), "evaluate", ["theta"])


def casadi_sum() -> casadi.Function:
    """Return a function in which nothing depends on the constant input alone."""
    x, theta = casadi.SX.sym("x"), casadi.SX.sym("theta")
    return casadi.Function("total", [x, theta], [x + theta], ["x", "theta"], ["out"])


@pytest.mark.parametrize("constant", [(), ("theta",), ("x", "theta")])
def test_values_are_those_of_casadi(constant: tuple[str, ...], require) -> None:
    require("compiler")
    compiler = find_compiler()
    assert compiler is not None
    function = quotients()
    source = lane_source(function, "evaluate", constant)
    inputs = ", ".join({"x": "a", "theta": "b"}[name] for name in constant)
    once = f"V c[EVALUATE_CONSTANTS]; evaluate_constants({inputs}, c);" if constant else ""
    call = "evaluate(a, b, out, c);" if constant else "evaluate(a, b, out);"
    source += f"void run(const V *a, const V *b, V *out) {{ {once} {call} }}"
    library = simd_library(source, compiler)
    width = lane_count(library)
    rng = np.random.default_rng(3)
    arrays = [aligned((size, width)) for size in (3, 2, 7)]
    for array in arrays[:2]:
        array[:] = rng.standard_normal(array.shape)
    library.run(*map(pointer, arrays))
    for lane in range(width):
        expected = np.array(function(arrays[0][:, lane], arrays[1][:, lane])).ravel()
        np.testing.assert_allclose(arrays[2][:, lane], expected, rtol=1e-14)


def test_an_operation_without_a_counterpart_is_refused() -> None:
    x = casadi.SX.sym("x")
    function = casadi.Function("erf", [x], [casadi.erf(x)])
    with pytest.raises(ValueError, match=r"erf: operation [0-9]+ has no counterpart over lanes"):
        lane_source(function, "evaluate")
