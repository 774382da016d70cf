"""Plans of the demo: first with the nominal model, then one of the routes again with the traced model.

The second plan has the limits, waypoints, headings and total time of the first. Its dynamics are also
nominal, but its cost differs, as in the paper for a flatness-based law (section IV-C.4): the cost of the
first plan is effort, that of the second the residual that the traced model predicts, plus some effort.

The best weight of effort depends on the vehicle. With slow motors, an aggressive path with little drag is
tracked worse than a smooth one with more drag. The traced closed-loop model predicts this before any flight.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from trimtab.host.base.errors import Refused, SolverError
from trimtab.host.effects import Effect
from trimtab.host.models.model import Model
from trimtab.host.plan import Plan, PlanRefused, PlanUnsolved, Settings, Weights, plan
from trimtab.host.route import Route
from trimtab.host.vehicle import Vehicle

FIRST_KIND, AGAIN_KIND = "min-control", "min-residual"
MORE_TIME = 1.15
TRIES = 4
"""Factor on the time of a first plan after each failed try, and number of tries."""
CALM = (1.0, 4.0, 16.0)
"""Weights of effort for second plans, over the planner's default."""
_WEIGHTS = Weights()


@dataclass(frozen=True, kw_only=True)
class Planned:
    """A plan with its route and total time."""

    name: str
    route: Route
    time_s: float
    plan: Plan


@dataclass(frozen=True, kw_only=True)
class Choice:
    """The plan with the smallest predicted tracking error, that prediction, and the number of plans tried."""

    planned: Planned
    predicted_rmse_m: float
    plans: int


def plan_first(route: Route, vehicle: Vehicle) -> Planned:
    """Return a plan with the nominal model.

    Raises PlanRefused or PlanUnsolved if more time does not help.
    """
    time_s = route.duration_s
    for tries_left in reversed(range(TRIES)):
        try:
            made = plan(route, vehicle, kind=FIRST_KIND, total_time_s=time_s)
        except (PlanRefused, PlanUnsolved):
            if not tries_left:
                raise
            time_s = round(time_s * MORE_TIME, 2)
        else:
            return Planned(name=route.name, route=route, time_s=time_s, plan=made)
    raise AssertionError("the last try returns or raises")


def plan_again(
    first: Planned,
    vehicle: Vehicle,
    model: Model,
    effects: Mapping[str, Effect],
    predict: Callable[[Plan], float],
) -> Choice:
    """Plan the route again in the same time with the model, and return the best of several weights of effort.

    `predict` returns the tracking error (m) of a plan that has not been flown. Raises Refused or PlanUnsolved
    if no plan succeeds.
    """
    tried: list[tuple[float, Plan]] = []
    failed: PlanRefused | PlanUnsolved | None = None
    for calm in CALM:
        weights = Weights(control=calm * _WEIGHTS.control, thrust_rate=calm * _WEIGHTS.thrust_rate)
        try:
            made = plan(
                first.route,
                vehicle,
                kind=AGAIN_KIND,
                model=model,
                effects=effects,
                total_time_s=first.time_s,
                settings=Settings(weights=weights),
            )
        except (PlanRefused, PlanUnsolved) as error:
            failed = error
        else:
            tried.append((predict(made), made))
    if not tried:
        assert failed is not None
        what = f"{first.name} planned again with the traced model: {failed}"
        raise (Refused(what) if isinstance(failed, PlanRefused) else SolverError(what)) from failed
    predicted_m, best = min(tried, key=lambda pair: pair[0])
    planned = Planned(name=f"{first.name}-again", route=first.route, time_s=first.time_s, plan=best)
    return Choice(planned=planned, predicted_rmse_m=predicted_m, plans=len(tried))


def fastest(plans: Sequence[Planned]) -> Planned:
    """Return the plan with the greatest mean speed, or the first of several."""
    return max(plans, key=lambda planned: planned.plan.mean_speed_m_s)
