"""`trimtab bench`: speed on this machine, compared with other tools in the same run."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from trimtab.host.base.extras import install_command
from trimtab.host.verbs.options import Json, Trust, VehicleName, WorkspaceFolder
from trimtab.host.workspace import DEFAULT_VEHICLE


def command(
    *,
    vehicle: VehicleName = DEFAULT_VEHICLE,
    seed: int = 1,
    quick: bool = False,
    courses: int | None = None,
    peers: bool = False,
    workspace: WorkspaceFolder = None,
    trust: Trust = False,
    json: Json = False,
) -> None:
    """Measure the speed of learning, planning, control, tracing and simulation, and plans' tracking error.

    Takes some minutes. If they are installed (`make bench`), JAX and diffrax compute the same gradient,
    rockit solves the same problem and minsnap-trajectories the same spline, which takes a minute more.

    Parameters
    ----------
    seed
        Seed of flights, first weights, courses and worlds.
    quick
        Plan and fly fewer courses, compare planning with CasADi at 100 intervals, and trace only a few
        flights. Takes at most five minutes in total.
    courses
        Number of random courses for the success rate of planning. Default: 40, or 10 with --quick.
    peers
        Measure only what other tools are compared with, and print the table of the comparisons.
    """
    from trimtab.host.apps.bench import control, flown, learning, machine, planning, session, table, tracing
    from trimtab.host.base.errors import UsageError
    from trimtab.host.base.output import emit, say
    from trimtab.host.base.progress import Progress
    from trimtab.host.workspace import open_workspace

    if seed < 0:
        raise UsageError(f"--seed {seed} is negative; give 0 or more")
    size = planning.QUICK if quick else planning.Size()
    flights = flown.QUICK if quick else flown.Size()
    controlled = control.QUICK if quick else control.Size()
    traces = tracing.QUICK if quick else tracing.Size()
    if courses is not None:
        if courses < 1:
            raise UsageError(f"--courses {courses}: give 1 or more")
        size = replace(size, success=courses)
    if peers:
        if courses is not None:
            raise UsageError("--courses: --peers plans no random courses; leave one of them out")
        size, controlled = size.peers_alone(), controlled.peers_alone()
    craft = open_workspace(workspace, trusted=trust).vehicle(vehicle)
    steps = len(learning.GRADIENT_STEPS if peers else learning.STEPS) + size.steps + len(control.STEPS)
    steps += 0 if peers else flights.steps + traces.steps
    found = machine.measure()
    with Progress("bench", total=float(steps + 1)) as progress:
        done = iter(range(steps))

        def on_progress(step: str) -> None:
            progress.update(next(done), detail=step)

        learned = learning.measure(craft, seed, on_progress, training=not peers)
        planned = planning.measure(craft, seed, on_progress, size=size)
        mpc = control.measure(craft, seed, on_progress, size=controlled)
        others: dict[str, dict[str, Any]] = {}
        if not peers:
            others["flown"] = flown.measure(craft, seed, on_progress, size=flights)
            others["trace"] = tracing.measure(craft, seed, on_progress, size=traces)
            progress.update(steps, detail="session")
            others["session"] = {"realtime_factor": session.realtime_factor(craft)}
    result = table.answer(machine=found, learning=learned, planning=planned, control=mpc, **others)
    say(_machine_line(found))
    if not peers:
        say(
            *_learning_lines(learned, found["peak_gflops"]),
            *_planning_lines(result["planning"], found["peak_gflops"]),
            *_flown_lines(result["flown"]),
            *_control_lines(result["control"]),
            _trace_line(result["trace"], traces.few),
            f"simulated sessions run {result['session']['realtime_factor']:.1f} times as fast as real time",
        )
    say(*table.peer_lines(result["peers"]))
    emit(result, json)


def _machine_line(result: dict[str, Any]) -> str:
    """Return the machine's vector width, instructions and peak as a line of text."""
    features = ", ".join(result["features"]) or "none known"
    if result["lanes"] is None:
        return f"vector instructions: {features}; no compiler"
    return (
        f"vector instructions: {features}; {result['lanes']} lanes, {result['peak_gflops']:.0f} Gflop/s at "
        "most on one core"
    )


def _learning_lines(result: dict[str, Any], peak_gflops: float | None) -> list[str]:
    """Return the figures of learning as lines of text."""
    from trimtab.host.apps.bench.machine import gradient_floor_ms

    gradient_ms = result["gradient_ms"]
    lines = [
        "gradient of 10 segments of 49 steps, network 2 x 32, double precision, one core:",
        f"  C over SIMD lanes        {'no compiler' if gradient_ms is None else f'{gradient_ms:8.2f} ms'}",
        f"  CasADi virtual machine   {result['gradient_vm_ms']:8.2f} ms",
    ]
    floor_ms = gradient_floor_ms(peak_gflops, result["gradient_weights"], result["gradient_points"])
    if floor_ms is not None:
        lines.append(f"  floor of the network     {floor_ms:8.2f} ms: its arithmetic at the machine's peak")
    for row in result["peers"] or ():
        figures = f"{row['gradient_ms']:8.2f} ms, {row['over_ours']:.1f} times ours"
        lines.append(f"  {row['name']:<24} {figures}, compiled in {row['build_s']:.0f} s")
    if result["peers"] is None:
        lines.append(f"  JAX and diffrax are not installed: run {install_command('bench')}")
    return [
        *lines,
        f"Adam, 100 epochs of 128 segments: {result['adam_100_s']:.1f} s, test RMSE "
        f"{result['adam_test_rmse']:.4f} m/s^2",
        f"condensed loss, L-BFGS: {result['condensed_s']:.1f} s, test RMSE {result['test_rmse']:.4f}, out of "
        f"distribution {result['ood_rmse']:.4f} m/s^2",
    ]


