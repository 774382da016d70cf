"""`trimtab plan`: a checked reference for a route."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from host.verbs.options import DEFAULT_VEHICLE, Force, Json, Output, VehicleName, WorkspaceFolder

if TYPE_CHECKING:
    from host.plan.result import Plan
    from host.route import LimitsOverride


def command(
    route: str,
    *,
    vehicle: VehicleName = DEFAULT_VEHICLE,
    model: Path | None = None,
    kind: str | None = None,
    nodes: int | None = None,
    time_s: float | None = None,
    time_box: tuple[float, float] | None = None,
    time_weight: float | None = None,
    stretch: Annotated[bool, Parameter(negative="")] = False,
    headroom: tuple[float, float] | None = None,
    output: Output = None,
    force: Force = False,
    json: Json = False,
    workspace: WorkspaceFolder = None,
) -> None:
    """Make a checked reference for a route.

    Parameters
    ----------
    route
        Route file, by name or path, at most 500 s long; NAME:SEED draws a random route anew.
    model
        Model of what the nominal vehicle lacks, a .model.toml file.
    kind
        min-snap, min-control or min-residual; with a star behind it the model is part of the dynamics.
        By default min-residual where a model is given that predicts a residual, else min-snap.
    nodes
        About how many shooting intervals, 20 to 1600; one about every 70 ms by default.
    time_s
        Total time, in place of the route's, at most 500 s.
    time_box
        Let the total time be free between these shares of it, as 0.8 1.3.
    time_weight
        What a second costs where the total time is free, in units of the squared residual; 1 by default.
    stretch
        Give a min-snap plan that breaks a limit more time.
    headroom
        Least and greatest share of a rotor's thrust that the plan may use; tighter than the vehicle's.
    output
        Reference to write; NAME.ref by default, with the route's name.
    """
    from host import artefacts
    from host.effects import load_effects
    from host.models.file import read_model
    from host.output import emit, say
    from host.plan import plan as make_plan
    from host.plan.dynamics import ResidualModel
    from host.plan.files import check_name, figures, write_plan
    from host.progress import Progress
    from host.route import route_file
    from host.workspace import open_workspace

    place = open_workspace(workspace)
    airframe = place.vehicle(vehicle)
    way = place.route(route, airframe)
    known = None if model is None else read_model(model, vehicle_id=airframe.id)
    effects = load_effects(place.root)
    if kind is None:
        kind = "min-snap"
        if known is not None and ResidualModel.of(known, effects).has_residual:
            kind = "min-residual"
    within = None if headroom is None else _headroom(*headroom)
    target = check_name(output or Path(f"{way.name}.ref"), force)
    with Progress(f"planning {way.name}"):
        made = make_plan(
            way,
            airframe,
            kind=kind,
            model=known,
            effects=effects,
            headroom=within,
            total_time_s=time_s,
            time_box=time_box,
            time_weight=time_weight,
            stretch=stretch,
            nodes=nodes,
            source=route_file(route, place.root),
        )
    parents = {"vehicle": airframe.id, "route": way.id}
    if known is not None:
        parents["model"] = known.id
    write_plan(made, target, provenance=artefacts.provenance(parents=parents), force=force)
    say(*_lines(made, target))
    emit({"reference": str(target), "id": made.reference.id, **figures(made)}, json)


def _headroom(low: float, high: float) -> LimitsOverride:
    """These shares of a rotor's thrust as limits. Raises UsageError."""
    from host.errors import UsageError
    from host.route import LimitsOverride

    if not 0.0 <= low < high <= 1.0:
        raise UsageError(f"--headroom {low:g} {high:g}: give two shares within 0 to 1, the lower one first")
    return LimitsOverride(thrust_headroom=(low, high))


def _lines(plan: Plan, target: Path) -> list[str]:
    """The plan for people."""
    star = "*" if plan.augmented else ""
    first = (
        f"{target}: {plan.kind}{star}, {plan.duration_s:.2f} s, {plan.path_length_m:.1f} m, "
        f"{plan.mean_speed_m_s:.2f} m/s in the mean, {len(plan.reference.nodes)} nodes"
    )
    if plan.stretch > 1.0:
        first += f", stretched {plan.stretch:.3f} times"
    lines = [first]
    if plan.iterations:
        lines.append(
            f"  {plan.status}: {plan.iterations} iterations in {plan.rounds} rounds, {plan.solve_s:.1f} s; "
            f"the reference is within {1e3 * (plan.deviation_m or 0.0):.2f} mm of the solver's path"
        )
    if plan.residual_rms_m_s2 is not None:
        lines.append(f"  predicted residual {plan.residual_rms_m_s2:.3f} m/s^2 RMS")
    if plan.outside_region:
        share = 100.0 * plan.outside_region
        lines.append(f"  {share:.0f} % of it is beyond the region that the model's data covers")
    margins = ", ".join(f"{name} {value:.3g}" for name, value in plan.margins.items())
    lines.append(f"  margins: {margins}")
    return lines
