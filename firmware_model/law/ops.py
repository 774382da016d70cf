"""Operations of the control law: one source serves floats, CasADi symbols and numpy arrays.

A scalar is a float, a casadi.SX or an array with one value for each independent vehicle (lane). Sums,
products and comparisons use Python's operators. Every other operation goes through the `ops` object that is
the first argument. `trimtab.host.codegen.ops` has the instances for CasADi and numpy.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeAlias

Scalar: TypeAlias = Any
"""A float, a casadi.SX or an array of shape (lanes,)."""
Vector: TypeAlias = Sequence[Any]
"""Sequence of scalars: 3 for a vector, 4 for a quaternion (w first), 9 for a matrix (row-major)."""


class Ops(Protocol):
    """Operations that the law needs beyond + - * / and comparisons."""

    @property
    def where(self) -> Callable[[Any, Any, Any], Any]:
        """(condition, a, b) -> a if the condition holds, else b. Both are evaluated and must be finite."""
        ...

    @property
    def minimum(self) -> Callable[[Any, Any], Any]: ...
    @property
    def maximum(self) -> Callable[[Any, Any], Any]: ...
    @property
    def clip(self) -> Callable[[Any, Any, Any], Any]:
        """(x, low, high) -> x limited to low..high."""
        ...

    @property
    def sqrt(self) -> Callable[[Any], Any]: ...
    @property
    def sin(self) -> Callable[[Any], Any]: ...
    @property
    def cos(self) -> Callable[[Any], Any]: ...
    @property
    def tan(self) -> Callable[[Any], Any]: ...
    @property
    def asin(self) -> Callable[[Any], Any]: ...
    @property
    def atan2(self) -> Callable[[Any, Any], Any]: ...
    @property
    def exp(self) -> Callable[[Any], Any]: ...
    @property
    def log(self) -> Callable[[Any], Any]: ...
    @property
    def tanh(self) -> Callable[[Any], Any]: ...
    @property
    def fabs(self) -> Callable[[Any], Any]: ...
    @property
    def floor(self) -> Callable[[Any], Any]: ...


class CheckOps(Ops, Protocol):
    """Operations that the check of a reference needs beyond those of the law."""

    @property
    def acos(self) -> Callable[[Any], Any]: ...
    @property
    def hypot(self) -> Callable[[Any, Any, Any], Any]:
        """(x, y, z) -> length of the vector."""
        ...


class FloatOps:
    """Operations on Python floats."""

    sqrt = staticmethod(math.sqrt)
    sin = staticmethod(math.sin)
    cos = staticmethod(math.cos)
    tan = staticmethod(math.tan)
    asin = staticmethod(math.asin)
    acos = staticmethod(math.acos)
    hypot = staticmethod(math.hypot)
    atan2 = staticmethod(math.atan2)
    exp = staticmethod(math.exp)
    log = staticmethod(math.log)
    tanh = staticmethod(math.tanh)
    fabs = staticmethod(math.fabs)

    @staticmethod
    def where(condition: Any, a: Any, b: Any) -> Any:
        """Return `a` if the condition holds, else `b`."""
        return a if condition else b

    @staticmethod
    def minimum(a: Any, b: Any) -> Any:
        """Return the lesser of two."""
        return a if a < b else b

    @staticmethod
    def maximum(a: Any, b: Any) -> Any:
        """Return the greater of two."""
        return a if a > b else b

    @staticmethod
    def clip(x: Any, low: Any, high: Any) -> Any:
        """Return `x` limited to low..high."""
        return low if x < low else high if x > high else x

    @staticmethod
    def floor(x: Any) -> float:
        """Return the greatest whole number not above `x`, as a float."""
        return float(math.floor(x))


FLOAT: CheckOps = FloatOps()
