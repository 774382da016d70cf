"""The trade between residual and effort: a route planned with scaled weights, and by the other kinds."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Unpack

import numpy as np

from trimtab.host.base.errors import UsageError
from trimtab.host.models.model import Model
from trimtab.host.plan.flown import Flown
from trimtab.host.plan.planner import JobOptions, plan
from trimtab.host.plan.profile import jerk_rms_m_s3, profile
from trimtab.host.plan.residual import ResidualModel
from trimtab.host.plan.result import Plan, PlanRefused, PlanUnsolved, Settings
from trimtab.host.plan.table import from_reference
from trimtab.host.route import Route
from trimtab.host.vehicle import Vehicle

FACTORS = (0.1, 0.3, 1.0, 3.0, 10.0)
"""Factors on the weights of thrusts and their rates, from aggressive to smooth."""
COLUMNS: Mapping[str, str] = {
    "lambda_r": "m^2/s^4/N^2",
    "residual": "m/s^2 RMS",
    "jerk": "m/s^3 RMS",
    "tilt": "deg max",
    "thrust": "share max",
    "length": "m",
    "flown": "mm mean",
    "clipped": "%",
    "solve": "s",
}
"""Columns of the printed table: unit by title. lambda_r: the paper's weight of control effort, there 0.1."""
REFUSED, UNSOLVED = "refused", "unsolved"


