"""Gates and keep-out shapes at all nodes: path rows that depend on the position alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import casadi as ca
import numpy as np

from trimtab.host.codegen.buffered import Buffered
from trimtab.host.codegen.ops import CASADI
from trimtab.host.route.shapes import Shape

GATE_ROWS = 4
"""Rows of a gate: its coordinates q of the position, as `Gate.frame` has them, and q'q."""


class Places:
    """Rows of points, their slopes, and the Hessian of a weighted sum.

    gates: frame and centre at each point, or None. Their rows come first, then the signed distances to
    the shapes. Both are small and differ from problem to problem: CasADi's virtual machine evaluates them.
    """

    def __init__(
        self, gates: Annotated[np.ndarray, "12 points"] | None, shapes: Sequence[Shape], count: int
    ) -> None:
        p, gate = ca.SX.sym("p", 3), ca.SX.sym("gate", 12)
        rows = []
        if gates is not None:
            q = ca.reshape(gate[:9], 3, 3).T @ (p - gate[9:])
            rows += [q, ca.dot(q, q)]
        rows += [shape.signed_distance(CASADI, ca.vertsplit(p)) for shape in shapes]
        value = ca.densify(ca.vertcat(*rows))
        self.rows = value.numel()
        lam = ca.SX.sym("lam", self.rows)
        slope = ca.densify(ca.jacobian(value, p)).T  # row by row
        hessian = ca.densify(ca.hessian(ca.dot(lam, value), p)[0])
        self._first = Buffered(
            ca.Function("first", [p, gate], [value, ca.vec(slope)], ["p", "gate"], ["value", "slope"]).map(
                count
            )
        )
        self._second = Buffered(
            ca.Function("second", [p, gate, lam], [ca.vec(hessian)], ["p", "gate", "lam"], ["hessian"]).map(
                count
            )
        )
        if gates is not None:
            for function in (self._first, self._second):
                function.inputs["gate"][:] = gates.T

    def first(self, p: Annotated[np.ndarray, "points 3"]) -> None:
        """Compute `value` and `slope` at p."""
        self._first.inputs["p"][:] = p
        self._first()

    @property
    def value(self) -> Annotated[np.ndarray, "points rows"]:
        """Values at the points of the last `first`."""
        return self._first.outputs["value"]

    @property
    def slope(self) -> Annotated[np.ndarray, "points rows 3"]:
        """Slopes at the points of the last `first`."""
        return self._first.outputs["slope"].reshape(-1, self.rows, 3)

    def second(
        self, p: Annotated[np.ndarray, "points 3"], lam: Annotated[np.ndarray, "points rows"]
    ) -> Annotated[np.ndarray, "points 3 3"]:
        """Return the Hessians of lam' rows."""
        self._second.inputs["p"][:] = p
        self._second.inputs["lam"][:] = lam
        self._second()
        return self._second.outputs["hessian"].reshape(len(p), 3, 3)
