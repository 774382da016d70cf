"""Keep-out shapes of a route, which its path must not enter; metres in NED.

`signed_distance` is written in the law's `ops` style: the same source checks a float and constrains a plan.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from trimtab.firmware_model.law.ops import Ops
from trimtab.host.vehicle.model import Interval, Positive, Vector3
from trimtab.host.vehicle.strict_toml import Strict


class Box(Strict):
    """An axis-aligned box."""

    kind: Literal["box"]
    min_m: Vector3
    max_m: Vector3

    @model_validator(mode="after")
    def _min_below_max(self) -> Self:
        if not all(low < high for low, high in zip(self.min_m, self.max_m, strict=True)):
            raise ValueError("min_m is not below max_m on every axis, swap or mend them")
        return self

    def signed_distance(self, ops: Ops, p_ned: Sequence[Any]) -> Any:
        """Return the distance from the surface, m; negative inside."""
        gaps = [
            ops.fabs(p - 0.5 * (low + high)) - 0.5 * (high - low)
            for p, low, high in zip(p_ned, self.min_m, self.max_m, strict=True)
        ]
        return _from_gaps(ops, gaps)


class Sphere(Strict):
    """A sphere."""

    kind: Literal["sphere"]
    centre_m: Vector3
    radius_m: Positive

    def signed_distance(self, ops: Ops, p_ned: Sequence[Any]) -> Any:
        """Return the distance from the surface, m; negative inside."""
        return _norm(ops, [p - c for p, c in zip(p_ned, self.centre_m, strict=True)]) - self.radius_m


class Cylinder(Strict):
    """An upright cylinder, from down_m[0] to down_m[1]; up is negative down."""

    kind: Literal["cylinder"]
    centre_m: tuple[float, float]
    radius_m: Positive
    down_m: Interval

    def signed_distance(self, ops: Ops, p_ned: Sequence[Any]) -> Any:
        """Return the distance from the surface, m; negative inside."""
        radial = _norm(ops, [p_ned[0] - self.centre_m[0], p_ned[1] - self.centre_m[1]]) - self.radius_m
        low, high = self.down_m
        return _from_gaps(ops, [radial, ops.fabs(p_ned[2] - 0.5 * (low + high)) - 0.5 * (high - low)])


Shape = Annotated[Box | Sphere | Cylinder, Field(discriminator="kind")]


def grown(shape: Shape, by_m: float) -> Shape:
    """Return the shape of the same kind that holds every point within `by_m` of the given one."""
    if isinstance(shape, Box):
        low, high = (
            [value + sign * by_m for value in end] for sign, end in ((-1, shape.min_m), (1, shape.max_m))
        )
        return shape.model_copy(update={"min_m": tuple(low), "max_m": tuple(high)})
    update: dict[str, Any] = {"radius_m": shape.radius_m + by_m}
    if isinstance(shape, Cylinder):
        top, bottom = shape.down_m
        update["down_m"] = (top - by_m, bottom + by_m)
    return shape.model_copy(update=update)


_TINY = 1e-12
"""Added under roots to keep derivatives finite on an axis; changes a distance by less than 1e-6 m."""


def _norm(ops: Ops, vector: Sequence[Any]) -> Any:
    """Return the length of a vector."""
    return ops.sqrt(sum(v * v for v in vector) + _TINY)


def _from_gaps(ops: Ops, gaps: Sequence[Any]) -> Any:
    """Return the signed distance to a product of intervals, from the signed distance along each axis."""
    outside = _norm(ops, [ops.maximum(gap, 0.0) for gap in gaps])
    deepest = gaps[0]
    for gap in gaps[1:]:
        deepest = ops.maximum(deepest, gap)
    return outside + ops.minimum(deepest, 0.0)
