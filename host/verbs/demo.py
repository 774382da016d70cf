"""`trimtab demo`: one complete cycle of plan, fly, trace and plan again, with a report."""

from __future__ import annotations

from pathlib import Path

from trimtab.host.verbs.options import Force, Json, Output, Trust, VehicleName, WorkspaceFolder
from trimtab.host.workspace import DEFAULT_VEHICLE

FOLDER = "trimtab-demo"


def command(
    *,
    seed: int = 1,
    world: str | None = None,
    vehicle: VehicleName = DEFAULT_VEHICLE,
    output: Output = None,
    workspace: WorkspaceFolder = None,
    trust: Trust = False,
    json: Json = False,
    force: Force = False,
) -> None:
    """Plan, fly, trace the missing effects and plan again, then write a report.

    Parameters
    ----------
    seed
        Seed of the routes and of the simulated world.
    world
        World to fly in, by name or path. Default: one with two or three effects, drawn from the seed.
    output
        Folder for every file. Made if missing. Default: trimtab-demo in the workspace, or the next free name.
    """
    import time

    from trimtab.host.apps.demo.flights import WORLD, Airfield
    from trimtab.host.apps.demo.seeds import world_seed
    from trimtab.host.base.errors import UsageError
    from trimtab.host.base.output import emit, say
    from trimtab.host.base.parallel import cores
    from trimtab.host.base.workers import workers
    from trimtab.host.workspace import open_workspace

    begin_s = time.perf_counter()
    if seed < 0:
        raise UsageError(f"--seed {seed} is negative; give 0 or more")
    space = open_workspace(workspace, trusted=trust)
    airframe = space.vehicle(vehicle)
    folder = free_folder(space.root, output, force)
    jobs, world = cores(), world or WORLD
    field = Airfield(vehicle=airframe, world=world, world_seed=world_seed(seed), session={})
    with workers(jobs) as pool:
        for _ in range(jobs if jobs > 1 else 0):  # they start up while this one imports the rest and plans
            pool.submit(field.check)
        from trimtab.host.api.trace import flyable
        from trimtab.host.apps.demo import report
        from trimtab.host.apps.demo.session import DemoRequest, run_demo
        from trimtab.host.trace.words import result_lines

        outcome = run_demo(
            DemoRequest(vehicle=airframe, folder=folder, seed=seed, world=world, force=force),
            space.effects(),
            pool,
            on_message=say,
            manoeuvres=lambda: flyable(space, airframe),
        )
    seconds = time.perf_counter() - begin_s
    say(
        *result_lines(outcome.result),
        *report.summary(outcome.answer),
        f"done in {seconds:.0f} s; the report is {outcome.answer['report']}",
        f"what the simulated world held is in {outcome.answer['truth']}",
    )
    steps = [{"step": title, "seconds": round(spent, 3)} for title, spent in outcome.steps]
    emit({**outcome.answer, "seconds": round(seconds, 3), "steps": steps}, json)
    if outcome.failure is not None:
        raise outcome.failure


def free_folder(root: Path, output: Path | None, force: bool) -> Path:
    """Return a folder that is empty or does not exist yet; with `force`, any. Raises UsageError."""
    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import UsageError

    if output is None:
        output, number = root / FOLDER, 1
        while output.exists() and not force:
            number += 1
            output = root / f"{FOLDER}-{number}"
    if output.exists() and not output.is_dir():
        raise UsageError(f"{output}: is a file; give a folder")
    if output.is_dir() and any(output.iterdir()) and not force:
        raise UsageError(f"{output}: is not empty; choose another folder or add --force")
    return artefacts.check_folder(output, (), force)
