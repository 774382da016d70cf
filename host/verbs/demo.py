"""`trimtab demo`: one complete cycle of plan, fly, trace and plan again, with a report."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import count
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
    jobs, world = cores(), world or WORLD
    field = Airfield(vehicle=airframe, world=world, world_seed=world_seed(seed), session={})
    with free_folder(space.root, output, force) as folder, workers(jobs) as pool:
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


@contextmanager
def free_folder(root: Path, output: Path | None, force: bool) -> Iterator[Path]:
    """Yield `output`, or the next free folder in `root`, in which only this process writes.

    With `force`, it may hold files. Raises UsageError.
    """
    from trimtab.host.base.artefacts import own_folder
    from trimtab.host.base.parts import NameTaken

    with ExitStack() as stack:
        if output is not None or force:
            yield stack.enter_context(own_folder(output or root / FOLDER, force))
            return
        for number in count(1):
            name = FOLDER if number == 1 else f"{FOLDER}-{number}"
            try:
                folder = stack.enter_context(own_folder(root / name))
            except NameTaken:
                continue
            yield folder
            return
