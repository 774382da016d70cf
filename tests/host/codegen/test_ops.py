"""The operations on CasADi and numpy mean what the floats' mean, plain numbers mixed in."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from trimtab.firmware_model.law.ops import FLOAT
from trimtab.host.codegen.ops import CASADI, LIBM, NUMPY

UNARY = ("sqrt", "sin", "cos", "tan", "asin", "exp", "log", "tanh", "fabs", "floor")
BINARY = ("minimum", "maximum", "atan2")
X = np.linspace(0.05, 0.95, 19)
Y = X[::-1] - 0.3


def _symbolic(fn):
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    return np.array(ca.Function("f", [x, y], [fn(x, y)])(X[None], Y[None])).ravel()


@pytest.mark.parametrize("name", UNARY)
def test_unary_operation_agrees_in_every_number_type(name):
    expected = [getattr(FLOAT, name)(x) for x in X]
    assert getattr(NUMPY, name)(X) == pytest.approx(expected, rel=1e-15)
    assert _symbolic(lambda x, _: getattr(CASADI, name)(x)) == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize("name", BINARY)
def test_binary_operation_agrees_in_every_number_type(name):
    expected = [getattr(FLOAT, name)(x, y) for x, y in zip(X, Y, strict=True)]
    assert getattr(NUMPY, name)(X, Y) == pytest.approx(expected, rel=1e-15)
    assert _symbolic(getattr(CASADI, name)) == pytest.approx(expected, rel=1e-15)


def test_where_and_clip_choose_by_value_in_every_number_type():
    def fn(ops, x, y):
        return ops.where(x < y, ops.clip(x, 0.2, 0.4), -y)

    expected = [fn(FLOAT, x, y) for x, y in zip(X, Y, strict=True)]
    assert fn(NUMPY, X, Y) == pytest.approx(expected)
    assert _symbolic(lambda x, y: fn(CASADI, x, y)) == pytest.approx(expected)


@pytest.mark.parametrize("ops", [FLOAT, CASADI, NUMPY])
def test_plain_numbers_stay_plain(ops):
    assert float(ops.where(True, 1.0, 2.0)) == 1.0
    assert float(ops.where(1.0 > 2.0, 1.0, 2.0)) == 2.0
    assert float(ops.minimum(1.0, 2.0)) == 1.0
    assert float(ops.clip(3.0, 0.0, 1.0)) == 1.0
    assert not isinstance(ops.sin(0.5), ca.SX)


def test_where_of_casadi_keeps_the_other_branch_out_of_the_result():
    """A branch that is not finite does not spoil the one chosen."""
    x = ca.SX.sym("x")
    f = ca.Function("f", [x], [CASADI.where(x > 0.0, 1.0 / x, 0.0)])
    assert float(f(0.0)) == 0.0


LANES = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 4000))


@pytest.mark.parametrize("name", ["sin", "cos", "tan", "asin", "acos", "exp", "tanh", "fabs", "floor"])
def test_unary_operation_of_libm_has_the_bits_of_floats(name):
    assert getattr(LIBM, name)(LANES[0]).tolist() == [getattr(FLOAT, name)(x) for x in LANES[0].tolist()]


@pytest.mark.parametrize(("name", "count"), [("atan2", 2), ("minimum", 2), ("maximum", 2), ("hypot", 3)])
def test_operation_of_libm_on_several_numbers_has_the_bits_of_floats(name, count):
    expected = [getattr(FLOAT, name)(*lane) for lane in LANES[:count].T.tolist()]
    assert getattr(LIBM, name)(*LANES[:count]).tolist() == expected


@pytest.mark.parametrize("name", ["log", "sqrt"])
def test_operation_of_libm_on_positive_numbers_has_the_bits_of_floats(name):
    lane = np.abs(LANES[0])
    assert getattr(LIBM, name)(lane).tolist() == [getattr(FLOAT, name)(x) for x in lane.tolist()]
