"""Plan a reference for a route, with a vehicle's model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trimtab.host.api.load import vehicle_of
from trimtab.host.base.errors import UsageError
from trimtab.host.workspace import DEFAULT_VEHICLE, Workspace, open_workspace

if TYPE_CHECKING:
    from trimtab.host.models.model import Model
    from trimtab.host.plan import Plan, ResidualModel, Settings
    from trimtab.host.route import LimitsOverride, Route
    from trimtab.host.vehicle import Vehicle


@dataclass(frozen=True, kw_only=True)
class PlanTask:
    """What is planned: the content of the files, and what one plan or a comparison of plans shares.

    `planner_options` are further arguments of `host.plan.plan`. `provenance` goes into every written file.
    """

    route: Route
    vehicle: Vehicle
    model: Model | None
    residual: ResidualModel
    planner_options: Mapping[str, Any]
    provenance: Mapping[str, Any]

    def plan(
        self,
        *,
        kind: str | None = None,
        stretch: bool = False,
        time_box: tuple[float, float] | None = None,
        time_weight: float | None = None,
    ) -> Plan:
        """Return one plan, with the sensitivity of its residual. See `plan`."""
        from trimtab.host.plan import plan as solve
        from trimtab.host.plan.sensitivity import sensitivity
        from trimtab.host.plan.table import from_reference

        made = solve(
            self.route,
            self.vehicle,
            kind=kind or ("min-residual" if self.residual.has_force else "min-snap"),
            model=self.model,
            time_box=time_box,
            time_weight=time_weight,
            stretch=stretch,
            **self.planner_options,
        )
        samples, yaws = from_reference(made.reference), made.reference.yaw_nodes()
        assessment = None if self.model is None else self.model.assessment
        return replace(
            made,
            sensitivity=sensitivity(self.vehicle, self.residual, samples, yaws),
            model_verdict=None if assessment is None else assessment.verdict,
            provenance=self.provenance,
        )


def plan_task(  # noqa: PLR0913 (one keyword for each choice)
    route: Route | str | Path,
    vehicle: Vehicle | str | Path = DEFAULT_VEHICLE,
    *,
    model: Model | str | Path | None = None,
    accept_undecided: bool = False,
    total_time_s: float | None = None,
    headroom: tuple[float, float] | None = None,
    clearance_m: float | None = None,
    nodes: int | None = None,
    settings: Settings | None = None,
    workspace: str | Path | Workspace | None = None,
    command: Sequence[str] = (),
) -> PlanTask:
    """Return what is to be planned, with all files read. See `plan`. Raises UsageError."""
    from trimtab.host.base import artefacts
    from trimtab.host.plan.residual import ResidualModel
    from trimtab.host.route import route_file

    space = open_workspace(workspace)
    airframe = vehicle_of(vehicle, space)
    by_name = isinstance(route, str | Path)
    target = space.route(route, airframe) if by_name else route
    content, effects, residual = None, None, ResidualModel()
    if model is not None:
        from trimtab.host.models.accepted import accepted_model

        content = accepted_model(model, accept_undecided, vehicle_id=airframe.id)
        effects = space.effects()
        try:
            residual = ResidualModel.of(content, effects)
        except ValueError as error:
            name = model if isinstance(model, str | Path) else "the model"
            raise UsageError(f"{name}: {error}") from None
    parents = {"vehicle": airframe.id, "route": target.id}
    if content is not None:
        parents["model"] = content.id
    return PlanTask(
        route=target,
        vehicle=airframe,
        model=content,
        residual=residual,
        planner_options={
            "effects": effects,
            "headroom": None if headroom is None else _headroom(*headroom),
            "total_time_s": total_time_s,
            "nodes": nodes,
            "clearance_m": clearance_m,
            "settings": settings,
            "source": route_file(route, space.root) if by_name else None,
        },
        provenance=artefacts.provenance(parents=parents, argv=command),
    )


def plan(  # noqa: PLR0913 (one keyword for each choice)
    route: Route | str | Path,
    vehicle: Vehicle | str | Path = DEFAULT_VEHICLE,
    *,
    kind: str | None = None,
    model: Model | str | Path | None = None,
    accept_undecided: bool = False,
    total_time_s: float | None = None,
    time_box: tuple[float, float] | None = None,
    time_weight: float | None = None,
    stretch: bool = False,
    headroom: tuple[float, float] | None = None,
    clearance_m: float | None = None,
    nodes: int | None = None,
    settings: Settings | None = None,
    workspace: str | Path | Workspace | None = None,
) -> Plan:
    """Return a checked plan for a route, as `trimtab plan` makes it.

    The same arguments give the same reference. `write_plan` writes it.

    Parameters
    ----------
    route
        Route, or the name or path of its file.
    vehicle
        Vehicle, or the name or path of its file.
    kind
        min-snap, min-control, min-residual or min-error; min-control* and min-residual* put the model into
        the dynamics; min-control-r tracks min-control's path with it. Default: min-residual if the model
        predicts a residual, else min-snap.
    model
        Model of the residual, or its file.
    accept_undecided
        Also use a model whose verdict is undecided.
    total_time_s
        Total time instead of the route's, at most 500 s.
    time_box
        Least and greatest total time as shares of the route's. The plan chooses between them.
    time_weight
        Cost of a second if the total time is free, in units of the squared residual. Default: 1.
    stretch
        Give a min-snap plan that breaks a limit more time.
    headroom
        Least and greatest share, 0 to 1, of a rotor's thrust that the plan may use.
    clearance_m
        Distance that the path keeps from keep-out shapes and from the edges of gates, m. Default: the
        tracking error that the model predicts, plus 0.1 m, or less where the route leaves no room.
    nodes
        Approximate number of shooting intervals, 20 to 1600. Default: one every 70 ms.
    settings
        Weights and tolerances of the solver. Default: the measured ones.
    workspace
        Folder with vehicles, routes and effects of yours. Default: the current folder.

    Returns
    -------
    Plan
        `reference` is what a vehicle follows; `margins` says how far it stays from each limit.

    Raises
    ------
    UsageError, ConfigurationError
        If a file cannot be used or arguments contradict each other.
    PlanRefused
        If no reference keeps the limits. The text gives node and reason.
    PlanUnsolved
        If the solver gave up.
    """
    task = plan_task(
        route,
        vehicle,
        model=model,
        accept_undecided=accept_undecided,
        total_time_s=total_time_s,
        headroom=headroom,
        clearance_m=clearance_m,
        nodes=nodes,
        settings=settings,
        workspace=workspace,
    )
    return task.plan(kind=kind, stretch=stretch, time_box=time_box, time_weight=time_weight)


def _headroom(low: float, high: float) -> LimitsOverride:
    """Return these shares of a rotor's thrust as limits. Raises UsageError."""
    from trimtab.host.route import LimitsOverride

    if not 0.0 <= low < high <= 1.0:
        raise UsageError(f"--headroom {low:g} {high:g}: give two shares within 0 to 1, the lower one first")
    return LimitsOverride(thrust_headroom=(low, high))
