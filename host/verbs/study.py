"""`trimtab study`: a study over many sealed worlds."""

from __future__ import annotations

from pathlib import Path

from host.verbs.options import DEFAULT_VEHICLE, Json, Output, VehicleName, WorkspaceFolder

REPORT_NAME, JSON_NAME = "report.html", "report.json"


def command(
    name: str,
    *,
    seed: int = 1,
    worlds: int = 30,
    vehicle: VehicleName = DEFAULT_VEHICLE,
    jobs: int | None = None,
    baselines: bool = False,
    real: Path | None = None,
    output: Output = None,
    workspace: WorkspaceFolder = None,
    json: Json = False,
) -> None:
    """Run a study over many sealed worlds; one that was cut short goes on where it was.

    Parameters
    ----------
    name
        Study to run: blind.
    seed
        The worlds are drawn from it.
    worlds
        How many; 538 is the study of full size.
    jobs
        Processes at a time; one for each core by default.
    baselines
        Judge other methods on the same logs too.
    real
        TOML file with groups of flights that somebody flew: traced beside the worlds, with the error on those
        held out.
    output
        Folder for state and report, study-NAME-SEED in the workspace by default. What is there is gone on
        with.
    """
    import os

    from host import artefacts
    from host.errors import UsageError
    from host.output import emit, json_text, say
    from host.progress import Progress
    from host.report.study import page, pictures
    from host.studies import find_study
    from host.workspace import open_workspace

    study = find_study(name)
    if seed < 0:
        raise UsageError(f"--seed {seed} is negative, give 0 or more")
    if jobs is not None and jobs < 1:
        raise UsageError(f"--jobs {jobs}: give 1 or more")
    space = open_workspace(workspace)
    space.vehicle(vehicle)
    craft = str(Path(vehicle).absolute()) if Path(vehicle).is_file() else vehicle
    folder = output if output is not None else space.root / f"study-{name}-{seed}"
    artefacts.check_folder(folder, ())
    with Progress(f"study {name}", total=1.0) as progress:
        outcome = study(
            folder=folder,
            seed=seed,
            worlds=worlds,
            vehicle=craft,
            jobs=jobs or len(os.sched_getaffinity(0)),
            with_baselines=baselines,
            real=real,
            report=lambda done, total, detail: progress.update(done, total=total, detail=detail),
        )
    drawn = pictures(outcome)
    provenance = artefacts.provenance(seed=seed)
    for stem, picture in drawn.items():
        artefacts.write_atomic(folder / f"{stem}.png", picture.png, force=True)
    artefacts.write_atomic(folder / REPORT_NAME, page(outcome, drawn, provenance), force=True)
    report = {**outcome["answer"], "report": str(folder / REPORT_NAME)}
    artefacts.write_atomic(folder / JSON_NAME, json_text({**report, "scores": outcome["scores"]}), force=True)
    say(*outcome["lines"], f"the report is {folder / REPORT_NAME}")
    emit(report, json)
