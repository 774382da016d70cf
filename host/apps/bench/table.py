"""The answer of `trimtab bench`, with a row for every peer that solved one of the same tasks."""

from __future__ import annotations

from typing import Any

from trimtab.host.apps.bench.machine import gradient_floor_ms, recursion_floor_ms
from trimtab.host.control.dynamics import INPUTS, STATES

Figures = dict[str, Any]


def answer(
    *, machine: Figures, learning: Figures, planning: Figures, control: Figures, **others: Figures
) -> Figures:
    """Return the figures as one JSON object. The MPC's solver is one of planning: its time is there."""
    control = dict(control)
    planning = {**planning, "mpc_solve_ms_p99": control.pop("mpc_solve_ms_p99")}
    return {
        "machine": machine,
        "learning": learning,
        "planning": planning,
        "control": control,
        **others,
        "peers": peer_rows(machine, learning, planning, control),
    }


def peer_rows(machine: Figures, learning: Figures, planning: Figures, control: Figures) -> list[Figures]:
    """Return a row for each peer: task, peer, ours_ms, peer_ms, at_least, over_ours, floor_ms.

    at_least: the peer had not finished, so its time and the ratio are lower bounds. floor_ms: of the task's
    arithmetic at the machine's peak, for the network or the factorisations; None where it is not known.
    """
    floor_ms = gradient_floor_ms(
        machine["peak_gflops"], learning["gradient_weights"], learning["gradient_points"]
    )
    ours_ms = learning["gradient_ms"] or learning["gradient_vm_ms"]
    gradients = [(peer["name"], peer["gradient_ms"]) for peer in learning["peers"] or ()]
    if learning["gradient_ms"] is not None:
        gradients.append(("CasADi virtual machine", learning["gradient_vm_ms"]))
    rows = [_row("gradient, 10 x 49 steps", name, ours_ms, ms, floor_ms=floor_ms) for name, ms in gradients]
    for name, key in (("CasADi map and Ipopt", "naive"), ("rockit and Ipopt", "rockit")):
        peer = planning[key]
        if peer is not None and peer["ours_s"] is not None:
            task = f"first solve, {peer['nodes']} intervals"
            rows.append(_row(task, name, 1e3 * peer["ours_s"], 1e3 * peer["seconds"], peer["at_least"]))
    spline = planning["minsnap_trajectories"]
    if spline is not None:
        task = f"min-snap, {spline['waypoints']} waypoints"
        rows.append(_row(task, "minsnap-trajectories", spline["ours_ms"], spline["ms"]))
    mpc = control["naive"]
    one_ms = recursion_floor_ms(machine["peak_gflops"], STATES, INPUTS, control["stages"] + 1)
    floor_ms = None if one_ms is None else control["iterations_mean"] * one_ms
    rows.append(_row("MPC, one solve", "CasADi map and Ipopt", mpc["ours_ms"], mpc["ms"], floor_ms=floor_ms))
    return rows


def peer_lines(rows: list[Figures]) -> list[str]:
    """Return the rows as a table of text."""
    lines = [f"{'task':<30} {'peer':<24} {'peer, ms':>11} {'ours, ms':>10} {'floor, ms':>10} {'ratio':>9}"]
    for row in rows:
        floor = "" if row["floor_ms"] is None else f"{row['floor_ms']:.3f}"
        bound = ">=" if row["at_least"] else ""
        lines.append(
            f"{row['task']:<30} {row['peer']:<24} {row['peer_ms']:>11.2f} {row['ours_ms']:>10.3f} "
            f"{floor:>10} {bound + format(row['over_ours'], '.1f'):>9}"
        )
    return lines


def _row(
    task: str,
    peer: str,
    ours_ms: float,
    peer_ms: float,
    at_least: bool = False,
    *,
    floor_ms: float | None = None,
) -> Figures:
    return {
        "task": task,
        "peer": peer,
        "ours_ms": ours_ms,
        "peer_ms": peer_ms,
        "at_least": at_least,
        "over_ours": peer_ms / ours_ms,
        "floor_ms": floor_ms,
    }
