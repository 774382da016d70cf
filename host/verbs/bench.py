"""`trimtab bench`: speed on this machine, beside named peers in the same run."""

from __future__ import annotations

from typing import Any

from host.verbs.options import DEFAULT_VEHICLE, Json, VehicleName, WorkspaceFolder


def command(
    *,
    vehicle: VehicleName = DEFAULT_VEHICLE,
    seed: int = 1,
    workspace: WorkspaceFolder = None,
    json: Json = False,
) -> None:
    """Measure how fast learning and simulated sessions are on this machine; half a minute.

    JAX and diffrax compute the same gradient in the same run where they are installed (`make bench` installs
    them): most of a minute more.

    Parameters
    ----------
    seed
        Flights and first weights are drawn from it.
    """
    from host.bench import learning, session
    from host.errors import UsageError
    from host.output import emit, say
    from host.progress import Progress
    from host.workspace import open_workspace

    if seed < 0:
        raise UsageError(f"--seed {seed} is negative, give 0 or more")
    craft = open_workspace(workspace).vehicle(vehicle)
    with Progress("bench", total=float(len(learning.STEPS) + 1)) as progress:
        done = iter(range(len(learning.STEPS)))
        found = learning.measure(craft, seed, lambda step: progress.update(next(done), detail=step))
        progress.update(len(learning.STEPS), detail="session")
        factor = session.realtime_factor(craft)
    say(*_lines(found), f"simulated sessions run {factor:.1f} times as fast as the clock")
    emit({"learning": found, "session": {"realtime_factor": factor}}, json)


def _lines(found: dict[str, Any]) -> list[str]:
    """The figures of learning, for people."""
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
