"""`trimtab plan`: a checked reference for a route."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from trimtab.host.verbs.options import DEFAULT_VEHICLE, Force, Json, Output, VehicleName, WorkspaceFolder

if TYPE_CHECKING:
    from trimtab.host.plan.result import Plan
    from trimtab.host.route import LimitsOverride

REPORT_SUFFIX = ".html"


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
    report: Path | None = None,
    pareto: Annotated[bool, Parameter(negative="")] = False,
    world: str | None = None,
    world_seed: int = 0,
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
        min-snap, min-control or min-residual; with a star behind the latter two the model is part of the
        dynamics. min-control-r: min-control, then its path tracked with the model in the dynamics.
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
    report
        Page with pictures to write, .html: the path with gates and keep-out shapes; residual, its sensitivity
        and distance to the limits node by node; what happens along it.
    pareto
        Compare in place of writing a reference: min-snap, min-control, and min-residual with the weights of
        thrusts and their rates scaled from 0.1 to 10 times. Needs --model; --report writes that page.
    world
        With --pareto: world, by name or path, in which a simulated vehicle flies every plan.
    world_seed
        Seed of that world; logs do not hold it.
    output
        Reference to write; NAME.ref by default, with the route's name. With --world the folder for all
        references and logs, NAME-pareto by default.
    """
    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import UsageError
    from trimtab.host.base.output import emit, say
    from trimtab.host.base.progress import Progress
    from trimtab.host.effects import load_effects
    from trimtab.host.models.file import read_model
    from trimtab.host.plan import plan as make_plan
    from trimtab.host.plan.files import check_name, figures, write_plan
    from trimtab.host.plan.residual import ResidualModel
    from trimtab.host.plan.sensitivity import sensitivity
    from trimtab.host.plan.table import from_reference
    from trimtab.host.route import route_file
    from trimtab.host.verbs import plan_pareto
    from trimtab.host.workspace import open_workspace

    if pareto and (model is None or stretch):
        raise UsageError("--pareto needs --model, and goes without --stretch")
    plan_pareto.check_options(world, world_seed, output, pareto=pareto)
    if report is not None:
        _check_report(report, force)
    place = open_workspace(workspace)
    airframe = place.vehicle(vehicle)
    way = place.route(route, airframe)
    known = None if model is None else read_model(model, vehicle_id=airframe.id)
    effects = load_effects(place.root)
    try:
        residual = ResidualModel() if known is None else ResidualModel.of(known, effects)
    except ValueError as error:
        raise UsageError(f"{model}: {error}") from None
    within = None if headroom is None else _headroom(*headroom)
    parents = {"vehicle": airframe.id, "route": way.id}
    if known is not None:
        parents["model"] = known.id
    origin = artefacts.provenance(parents=parents)
    if pareto and known is not None:
        options = {
            "kind": kind or "min-residual",
            "effects": effects,
            "headroom": within,
            "total_time_s": time_s,
            "nodes": nodes,
            "source": route_file(route, place.root),
        }
        plan_pareto.trade(
            way,
            airframe,
            known,
            options=options,
            hangar=None
            if world is None
            else plan_pareto.Hangar(
                world=world,
                world_seed=world_seed,
                folder=output or Path(f"{way.name}-pareto"),
                force=force,
            ),
            origin=origin,
            report=report,
            force=force,
            json=json,
        )
        return
    if kind is None:
        kind = "min-residual" if residual.has_force else "min-snap"
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
    if report is not None:
        from trimtab.host.report.plan import page

        artefacts.write_atomic(report, page(made, way, airframe, residual, origin), force)
    write_plan(made, target, provenance=origin, force=force)
    say(*_lines(made, target, report))
    off = sensitivity(airframe, residual, from_reference(made.reference), made.reference.yaw_nodes())
    answer = {"reference": str(target), "id": made.reference.id, **figures(made)}
    emit({**answer, "sensitivity": None if off is None else off.to_json(), "report": report}, json)


def _check_report(path: Path, force: bool) -> None:
    """Raise UsageError where no page may be written; call it before planning."""
    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import UsageError

    if path.suffix != REPORT_SUFFIX:
        raise UsageError(f"{path}: a report's name ends in {REPORT_SUFFIX}")
    artefacts.check_output(path, force)


def _headroom(low: float, high: float) -> LimitsOverride:
    """Return these shares of a rotor's thrust as limits. Raises UsageError."""
    from trimtab.host.base.errors import UsageError
    from trimtab.host.route import LimitsOverride

    if not 0.0 <= low < high <= 1.0:
        raise UsageError(f"--headroom {low:g} {high:g}: give two shares within 0 to 1, the lower one first")
    return LimitsOverride(thrust_headroom=(low, high))


def _lines(plan: Plan, target: Path, report: Path | None) -> list[str]:
    """Return the plan for people."""
    first = (
        f"{target}: {plan.label}, {plan.duration_s:.2f} s, {plan.path_length_m:.1f} m, "
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
    if plan.reference.free_ends:
        lines.append("  it moves at its ends: the vehicle keeps it, but starts only one at rest at both")
    margins = ", ".join(f"{name} {value:.3g}" for name, value in plan.margins.items())
    lines.append(f"  margins: {margins}")
    if report is not None:
        lines.append(f"  the report is {report}")
    return lines
