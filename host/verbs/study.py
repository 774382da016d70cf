"""`trimtab study`: run a study over many worlds or over the paper's set-ups."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from trimtab.host.verbs.options import Json, Output, Trust, VehicleName, WorkspaceFolder
from trimtab.host.workspace import DEFAULT_VEHICLE

REPORT_NAME, JSON_NAME = "report.html", "report.json"


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class StudyOptions:
    """Options of `trimtab study`.

    Attributes
    ----------
    seed
        Seed of worlds, flights and first weights.
    worlds
        Number of worlds. Default: 30 for blind (918 in full size), 20 for calibrate, 5 for correction,
        labels and the paper's studies.
    jobs
        Number of processes. Default: one for each core.
    quick
        Run a small study to check that everything works. For controller-tuning, correction, labels, link and
        the paper's studies.
    plant
        Simulator whose plant the worlds have instead of ours: rotorpy or crazyflow. For blind.
    few_flights
        Share of the worlds, 0 to 1, that are also traced from one flight and from one pair of flights.
        Default: 1. For blind.
    baselines
        Also score other methods on the same logs. For blind.
    real
        TOML file with groups of recorded flights. They are also traced, and the error is measured on held-out
        flights. For blind.
    secret
        File with a random secret that the worlds come from, instead of the seed. Made if it does not exist.
        Its SHA-256 is printed at the start, the secret stands in the report. For blind.
    first
        Fly and score only the first N worlds, in the order of their numbers. Publishes a study that was
        stopped. For blind.
    shard
        Run only part I of N of the study (I/N), such as 1/4. Several machines share a study so, each with its
        own folder. For all studies but controller-tuning and real.
    merge
        Folder that --shard wrote; give the option once for each. Copy their files, and write the report of
        the whole study.
    output
        Folder for state and report. Default: study-NAME-SEED in the workspace, study-NAME-PLANT-SEED with a
        plant, with the name of the file instead of the seed for a secret.
    """

    seed: int = 1
    worlds: int | None = None
    vehicle: VehicleName = DEFAULT_VEHICLE
    jobs: int | None = None
    quick: Annotated[bool, Parameter(negative="")] = False
    plant: str | None = None
    few_flights: float | None = None
    baselines: Annotated[bool, Parameter(negative="")] = False
    real: Path | None = None
    secret: Path | None = None
    first: int | None = None
    shard: str | None = None
    merge: tuple[Path, ...] = ()
    output: Output = None
    workspace: WorkspaceFolder = None
    trust: Trust = False
    json: Json = False


DEFAULTS = StudyOptions()


def command(name: str, flights: Path | None = None, *, options: StudyOptions = DEFAULTS) -> None:
    """Run a study. An interrupted study resumes.

    Parameters
    ----------
    name
        Study to run: blind (tracing in sealed worlds), calibrate (thresholds of tracing), controller-tuning
        (settings of the controller files), correction (flown error without and with the correction of a
        model), labels (the paper's Neural-C from smoothed and from true labels), link (uploads over a lossy
        radio link, interrupted uploads, fuzzing), paper-learning, paper-planning, paper-controllers,
        paper-flight (sections of the paper), real (verdicts on recorded flights against their labels).
    flights
        TOML file with groups of recorded flights. For real.
    """
    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import UsageError
    from trimtab.host.base.output import emit, say
    from trimtab.host.base.parallel import check_jobs, cores
    from trimtab.host.base.progress import Progress
    from trimtab.host.base.shards import ShardDone, merge, parse_shard
    from trimtab.host.studies import find_study, options_of
    from trimtab.host.workspace import open_workspace

    study = find_study(name)
    if options.seed < 0:
        raise UsageError(f"--seed {options.seed} is negative; give 0 or more")
    check_jobs(options.jobs)
    settings = {"seed": options.seed, "worlds": options.worlds, "quick": options.quick}
    settings |= {} if options.plant is None else {"plant": options.plant}
    shard = None if options.shard is None else parse_shard(options.shard, settings)
    if options.merge and shard is not None:
        raise UsageError("give --shard or --merge, not both")
    study_options = options_of(
        study,
        {
            "shard": shard or options.merge or None,
            "worlds": options.worlds,
            "quick": options.quick,
            "plant": options.plant,
            "few_flights": options.few_flights,
            "with_baselines": options.baselines,
            "real": options.real,
            "secret": options.secret,
            "first": options.first,
            "flights": flights,
        },
        {
            "shard": "--merge" if options.merge else "--shard",
            "worlds": "--worlds",
            "quick": "--quick",
            "plant": "--plant",
            "few_flights": "--few-flights",
            "with_baselines": "--baselines",
            "real": "--real",
            "secret": "--secret",
            "first": "--first",
            "flights": "FLIGHTS.toml",
        },
        name,
    )
    space = open_workspace(options.workspace, trusted=options.trust)
    space.vehicle(options.vehicle)
    file = Path(options.vehicle)
    label = str(options.seed) if options.secret is None else options.secret.stem
    words = [name, *([] if options.plant is None else [options.plant]), label]
    folder = options.output if options.output is not None else space.root / "-".join(["study", *words])
    artefacts.check_folder(folder, ())
    if options.merge:
        del study_options["shard"]
        merge(options.merge, folder, settings)
    try:
        with Progress(f"study {name}", total=1.0) as progress:
            outcome = study(
                folder=folder,
                seed=options.seed,
                vehicle=str(file.absolute()) if file.is_file() else options.vehicle,
                jobs=options.jobs or cores(),
                on_progress=lambda done, total, detail: progress.update(done, total=total, detail=detail),
                **study_options,
            )
    except ShardDone as end:
        say(f"{end}; `trimtab study {name} --merge FOLDER...` joins the folders of all shards")
        emit({"study": name, "shard": options.shard, "pieces": end.done, "of": end.total}, options.json)
        return
    answer = _write(folder, outcome, artefacts.provenance(seed=options.seed))
    say(*outcome["lines"], f"the report is {answer['report']}")
    emit(answer, options.json)


def _write(folder: Path, outcome: Mapping[str, Any], provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Write pictures, report and JSON of a study; return the answer with the report's path."""
    from trimtab.host.base import artefacts
    from trimtab.host.base.output import json_text
    from trimtab.host.report.studies import REPORTS

    reporter = REPORTS[outcome["answer"]["study"]]
    pictures = reporter.pictures(outcome)
    for stem, picture in pictures.items():
        artefacts.write_atomic(folder / f"{stem}.png", picture.png, force=True)
    artefacts.write_atomic(folder / REPORT_NAME, reporter.page(outcome, pictures, provenance), force=True)
    answer = {**outcome["answer"], "report": str(folder / REPORT_NAME)}
    record = {**answer, "provenance": provenance, "scores": outcome["scores"]}
    artefacts.write_atomic(folder / JSON_NAME, json_text(record), force=True)
    return answer
