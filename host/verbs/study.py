"""`trimtab study`: a study of many worlds or of the paper's own set-ups."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from trimtab.host.verbs.options import DEFAULT_VEHICLE, Json, Output, VehicleName, WorkspaceFolder

REPORT_NAME, JSON_NAME = "report.html", "report.json"


def command(
    name: str,
    *,
    seed: int = 1,
    worlds: int | None = None,
    vehicle: VehicleName = DEFAULT_VEHICLE,
    jobs: int | None = None,
    quick: Annotated[bool, Parameter(negative="")] = False,
    baselines: Annotated[bool, Parameter(negative="")] = False,
    real: Path | None = None,
    output: Output = None,
    workspace: WorkspaceFolder = None,
    json: Json = False,
) -> None:
    """Run a study. An interrupted study resumes.

    Parameters
    ----------
    name
        Study to run: blind (tracing in sealed worlds), calibrate (measured rules of tracing), link (uploads
        over lossy air, interrupted uploads, fuzz), paper-learning, paper-planning (the paper's sections).
    seed
        Worlds, flights and first weights are drawn from it.
    worlds
        How many worlds; blind: 30 (538 in full size), calibrate: 20, those of the paper: 5.
    jobs
        Processes at a time; one for each core by default.
    quick
        link, paper-learning, paper-planning: a small one, to see that everything works.
    baselines
        blind: judge other methods on the same logs too.
    real
        blind: TOML file with groups of flights that somebody flew: traced beside the worlds, with the error
        on those held out.
    output
        Folder for state and report, by default study-NAME-SEED in the workspace.
    """
    import os

    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import UsageError
    from trimtab.host.base.output import emit, json_text, say
    from trimtab.host.base.progress import Progress
    from trimtab.host.report.studies import REPORTS
    from trimtab.host.studies import find_study, options_of
    from trimtab.host.workspace import open_workspace

    study = find_study(name)
    if seed < 0:
        raise UsageError(f"--seed {seed} is negative, give 0 or more")
    if jobs is not None and jobs < 1:
        raise UsageError(f"--jobs {jobs}: give 1 or more")
    options = options_of(
        study,
        {"worlds": worlds, "quick": quick, "with_baselines": baselines, "real": real},
        {"worlds": "--worlds", "quick": "--quick", "with_baselines": "--baselines", "real": "--real"},
        name,
    )
    space = open_workspace(workspace)
    space.vehicle(vehicle)
    craft = str(Path(vehicle).absolute()) if Path(vehicle).is_file() else vehicle
    folder = output if output is not None else space.root / f"study-{name}-{seed}"
    artefacts.check_folder(folder, ())
    with Progress(f"study {name}", total=1.0) as progress:
        outcome = study(
            folder=folder,
            seed=seed,
            vehicle=craft,
            jobs=jobs or len(os.sched_getaffinity(0)),
            report=lambda done, total, detail: progress.update(done, total=total, detail=detail),
            **options,
        )
    reporter = REPORTS[outcome["answer"]["study"]]
    drawn = reporter.pictures(outcome)
    provenance = artefacts.provenance(seed=seed)
    for stem, picture in drawn.items():
        artefacts.write_atomic(folder / f"{stem}.png", picture.png, force=True)
    artefacts.write_atomic(folder / REPORT_NAME, reporter.page(outcome, drawn, provenance), force=True)
    report = {**outcome["answer"], "report": str(folder / REPORT_NAME)}
    artefacts.write_atomic(folder / JSON_NAME, json_text({**report, "scores": outcome["scores"]}), force=True)
    say(*outcome["lines"], f"the report is {folder / REPORT_NAME}")
    emit(report, json)
