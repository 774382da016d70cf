"""Kinds and settings of a plan, the plan itself, and its errors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from trimtab.firmware_model.law.reference_verdict import ReferenceVerdict
from trimtab.host.base.card import card, table
from trimtab.host.base.errors import Refused, SolverError, UsageError
from trimtab.host.plan.dynamics import Minimised, Weights
from trimtab.host.route import Route
from trimtab.host.shooting.problem import SolveStatus
from trimtab.host.vehicle import Limits
from trimtab.protocol.blobs import Reference

if TYPE_CHECKING:
    from trimtab.host.plan.sensitivity import Sensitivity

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

    Attributes
    ----------
    reference
        What a vehicle follows: nodes with position, velocity, acceleration and jerk, NED, SI. `sample` gives
        it at any time.
    route
        The route as asked for.
    kind, augmented
        Kind of plan, and whether the model is part of the dynamics.
    status
        Status of the solver.
    duration_s
        Duration, s.
    waypoint_times_s
        Time at which each waypoint is passed, s.
    limits
        Limits that judged it: those of vehicle, route and headroom together.
    margins
        Least distance to each limit over the whole reference, by name, in the unit of the limit.
    clearance_m
        Distance that the path had to keep from keep-out shapes and the edges of gates, m; None without any.
    predicted_error_max_m
        Greatest tracking error that the model predicts for the law without feed-forward, m; 0 without a
        model.
    residual_rms_m_s2
        Residual that the model predicts along the plan, RMS, m/s^2; None without a model.
    outside_region
        Share of the plan outside the model's trained region; None where that is not known.
    path_length_m, mean_speed_m_s
        Length of the path, m, and mean speed, m/s.
    deviation_m
        Greatest distance from the solver's path, m; None for min-snap.
    stretch
        Factor on the route's time.
    lambda_r
        The paper's weight of control effort (eq. 10), of the squared rotor thrusts in N^2 beside the squared
        residual in m^2/s^4, or the squared error in its unit; None for kinds with neither.
    intervals, rounds, iterations
        Intervals of the shooting problem, number of solves, and iterations of all of them.
    solve_s, first_solve_s
        Processor time, s, and that of the first round's solver on all its grids, None for min-snap. Only
        these two vary from run to run.
    sensitivity
        Change of the predicted residual off the reference; None without a predicted residual.
    model_verdict
        Verdict of the model's assessment; None without one.
    provenance
        What `write_plan` records: version, command, ids of vehicle, route and model.
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
    sensitivity: Sensitivity | None = None
    model_verdict: str | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """The kind as the paper writes it, with a star for augmented dynamics."""
        return label(self.kind, self.augmented)

    def figures(self) -> dict[str, Any]:
        """Return the figures that say how good the plan is, as plain data."""
        return {
            "kind": self.kind,
            "augmented": self.augmented,
            "status": self.status,
            "duration_s": self.duration_s,
            "waypoint_times_s": list(self.waypoint_times_s),
            "margins": dict(self.margins),
            "clearance_m": self.clearance_m,
            "predicted_error_max_m": self.predicted_error_max_m,
            "residual_rms_m_s2": self.residual_rms_m_s2,
            "outside_region": self.outside_region,
            "path_length_m": self.path_length_m,
            "mean_speed_m_s": self.mean_speed_m_s,
            "deviation_m": self.deviation_m,
            "stretch": self.stretch,
            "nodes": len(self.reference.nodes),
            "intervals": self.intervals,
            "rounds": self.rounds,
            "iterations": self.iterations,
            "solve_s": self.solve_s,
        }

    def to_dict(
        self, *, path: Path | str | None = None, report_path: Path | str | None = None
    ) -> dict[str, Any]:
        """Return the object that `trimtab plan --json` prints, as plain data.

        path, report_path: files that were written; None for a file that was not.
        """
        return {
            "reference": None if path is None else str(path),
            "id": self.reference.id,
            "model_verdict": self.model_verdict,
            **self.figures(),
            "sensitivity": None if self.sensitivity is None else self.sensitivity.to_json(),
            "report": None if report_path is None else str(report_path),
        }

    def __repr__(self) -> str:
        return f"<Plan {self.route.name}, {self.label}, {self.duration_s:.2f} s, id {self.reference.id}>"

    def _repr_html_(self) -> str:
        clearance_m, residual = self.clearance_m, self.residual_rms_m_s2
        return card(
            f"Plan {self.route.name}",
            [
                ("kind", self.label),
                ("status", self.status),
                ("duration", f"{self.duration_s:.2f} s"),
                ("path", f"{self.path_length_m:.2f} m, {self.mean_speed_m_s:.2f} m/s on average"),
                ("clearance", None if clearance_m is None else f"{clearance_m:.3f} m"),
                ("predicted residual, RMS", None if residual is None else f"{residual:.3f} m/s^2"),
                ("reference", self.reference.id),
            ],
            table(("limit", "least distance"), self.margins.items()),
        )


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
