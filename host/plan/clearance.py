"""Distances to keep-out shapes over all nodes: path rows of their own, beside those of the vehicle."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from host.codegen.buffered import Buffered
from host.codegen.ops import CASADI
from host.route.shapes import Shape

Array = NDArray[np.float64]


class Clearance:
    """Signed distances of N points to shapes, their slopes, and the Hessian of a weighted sum.

    The shapes are another problem's another time, and small: CasADi's virtual machine evaluates them.
    """

    def __init__(self, shapes: Sequence[Shape], count: int) -> None:
        self.rows = len(shapes)
        p, lam = ca.SX.sym("p", 3), ca.SX.sym("lam", self.rows)
        position = ca.vertsplit(p)
        distance = ca.densify(ca.vertcat(*(shape.signed_distance(CASADI, position) for shape in shapes)))
        slope = ca.densify(ca.jacobian(distance, p)).T  # row by row
        bend = ca.densify(ca.hessian(ca.dot(lam, distance), p)[0])
        self._first = Buffered(
            ca.Function("first", [p], [distance, ca.vec(slope)], ["p"], ["distance", "slope"]).map(count)
        )
        self._second = Buffered(
            ca.Function("second", [p, lam], [ca.vec(bend)], ["p", "lam"], ["bend"]).map(count)
        )

    def first(self, p: Array) -> tuple[Array, Array]:
        """Distances (N, rows) and their slopes (N, rows, 3) at p (N, 3)."""
        self._first.inputs["p"][:] = p
        self._first()
        distance, slope = self._first.outputs["distance"], self._first.outputs["slope"]
        return distance, slope.reshape(len(p), self.rows, 3)

    def second(self, p: Array, lam: Array) -> Array:
        """(N, 3, 3) Hessians of lam' distance; lam (N, rows)."""
        self._second.inputs["p"][:] = p
        self._second.inputs["lam"][:] = lam
        self._second()
        return self._second.outputs["bend"].reshape(len(p), 3, 3)