def _planning_lines(result: dict[str, Any], peak_gflops: float | None) -> list[str]:
    """Return the figures of planning as lines of text."""
    from trimtab.host.apps.bench.machine import recursion_floor_ms
    from trimtab.host.plan.dynamics import INPUTS, STATES

    lines = [
        f"min-residual*, network 2 x 32, {result['nodes']} intervals, processor time, median of "
        f"{result['planned']} of {result['courses']} courses:",
        f"  solver, first round      {_seconds(result['min_residual_star_median_s'])}",
        f"  whole plan               {_seconds(result['plan_median_s'])}",
        f"  solver, total time free  {_seconds(result['free_time_s'])}, "
        f"{result['free_time_planned']} of {result['free_time_courses']} courses",
    ]
    floor_ms = recursion_floor_ms(peak_gflops, STATES + 2, INPUTS + 1, result["nodes"])
    if floor_ms is not None and result["iterations_median"] is not None:
        lines.append(
            f"  floor of linear algebra  {1e-3 * floor_ms * result['iterations_median']:8.2f} s: "
            f"{result['iterations_median']:.0f} factorisations of all intervals at the machine's peak"
        )
    for row in result["scaling"]:
        label = f"  {row['nodes']} intervals".ljust(26)
        lines.append(
            f"{label} {_seconds(row['first_solve_s'])}, {row['planned']} of {row['courses']} courses"
        )
    naive, ratio = result["naive"], result["speedup_over_naive"]
    if ratio is not None:
        bound = "at least " if naive["at_least"] else ""
        lines.append(
            f"  CasADi's map and Ipopt   {_seconds(naive['seconds'])} for one course at {naive['nodes']} "
            f"intervals, built in {naive['build_s']:.1f} s: {bound}{ratio:.0f} times ours"
        )
    lines.append(f"  solver of the MPC, 99th  {result['mpc_solve_ms_p99']:8.2f} ms")
    lines += [_rockit_line(result["rockit"]), _snap_line(result["minsnap_trajectories"])]
    if result["success_rate"] is not None:
        lines.append(f"  planned: {result['success_rate']:.1%} of {result['success_courses']} random courses")
    return [*lines, *(f"    {failure}" for failure in result["failures"])]


def _rockit_line(result: dict[str, Any] | None) -> str:
    if result is None:
        return f"  rockit is not installed: run {install_command('bench')}"
    line = (
        f"  rockit                   {_seconds(result['seconds'])} for one course at {result['nodes']} "
        f"intervals, built in {result['build_s']:.1f} s"
    )
    if result["ours_s"] is None:
        return line
    bound = "at least " if result["at_least"] else ""
    return f"{line}: {bound}{result['seconds'] / result['ours_s']:.0f} times ours"


def _snap_line(result: dict[str, Any] | None) -> str:
    if result is None:
        return f"  minsnap-trajectories is not installed: run {install_command('bench')}"
    return (
        f"  minsnap-trajectories     {result['ms']:8.2f} ms for a spline of {result['waypoints']} waypoints: "
        f"{result['ms'] / result['ours_ms']:.0f} times ours"
    )


def _flown_lines(result: dict[str, Any]) -> list[str]:
    """Return the comparison of flown plans as lines of text."""
    worlds = "one sealed world" if result["worlds"] == 1 else f"{result['worlds']} sealed worlds"
    lines = [
        f"{result['kind']} flown by the DFBC on {result['courses']} held-out courses in {worlds}, "
        "median (95 % of bootstraps):"
    ]
    for label, name in (
        ("predicted residual over min-snap's", "residual_ratio"),
        ("mean error over min-snap's", "error_ratio"),
        ("mean error over min-control's", "error_ratio_min_control"),
    ):
        if result[name] is None:
            lines.append(f"  {label:<36} none")
            continue
        low, high = result[f"{name}_ci95"]
        lines.append(f"  {label:<36} {result[name]:.2f} ({low:.2f} to {high:.2f})")
    return [*lines, *(f"    {failure}" for failure in result["failures"])]


def _control_lines(result: dict[str, Any]) -> list[str]:
    """Return the figures of the MPC as lines of text."""
    naive = result["naive"]
    return [
        f"{result['controller']}, network {' x '.join(map(str, result['hidden']))}, processor time of "
        f"{result['steps']} steps:",
        f"  median                   {result['mpc_step_ms_p50']:8.2f} ms",
        f"  99th percentile          {result['mpc_step_ms_p99']:8.2f} ms, {result['budget_spent']} steps "
        "spent their budget",
        f"  CasADi and Ipopt         {naive['ms']:8.2f} ms a problem, median of {naive['problems']}: "
        f"{naive['over_ours']:.0f} times ours",
    ]


def _trace_line(result: dict[str, Any], flights: int) -> str:
    """Return the times of traces as a line of text."""
    line = (
        f"trace of {flights} flights: {result['cpu_s']:.1f} s processor time, {result['wall_s']:.1f} s in all"
    )
    per_log = result["logs_100_per_log"]
    return line if per_log is None else f"{line}; of 100 logs: {per_log:.2f} s a log"


def _seconds(value: float | None) -> str:
    return "    none" if value is None else f"{value:8.2f} s"