@dataclass(frozen=True, kw_only=True)
class Point:
    """One plan of the trade, or the reason why there is none.

    kind: with its star. factor: on the default weights; None for the kinds it is compared with. status: of
    the plan, `refused` or `unsolved`. reason: None where there is a plan. jerk_rms_m_s3, tilt_max_deg,
    thrust_share_max (of a rotor's greatest thrust): along the reference, None without one. solve_s: processor
    time. flown: None where the plan was not flown.
    """

    kind: str
    factor: float | None
    status: str
    reason: str | None
    plan: Plan | None
    jerk_rms_m_s3: float | None
    tilt_max_deg: float | None
    thrust_share_max: float | None
    solve_s: float
    flown: Flown | None = None

    @property
    def label(self) -> str:
        """The kind, with its factor."""
        return self.kind if self.factor is None else f"{self.kind} x {self.factor:g}"

    @property
    def residual_rms_m_s2(self) -> float | None:
        """Predicted along the reference."""
        return None if self.plan is None else self.plan.residual_rms_m_s2

    @property
    def lambda_r(self) -> float | None:
        """The paper's weight of control effort, as of `Plan`."""
        return None if self.plan is None else self.plan.lambda_r

    @property
    def error_mean_m(self) -> float | None:
        """Mean tracking error of the flight."""
        return None if self.flown is None else self.flown.error_mean_m

    @property
    def clipped_share(self) -> float | None:
        """Share of the flight's ticks with motors at their limits."""
        return None if self.flown is None else self.flown.clipped_share

    @property
    def why_not(self) -> str | None:
        """Why there is no plan, or why it was not flown to its end."""
        return self.reason if self.flown is None else self.flown.failure

    @property
    def path_length_m(self) -> float | None:
        """Length of the reference."""
        return None if self.plan is None else self.plan.path_length_m

    def cells(self) -> tuple[str, ...]:
        """Return the numbers of COLUMNS for people."""
        error_m, clipped = self.error_mean_m, self.clipped_share
        numbers = (
            (self.lambda_r, ".3g"),
            (self.residual_rms_m_s2, ".3f"),
            (self.jerk_rms_m_s3, ".2f"),
            (self.tilt_max_deg, ".1f"),
            (self.thrust_share_max, ".3f"),
            (self.path_length_m, ".2f"),
            (None if error_m is None else 1e3 * error_m, ".1f"),
            (None if clipped is None else 1e2 * clipped, ".2f"),
            (self.solve_s, ".2f"),
        )
        return tuple("-" if number is None else format(number, form) for number, form in numbers)

    def to_json(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {
            "kind": self.kind,
            "factor": self.factor,
            "lambda_r": self.lambda_r,
            "status": self.status,
            "reason": self.reason,
            "residual_rms_m_s2": self.residual_rms_m_s2,
            "jerk_rms_m_s3": self.jerk_rms_m_s3,
            "tilt_max_deg": self.tilt_max_deg,
            "thrust_share_max": self.thrust_share_max,
            "path_length_m": self.path_length_m,
            "solve_s": self.solve_s,
            "error_mean_m": self.error_mean_m,
            "error_rmse_m": None if self.flown is None else self.flown.error_rmse_m,
            "error_max_m": None if self.flown is None else self.flown.error_max_m,
            "clipped_share": self.clipped_share,
            "flight_failed": None if self.flown is None else self.flown.failure,
            "log": None if self.flown is None else str(self.flown.log),
        }


def tabulate(points: Sequence[Point]) -> tuple[dict[str, str], list[tuple[str, ...]]]:
    """Return units by title, and a row of cells for each point; columns without any number are left out."""
    rows = [point.cells() for point in points]
    shown = [any(row[k] != "-" for row in rows) for k in range(len(COLUMNS))]
    units = {title: unit for (title, unit), show in zip(COLUMNS.items(), shown, strict=True) if show}
    return units, [tuple(cell for cell, show in zip(row, shown, strict=True) if show) for row in rows]


def pareto(
    route: Route,
    vehicle: Vehicle,
    model: Model | ResidualModel,
    *,
    kind: str = "min-residual",
    factors: Sequence[float] = FACTORS,
    nodes: int | None = None,
    on_point: Callable[[Point], None] | None = None,
    **options: Unpack[JobOptions],
) -> list[Point]:
    """Return plans of min-snap and min-control, then of `kind` for each factor, ascending, in the same time.

    kind: min-residual, or min-residual* beside min-control*. factors: positive, on the weights of thrusts and
    their rates in `settings`. on_point: called with each point when it is ready. The options and the
    errors ConfigurationError and UsageError are those of `trimtab.host.plan.plan`. A plan that is refused or
    not solved is a point with its reason.
    """
    star = "*" if kind.endswith("*") else ""
    if kind.removesuffix("*") != "min-residual":
        raise UsageError(f"{kind}: the trade is that of min-residual or min-residual*")
    if not factors or not all(np.isfinite(factor) and factor > 0.0 for factor in factors):
        raise ValueError(f"factors must be positive numbers, not {tuple(factors)!r}")
    base = options.get("settings") or Settings()
    wanted: list[tuple[str, float | None]] = [("min-snap", None), (f"min-control{star}", None)]
    wanted += [(kind, factor) for factor in sorted(factors)]
    points = []
    for each, factor in wanted:
        started = time.process_time()
        try:
            scaled = base if factor is None else _scaled(base, factor)
            made = plan(
                route, vehicle, kind=each, model=model, nodes=nodes, **(options | {"settings": scaled})
            )
        except (PlanRefused, PlanUnsolved) as error:
            point = _missing(each, factor, error, time.process_time() - started)
        else:
            point = _point(vehicle, each, factor, made)
        points.append(point)
        if on_point is not None:
            on_point(point)
    return points


def _scaled(settings: Settings, factor: float) -> Settings:
    """Return the settings with the weights of thrusts and their rates scaled."""
    weights = settings.weights
    return replace(
        settings,
        weights=replace(weights, control=factor * weights.control, thrust_rate=factor * weights.thrust_rate),
    )


def _missing(kind: str, factor: float | None, error: PlanRefused | PlanUnsolved, solve_s: float) -> Point:
    return Point(
        kind=kind,
        factor=factor,
        status=REFUSED if isinstance(error, PlanRefused) else UNSOLVED,
        reason=str(error),
        plan=None,
        jerk_rms_m_s3=None,
        tilt_max_deg=None,
        thrust_share_max=None,
        solve_s=solve_s,
    )


def _point(vehicle: Vehicle, kind: str, factor: float | None, made: Plan) -> Point:
    reference = made.reference
    table = from_reference(reference)
    along = profile(vehicle, ResidualModel(), table, reference.yaw_nodes())
    return Point(
        kind=kind,
        factor=factor,
        status=made.status,
        reason=None,
        plan=made,
        jerk_rms_m_s3=jerk_rms_m_s3(table),
        tilt_max_deg=float(along.tilt_deg.max()),
        thrust_share_max=float(along.thrust_share.max()),
        solve_s=made.solve_s,
    )
