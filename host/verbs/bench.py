"""`trimtab bench`: speed on this machine, beside named peers in the same run."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from trimtab.host.verbs.options import DEFAULT_VEHICLE, Json, VehicleName, WorkspaceFolder


def command(
    *,
    vehicle: VehicleName = DEFAULT_VEHICLE,
    seed: int = 1,
    quick: bool = False,
    courses: int | None = None,
    workspace: WorkspaceFolder = None,
    json: Json = False,
) -> None:
    """Measure how fast learning, planning and simulated sessions are on this machine, and how much closer
    min-residual plans are flown; some minutes.

    JAX and diffrax compute the same gradient, rockit solves the same problem and minsnap-trajectories the
    same spline in the same run where they are installed (`make bench` installs them): a minute more.

    Parameters
    ----------
    seed
        Flights, first weights, courses and worlds are drawn from it.
    quick
        Plan and fly fewer courses, and set planning beside CasADi at 100 intervals: at most five minutes in
        all.
    courses
        Random courses that the success rate of planning is over: 40 without it, 10 with --quick.
    """
    from trimtab.host.apps.bench import flown, learning, planning, session
    from trimtab.host.base.errors import UsageError
    from trimtab.host.base.output import emit, say
    from trimtab.host.base.progress import Progress
    from trimtab.host.workspace import open_workspace

    if seed < 0:
        raise UsageError(f"--seed {seed} is negative, give 0 or more")
    size = planning.QUICK if quick else planning.Size()
    flights = flown.QUICK if quick else flown.Size()
    if courses is not None:
        if courses < 1:
            raise UsageError(f"--courses {courses}: give 1 or more")
        size = replace(size, success=courses)
    craft = open_workspace(workspace).vehicle(vehicle)
    steps = len(learning.STEPS) + size.steps + flights.steps
    with Progress("bench", total=float(steps + 1)) as progress:
        done = iter(range(steps))

        def on_progress(step: str) -> None:
            progress.update(next(done), detail=step)

        learned = learning.measure(craft, seed, on_progress)
        planned = planning.measure(craft, seed, on_progress, size=size)
        compared = flown.measure(craft, seed, on_progress, size=flights)
        progress.update(steps, detail="session")
        factor = session.realtime_factor(craft)
    say(
        *_learning_lines(learned),
        *_planning_lines(planned),
        *_flown_lines(compared),
        f"simulated sessions run {factor:.1f} times as fast as the clock",
    )
    session_found = {"realtime_factor": factor}
    emit({"learning": learned, "planning": planned, "flown": compared, "session": session_found}, json)


def _learning_lines(found: dict[str, Any]) -> list[str]:
    """Return the figures of learning, for people."""
    c = found["gradient_ms"]
    lines = [
        "gradient of 10 segments of 49 steps, network 2 x 32, double precision, one core:",
        f"  C over SIMD lanes        {'no compiler' if c is None else f'{c:8.2f} ms'}",
        f"  CasADi virtual machine   {found['gradient_vm_ms']:8.2f} ms",
    ]
    for row in found["peers"] or ():
        figures = f"{row['gradient_ms']:8.2f} ms, {row['over_ours']:.1f} times ours"
        lines.append(f"  {row['name']:<24} {figures}, compiled in {row['build_s']:.0f} s")
    if found["peers"] is None:
        lines.append("  JAX and diffrax are not installed: make bench, or pip install trimtab[bench]")
    return [
        *lines,
        f"Adam, 100 epochs of 128 segments: {found['adam_100_s']:.1f} s, test RMSE "
        f"{found['adam_test_rmse']:.4f} m/s^2",
        f"condensed loss, L-BFGS: {found['condensed_s']:.1f} s, test RMSE {found['test_rmse']:.4f}, out of "
        f"distribution {found['ood_rmse']:.4f} m/s^2",
    ]


def _planning_lines(found: dict[str, Any]) -> list[str]:
    """Return the figures of planning, for people."""
    lines = [
        f"min-residual*, network 2 x 32, {found['nodes']} intervals, processor time, median of "
        f"{found['planned']} of {found['courses']} courses:",
        f"  solver, first round      {_seconds(found['min_residual_star_median_s'])}",
        f"  whole plan               {_seconds(found['plan_median_s'])}",
        f"  solver, total time free  {_seconds(found['free_time_s'])}, "
        f"{found['free_time_planned']} of {found['free_time_courses']} courses",
    ]
    for row in found["scaling"]:
        what = f"  {row['nodes']} intervals".ljust(26)
        lines.append(f"{what} {_seconds(row['first_solve_s'])}, {row['planned']} of {row['courses']} courses")
    naive, ratio = found["naive"], found["speedup_over_naive"]
    if ratio is not None:
        bound = "at least " if naive["at_least"] else ""
        lines.append(
            f"  CasADi's map and Ipopt   {_seconds(naive['seconds'])} for one course at {naive['nodes']} "
            f"intervals, built in {naive['build_s']:.1f} s: {bound}{ratio:.0f} times ours"
        )
    lines += [_rockit_line(found["rockit"]), _snap_line(found["minsnap_trajectories"])]
    if found["success_rate"] is not None:
        lines.append(f"  planned: {found['success_rate']:.1%} of {found['success_courses']} random courses")
    return [*lines, *(f"    {failure}" for failure in found["failures"])]


def _rockit_line(found: dict[str, Any] | None) -> str:
    if found is None:
        return "  rockit is not installed: make bench, or pip install trimtab[bench]"
    what = (
        f"  rockit                   {_seconds(found['seconds'])} for one course at {found['nodes']} "
        f"intervals, built in {found['build_s']:.1f} s"
    )
    if found["ours_s"] is None:
        return what
    bound = "at least " if found["at_least"] else ""
    return f"{what}: {bound}{found['seconds'] / found['ours_s']:.0f} times ours"


def _snap_line(found: dict[str, Any] | None) -> str:
    if found is None:
        return "  minsnap-trajectories is not installed: make bench, or pip install trimtab[bench]"
    return (
        f"  minsnap-trajectories     {found['ms']:8.2f} ms for a spline of {found['waypoints']} waypoints: "
        f"{found['ms'] / found['ours_ms']:.0f} times ours"
    )


def _flown_lines(found: dict[str, Any]) -> list[str]:
    """How much closer min-residual is flown, for people."""
    worlds = "one sealed world" if found["worlds"] == 1 else f"{found['worlds']} sealed worlds"
    lines = [
        f"{found['kind']} flown by the DFBC on {found['courses']} held-out courses in {worlds}, "
        "median (95 % of bootstraps):"
    ]
    for what, name in (
        ("predicted residual over min-snap's", "residual_ratio"),
        ("mean error over min-snap's", "error_ratio"),
        ("mean error over min-control's", "error_ratio_min_control"),
    ):
        if found[name] is None:
            lines.append(f"  {what:<36} none")
            continue
        low, high = found[f"{name}_ci95"]
        lines.append(f"  {what:<36} {found[name]:.2f} ({low:.2f} to {high:.2f})")
    return [*lines, *(f"    {failure}" for failure in found["failures"])]


def _seconds(value: float | None) -> str:
    return "    none" if value is None else f"{value:8.2f} s"
