"""The law's operations (`firmware_model.law.ops`) on CasADi symbols, `CASADI`, and numpy lanes, `NUMPY`.

`LIBM` has numpy lanes too, with the bits of the law's floats: numpy's own elementary functions differ from
those of the C library in the last bit, on some CPUs only.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np


class CasadiOps:
    """Operations on casadi.SX (or MX) scalars; plain numbers may be mixed in."""

    minimum = staticmethod(ca.fmin)
    maximum = staticmethod(ca.fmax)
    sqrt = staticmethod(ca.sqrt)
    sin = staticmethod(ca.sin)
    cos = staticmethod(ca.cos)
    tan = staticmethod(ca.tan)
    asin = staticmethod(ca.asin)
    atan2 = staticmethod(ca.atan2)
    exp = staticmethod(ca.exp)
    log = staticmethod(ca.log)
    tanh = staticmethod(ca.tanh)
    fabs = staticmethod(ca.fabs)
    floor = staticmethod(ca.floor)

    @staticmethod
    def where(condition: Any, a: Any, b: Any) -> Any:
        """Return `a` where the condition holds, else `b`; both are part of the expression."""
        if isinstance(condition, bool | np.bool_ | int | float):
            return a if condition else b
        return ca.if_else(condition, a, b)

    @staticmethod
    def clip(x: Any, low: Any, high: Any) -> Any:
        """`x` kept within low..high."""
        return ca.fmin(ca.fmax(x, low), high)


class NumpyOps:
    """Operations on arrays of shape (lanes,), one independent value a lane; plain numbers may be mixed in."""

    where = staticmethod(np.where)
    minimum = staticmethod(np.minimum)
    maximum = staticmethod(np.maximum)
    sqrt = staticmethod(np.sqrt)
    sin = staticmethod(np.sin)
    cos = staticmethod(np.cos)
    tan = staticmethod(np.tan)
    asin = staticmethod(np.arcsin)
    atan2 = staticmethod(np.arctan2)
    exp = staticmethod(np.exp)
    log = staticmethod(np.log)
    tanh = staticmethod(np.tanh)
    fabs = staticmethod(np.fabs)
    floor = staticmethod(np.floor)

    @staticmethod
    def clip(x: Any, low: Any, high: Any) -> Any:
        """`x` kept within low..high."""
        return np.minimum(np.maximum(x, low), high)


def _each(function: Callable[..., float]) -> Any:
    """Return the function of floats as a function of arrays of shape (lanes,)."""

    def over(*columns: Any) -> Any:
        values = map(function, *(column.tolist() for column in columns))
        return np.fromiter(values, dtype=float, count=len(columns[0]))

    return staticmethod(over)


class LibmOps(NumpyOps):
    """Operations on arrays of shape (lanes,), each lane with the bits of `FLOAT` for finite values."""

    sin = _each(math.sin)
    cos = _each(math.cos)
    tan = _each(math.tan)
    asin = _each(math.asin)
    acos = _each(math.acos)
    hypot = _each(math.hypot)
    atan2 = _each(math.atan2)
    exp = _each(math.exp)
    log = _each(math.log)
    tanh = _each(math.tanh)


CASADI = CasadiOps()
NUMPY = NumpyOps()
LIBM = LibmOps()
