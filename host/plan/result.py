"""Kinds and settings of a plan, the plan itself, and its errors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from trimtab.firmware_model.law.reference_verdict import ReferenceVerdict
from trimtab.host.base.errors import Refused, SolverError, UsageError
from trimtab.host.plan.dynamics import Minimised, Weights
from trimtab.host.route import Route
from trimtab.host.shooting.problem import SolveStatus
from trimtab.host.vehicle import Limits
from trimtab.protocol.blobs import Reference

Kind = Literal["min-snap", "min-control", "min-residual", "min-error", "min-control-r"]
KINDS: Mapping[str, tuple[Kind, bool]] = {
    "min-snap": ("min-snap", False),
    "min-control": ("min-control", False),
    "min-residual": ("min-residual", False),
    "min-control*": ("min-control", True),
    "min-residual*": ("min-residual", True),
    "min-control-r": ("min-control-r", True),
    "min-error": ("min-error", False),
}
"""Kind and whether its dynamics are augmented, by name. The names are the paper's, except for min-error."""
MINIMISED: Mapping[Kind, Minimised] = {"min-residual": "residual", "min-error": "error"}
"""What a kind minimises of what the model predicts; other kinds do not ask the model."""


def parse_kind(text: str) -> tuple[Kind, bool]:
    """Return the kind, and whether its dynamics are augmented, of a name in KINDS. Raises UsageError."""
    if text not in KINDS:
        raise UsageError(f"{text}: no such kind of plan, known: {', '.join(KINDS)}")
    return KINDS[text]


def label(kind: Kind, augmented: bool) -> str:
    """Return the name in KINDS of a kind."""
    return next(text for text, known in KINDS.items() if known == (kind, augmented))


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of the shooting problem; the defaults were measured.

    relative_weights: weights are in units of the mean squared residual along the min-snap path (at least
    0.5 m/s^2 squared), so that a small drag is avoided as thoroughly as a large one; False takes them as they
    are. step_box: bounds of a step in units of its nominal value. total_time_box: bounds of the total time in
    units of the route's. tolerance: of constraints and optimality.
    rounds: how often the problem may be solved, each time in a tighter box.
    """

    weights: Weights = field(default_factory=Weights)
    relative_weights: bool = True
    step_box: tuple[float, float] = (0.7, 1.4)
    total_time_box: tuple[float, float] = (1.0, 1.0)
    tolerance: float = 1e-3
    iterations_max: int = 300
    rounds: int = 12

    def __post_init__(self) -> None:
        for name in ("step_box", "total_time_box"):
            low, high = getattr(self, name)
            if not (0.0 < low <= 1.0 <= high and math.isfinite(high)):
                raise ValueError(f"{name} {(low, high)} must be positive and hold 1")
        if self.iterations_max < 1 or self.rounds < 1:
            raise ValueError("iterations_max and rounds must be at least 1")
        if not 0.0 < self.tolerance < 1.0:
            raise ValueError(f"tolerance must be within 0..1, not {self.tolerance!r}")


@dataclass(frozen=True, kw_only=True)
class Plan:
    """A checked reference and its figures.

    route: as asked for. kind, augmented: as of `parse_kind`. limits: those that judged it, of vehicle, route
    and headroom together. margins: least distance to each limit over the whole reference. clearance_m:
    distance that the path had to keep from keep-out shapes and the edges of gates, None without any.
    predicted_error_max_m: largest tracking error that the model predicts for the law without feed-forward, 0
    without a model. residual_rms_m_s2: predicted along it, None without a model. outside_region: share of it
    outside the trained region, None where that is not known. deviation_m: largest distance from the solver's
    path, None for min-snap. stretch: factor on the route's time. lambda_r: the paper's weight of control
    effort (eq. 10), of the squared rotor thrusts in N^2 beside the squared residual in m^2/s^4, or the
    squared error in its unit; None for kinds with neither. intervals: of the shooting problem. rounds: number
    of solves. solve_s: processor time. first_solve_s: time of the first round's solver on all its grids, None
    for min-snap. Only these two vary from run to run.
    """

    reference: Reference
    route: Route
    kind: Kind
    augmented: bool
    status: str
    duration_s: float
    waypoint_times_s: tuple[float, ...]
    limits: Limits
    margins: Mapping[str, float]
    clearance_m: float | None
    predicted_error_max_m: float
    residual_rms_m_s2: float | None
    outside_region: float | None
    path_length_m: float
    mean_speed_m_s: float
    deviation_m: float | None
    stretch: float
    lambda_r: float | None
    intervals: int
    rounds: int
    iterations: int
    solve_s: float
    first_solve_s: float | None

    @property
    def label(self) -> str:
        """The kind as the paper writes it, with a star for augmented dynamics."""
        return label(self.kind, self.augmented)


class PlanRefused(Refused):
    """No reference keeps the limits; `verdict` says where the nearest one breaks them, None without any."""

    def __init__(self, message: str, verdict: ReferenceVerdict | None = None) -> None:
        super().__init__(message)
        self.verdict = verdict


class PlanUnsolved(SolverError):
    """The solver gave up; `status` says why."""

    def __init__(self, message: str, status: SolveStatus) -> None:
        super().__init__(message)
        self.status = status
