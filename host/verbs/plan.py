"""`trimtab plan`: plan a reference for a route and check it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from trimtab.host.api.plan import PlanTask, plan_task
from trimtab.host.verbs.plan_options import PlanOptions
from trimtab.host.workspace import open_workspace

if TYPE_CHECKING:
    from trimtab.host.plan.result import Plan

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
    import sys

    from trimtab.host.base.errors import UsageError
    from trimtab.host.verbs import plan_pareto

    if options.pareto and (options.model is None or options.stretch):
        raise UsageError("--pareto needs --model, and does not take --stretch")
    plan_pareto.check_options(options)
    if options.report is not None:
        _check_report(options.report, options.force)
    task = plan_task(
        route,
        options.vehicle,
        model=options.model,
        accept_undecided=options.accept_undecided,
        total_time_s=options.time_s,
        headroom=options.headroom,
        clearance_m=options.clearance,
        nodes=options.nodes,
        workspace=open_workspace(options.workspace, trusted=options.trust),
        command=sys.argv[1:],
    )
    if options.pareto:
        plan_pareto.trade(task, options)
    else:
        _plan(task, options)


def _plan(task: PlanTask, options: PlanOptions) -> None:
    """Plan the route, write the reference and the report, and print both."""
    from trimtab.host.base import artefacts
    from trimtab.host.base.output import emit, say
    from trimtab.host.base.progress import Progress
    from trimtab.host.plan.files import check_name, write_plan

    target = check_name(options.output or Path(f"{task.route.name}.ref"), options.force)
    with Progress(f"planning {task.route.name}"):
        result = task.plan(
            kind=options.kind,
            stretch=options.stretch,
            time_box=options.time_box,
            time_weight=options.time_weight,
        )
    if options.report is not None:
        from trimtab.host.report.plan import page

        text = page(result, task.route, task.vehicle, task.residual, task.provenance)
        artefacts.write_atomic(options.report, text, options.force)
    write_plan(result, target, force=options.force)
    say(*_lines(result, target, options.report))
    emit(result.to_dict(path=target, report_path=options.report), options.json)


def _check_report(path: Path, force: bool) -> None:
    """Raise UsageError if the report cannot be written. Call this before planning."""
    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import UsageError

    if path.suffix != REPORT_SUFFIX:
        raise UsageError(f"{path}: give the report a name that ends in {REPORT_SUFFIX}")
    artefacts.check_output(path, force)


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
