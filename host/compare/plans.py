"""Two plans compared by their figures."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.host.plan.files import read_course, read_predicted_error_m
from trimtab.host.plan.judge import obstacle_margins, passings
from trimtab.host.plan.profile import sample_times
from trimtab.host.plan.table import from_reference
from trimtab.host.show.plans import plan_facts, profile_of
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import Reference

FIGURES = (
    "duration_s",
    "path_length_m",
    "speed_max_m_s",
    "tilt_max_deg",
    "thrust_share_max",
    "clearance_m",
    "predicted_error_max_m",
)
"""Figures of a plan that are compared."""


@dataclass(frozen=True, kw_only=True)
class PlanFigures:
    """Figures of one plan.

    file, id, vehicle: file, id of the reference, name of the vehicle, None if it is not known.
    tilt_max_deg, thrust_share_max: of the nominal vehicle; None if the vehicle is not known.
    clearance_m: least distance from keep-out shapes and inside gates; None if the route is not known or has
    none. predicted_error_max_m: greatest tracking error that the model of the plan predicted; None without a
    model or record.
    """

    file: str
    id: str
    vehicle: str | None
    duration_s: float
    path_length_m: float
    speed_max_m_s: float
    tilt_max_deg: float | None
    thrust_share_max: float | None
    clearance_m: float | None
    predicted_error_max_m: float | None

    def to_dict(self) -> dict[str, Any]:
        """Return the figures as plain data for JSON."""
        return {spec.name: getattr(self, spec.name) for spec in fields(self)}


@dataclass(frozen=True, kw_only=True)
class PlansComparison:
    """Two plans. same: whether they are the same reference."""

    a: PlanFigures
    b: PlanFigures

    @property
    def same(self) -> bool:
        """Whether both are the same reference."""
        return self.a.id == self.b.id

    @property
    def differences(self) -> dict[str, float | None]:
        """The figures of b minus those of a; None where one is absent."""
        pairs = {name: (getattr(self.a, name), getattr(self.b, name)) for name in FIGURES}
        return {name: None if a is None or b is None else b - a for name, (a, b) in pairs.items()}

    def to_dict(self) -> dict[str, Any]:
        """Return the comparison as plain data for JSON."""
        return {
            "a": self.a.to_dict(),
            "b": self.b.to_dict(),
            "same": self.same,
            "differences": self.differences,
        }


def plan_figures(reference: Reference, path: Path, vehicle: Vehicle | None) -> PlanFigures:
    """Return the figures of a reference and of the record beside it. vehicle: None if it is not known."""
    course = read_course(path, reference.id)
    facts = plan_facts(reference, path, None, None)
    table = from_reference(reference)
    along = None if vehicle is None else profile_of(reference, vehicle, sample_times(table))
    margins: dict[str, float] = {}
    if course is not None:
        route, times_s = course
        margins = obstacle_margins(table, route.keep_out, passings(route, times_s))
    return PlanFigures(
        file=str(path),
        id=reference.id,
        vehicle=None if vehicle is None else vehicle.name,
        duration_s=facts["duration_s"],
        path_length_m=facts["path_length_m"],
        speed_max_m_s=facts["speed_max_m_s"],
        tilt_max_deg=None if along is None else float(np.max(along.tilt_deg)),
        thrust_share_max=None if along is None else float(np.max(along.thrust_share)),
        clearance_m=min(margins.values(), default=None),
        predicted_error_max_m=read_predicted_error_m(path, reference.id),
    )
