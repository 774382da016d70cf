"""`trimtab plan`: plan a reference for a route and check it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from trimtab.host.verbs.plan_options import PlanOptions, PlanTask

if TYPE_CHECKING:
    from trimtab.host.plan.result import Plan
    from trimtab.host.route import LimitsOverride

REPORT_SUFFIX = ".html"
_ROUNDING_M = 1e-3
"""By how much a margin may miss the clearance before it is told."""

DEFAULTS = PlanOptions()


def command(route: str, *, options: PlanOptions = DEFAULTS) -> None:
    """Plan a reference for a route and check it.

    Parameters
    ----------
    route
        Route file, by name or path, at most 500 s long. NAME:SEED draws a random route with another seed.
    """
    from trimtab.host.base.errors import UsageError
    from trimtab.host.verbs import plan_pareto

    if options.pareto and (options.model is None or options.stretch):
        raise UsageError("--pareto needs --model, and does not take --stretch")
    plan_pareto.check_options(options)
    if options.report is not None:
        _check_report(options.report, options.force)
    task = _read(route, options)
    if options.pareto:
        plan_pareto.trade(task, options)
    else:
        _plan(task, options)


def _read(route: str, options: PlanOptions) -> PlanTask:
    """Read the files that the options name. Raises UsageError."""
    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import UsageError
    from trimtab.host.plan.residual import ResidualModel
    from trimtab.host.route import route_file
    from trimtab.host.workspace import open_workspace

    space = open_workspace(options.workspace)
    vehicle = space.vehicle(options.vehicle)
    target = space.route(route, vehicle)
    model, effects, residual = None, None, ResidualModel()
    if options.model is not None:
        from trimtab.host.effects import load_effects
        from trimtab.host.verbs.options import accepted_model

        model = accepted_model(options.model, options.accept_undecided, vehicle_id=vehicle.id)
        effects = load_effects(space.root)
        try:
            residual = ResidualModel.of(model, effects)
        except ValueError as error:
            raise UsageError(f"{options.model}: {error}") from None
    parents = {"vehicle": vehicle.id, "route": target.id}
    if model is not None:
        parents["model"] = model.id
    return PlanTask(
        route=target,
        vehicle=vehicle,
        model=model,
        residual=residual,
        planner_options={
            "effects": effects,
            "headroom": None if options.headroom is None else _headroom(*options.headroom),
            "total_time_s": options.time_s,
            "nodes": options.nodes,
            "clearance_m": options.clearance,
            "source": route_file(route, space.root),
        },
        provenance=artefacts.provenance(parents=parents),
    )


def _plan(task: PlanTask, options: PlanOptions) -> None:
    """Plan the route, write the reference and the report, and print both."""
    from trimtab.host.base import artefacts
    from trimtab.host.base.output import emit, say
    from trimtab.host.base.progress import Progress
    from trimtab.host.plan import plan
    from trimtab.host.plan.files import check_name, figures, write_plan
    from trimtab.host.plan.sensitivity import sensitivity
    from trimtab.host.plan.table import from_reference

    target = check_name(options.output or Path(f"{task.route.name}.ref"), options.force)
    with Progress(f"planning {task.route.name}"):
        result = plan(
            task.route,
            task.vehicle,
            kind=options.kind or ("min-residual" if task.residual.has_force else "min-snap"),
            model=task.model,
            time_box=options.time_box,
            time_weight=options.time_weight,
            stretch=options.stretch,
            **task.planner_options,
        )
    if options.report is not None:
        from trimtab.host.report.plan import page

        text = page(result, task.route, task.vehicle, task.residual, task.provenance)
        artefacts.write_atomic(options.report, text, options.force)
    write_plan(result, target, provenance=task.provenance, force=options.force)
    say(*_lines(result, target, options.report))
    samples = from_reference(result.reference)
    bound = sensitivity(task.vehicle, task.residual, samples, result.reference.yaw_nodes())
    assessment = None if task.model is None else task.model.assessment
    answer = {
        "reference": str(target),
        "id": result.reference.id,
        "model_verdict": None if assessment is None else assessment.verdict,
        **figures(result),
        "sensitivity": None if bound is None else bound.to_json(),
        "report": options.report,
    }
    emit(answer, options.json)


def _check_report(path: Path, force: bool) -> None:
    """Raise UsageError if the report cannot be written. Call this before planning."""
    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import UsageError

    if path.suffix != REPORT_SUFFIX:
        raise UsageError(f"{path}: give the report a name that ends in {REPORT_SUFFIX}")
    artefacts.check_output(path, force)


def _headroom(low: float, high: float) -> LimitsOverride:
    """Return these shares of a rotor's thrust as limits. Raises UsageError."""
    from trimtab.host.base.errors import UsageError
    from trimtab.host.route import LimitsOverride

    if not 0.0 <= low < high <= 1.0:
        raise UsageError(f"--headroom {low:g} {high:g}: give two shares within 0 to 1, the lower one first")
    return LimitsOverride(thrust_headroom=(low, high))


def _lines(plan: Plan, target: Path, report: Path | None) -> list[str]:
    """Return the plan as lines of text."""
    from trimtab.host.plan.box import OBSTACLES

    first = (
        f"{target}: {plan.label}, {plan.duration_s:.2f} s, {plan.path_length_m:.1f} m, "
        f"{plan.mean_speed_m_s:.2f} m/s mean speed, {len(plan.reference.nodes)} nodes"
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
        lines.append(f"  {share:.0f} % of the plan is outside the model's trained region")
    if plan.reference.free_ends:
        lines.append(
            "  it moves at an end: the vehicle stores it, but starts only references at rest at both ends"
        )
    if plan.clearance_m is not None:
        predicted_mm = 1e3 * plan.predicted_error_max_m
        lines.append(
            f"  clearance {1e3 * plan.clearance_m:.0f} mm from gates and keep-out shapes; "
            f"the model predicts up to {predicted_mm:.0f} mm of tracking error"
        )
        lines += [
            f"  {name} is {plan.margins[name]:.3f}: the route has no room for this clearance"
            for name in OBSTACLES
            if plan.margins.get(name, plan.clearance_m) < plan.clearance_m - _ROUNDING_M
        ]
    margins = ", ".join(f"{name} {value:.3g}" for name, value in plan.margins.items())
    lines.append(f"  margins: {margins}")
    if report is not None:
        lines.append(f"  the report is {report}")
    return lines
