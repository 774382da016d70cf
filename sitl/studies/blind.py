"""The blind study: draw worlds, fly them, seal their truths, trace the logs, score once.

Every world has its own folder with a file for each completed stage, so an interrupted study resumes. This
process writes the ledger; worker processes do the rest.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from pathlib import Path
from tempfile import gettempdir
from typing import Any

from trimtab.host.base.output import say
from trimtab.host.base.pieces import OnProgress, alone_in, claim
from trimtab.host.base.program import CHANGED, git_state, version
from trimtab.host.base.shards import Shard, ShardDone
from trimtab.host.base.workers import process_pool
from trimtab.host.vehicle import load_vehicle
from trimtab.sitl.studies.files import Ledger, StudyError, read_json, sha256_of
from trimtab.sitl.studies.flights import (
    BLIND,
    SCORE,
    TRUTH,
    VERDICT,
    Programme,
    fly_and_seal,
    plan_references,
    trace,
)
from trimtab.sitl.studies.plants import check_plant
from trimtab.sitl.studies.recorded import judge_real, read_groups
from trimtab.sitl.studies.scoring.baselines import BASELINES, judge_others
from trimtab.sitl.studies.scoring.metrics import baseline_rows, confusion, deviations, summary
from trimtab.sitl.studies.scoring.world import library, score_world
from trimtab.sitl.studies.secret import commitment, read_secret
from trimtab.sitl.studies.table import (
    baseline_table,
    failure,
    false_certainties,
    kind_tables,
    lines,
    real_table,
    table,
    thin_table,
    truth_table,
)
from trimtab.sitl.studies.thin import copier_of, plan_thin_references, programme_of
from trimtab.sitl.studies.worlds import PlannedWorld, plan_worlds

LEDGER = "ledger.json"

_FLOWN, _JUDGED = 1.0, 2.0
"""Shares of a world's work."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """The work on one world."""

    world: PlannedWorld
    folder: Path
    references: Path
    ledger: Path
    vehicle: str
    programme: Programme
    with_baselines: bool


def run(  # noqa: PLR0913 (one keyword for each option)
    *,
    folder: Path,
    seed: int,
    vehicle: str,
    jobs: int,
    worlds: int = 30,
    plant: str | None = None,
    few_flights: float = 1.0,
    with_baselines: bool = False,
    real: Path | None = None,
    secret: Path | None = None,
    programme: Programme = BLIND,
    first: int | None = None,
    shard: Shard | None = None,
    on_progress: OnProgress = lambda done, total, detail: None,
) -> dict[str, Any]:
    """Run the blind study, or resume it; return its outcome as plain data.

    The outcome has `answer` (the JSON object), `lines` (text for the terminal), `table`, `tables`, `thin`,
    `real`, `baselines`, `confusion`, `deviations` (errors in reported sd by family), `wrong` and `scores`.

    Parameters
    ----------
    folder
        State and results; an interrupted study resumes.
    jobs
        Number of processes.
    plant
        Name in `plants.PLANTS`: fly in the plant of that simulator, worlds of the classes IN_PLANTS.
    few_flights
        Share of the worlds inside the library that are also traced from one flight and from one pair.
    real
        File with groups of recorded flights that are traced too.
    secret
        File with the secret that the worlds come from, instead of the seed; made if it does not exist.
    programme
        Flights in every world.
    first
        Number of worlds, in the order of their numbers, that are flown and scored. Default: all.
    shard
        Fly and score its worlds alone.

    Raises
    ------
    UsageError
        The folder holds another study or is in use.
    StudyError
        `first` is not in 1..`worlds`, a route cannot be planned, a world cannot be flown, the plant is
        unknown or not installed, the secret is invalid, or temporary files would lie in the folder.
    SealBroken
        A truth has changed since it was sealed.
    """
    check_plant(plant)
    identity, published = _identity(seed, secret)
    source = seed if published["secret"] is None else int(published["secret"], 16)
    planned = plan_worlds(source, worlds, library(), few_flights, plant)
    if first is not None and not 1 <= first <= worlds:
        raise StudyError(f"--first {first}: the study has {worlds} worlds; give 1 to {worlds}")
    groups = [] if real is None else read_groups(real)
    folder = folder.absolute()
    folder.mkdir(parents=True, exist_ok=True)
    if Path(gettempdir()).resolve().is_relative_to(folder.resolve()):
        raise StudyError(f"{folder}: holds the folder for temporary files; set TMPDIR to another one")
    with alone_in(folder):
        references = plan_references(folder, vehicle, programme)
        plan_thin_references(folder, vehicle, programme)
        claim(folder, {
            "study": "blind",
            **identity,
            "worlds": worlds,
            "plant": plant,
            "few_flights": few_flights,
            "vehicle": load_vehicle(vehicle).id,
            "references": {path.stem: sha256_of(path) for path in sorted(references.glob("*.ref"))},
            "kinds": sorted({kind for world in planned for kind in world.kinds}),
            **({} if shard is None else shard.record()),
        })  # fmt: skip
        ledger = Ledger(folder / LEDGER)
        tasks = [
            Task(
                world=world,
                folder=folder / "worlds" / world.name,
                references=references,
                ledger=folder / LEDGER,
                vehicle=vehicle,
                programme=programme_of(world.case, programme),
                with_baselines=with_baselines and world.case is None,
            )
            for world in planned[:first]
        ]
        _work(tasks if shard is None else shard.of(tasks), ledger, jobs, on_progress)
        scored = sum(map(is_done, tasks))
        if shard is not None and scored < len(tasks):
            raise ShardDone(shard, scored, len(tasks))
        scores = [_scores(task) for task in tasks]
        done = len(tasks) * (_FLOWN + _JUDGED)
        recorded = judge_real(groups, folder, lambda _, detail: on_progress(done, done, detail), jobs=jobs)
    setup = {**published, "worlds": worlds, "first": first, "plant": plant, "folder": str(folder)}
    return _outcome(setup, scores, recorded)


def _identity(seed: int, secret: Path | None) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what the folder records of the source of the worlds, and what the report publishes.

    A study with a secret also records its program: it cannot be resumed with another one. Raises StudyError
    if files of that program are changed and not committed, since nobody else would have them.
    """
    if secret is None:
        return {"seed": seed}, {"seed": seed, "secret": None, "secret_sha256": None}
    program = git_state()
    if program is not None and program.endswith(CHANGED):
        raise StudyError(
            f"--secret: this program has changes that are not committed ({program}); commit them"
        )
    text = read_secret(secret)
    digest = commitment(text)
    say(f"the worlds come from a secret with SHA-256 {digest}; publish it before the study ends")
    identity = {"secret_sha256": digest, "program": [version(), program]}
    return identity, {"seed": None, "secret": text, "secret_sha256": digest}


def _outcome(
    setup: Mapping[str, Any], scores: list[dict[str, Any]], recorded: list[dict[str, Any]]
) -> dict[str, Any]:
    """Return the outcome of a study from the scores of its worlds and of recorded flights."""
    figures, baselines = summary(scores), baseline_rows(scores)
    return {
        "answer": {"study": "blind", **setup, **figures, "baselines": baselines, "real": recorded},
        "lines": [f"plant: {setup['plant'] or 'own'}", *lines(figures, scores, baselines, recorded)],
        "table": table(figures),
        "tables": {"Truth in two columns": truth_table(figures), **kind_tables(figures)},
        "thin": thin_table(figures),
        "real": real_table(recorded),
        "baselines": baseline_table(baselines),
        "confusion": confusion(scores),
        "deviations": deviations(scores),
        "wrong": [
            (s["world"], reason)
            for s in scores
            for reason in [*filter(None, [failure(s)]), *false_certainties(s)]
        ],
        "scores": scores,
    }


def _work(tasks: list[Task], ledger: Ledger, jobs: int, on_progress: OnProgress) -> None:
    """Score every task. Tasks that are already scored are only checked."""
    to_fly: list[Task] = []
    to_judge: list[Task] = []
    done = 0.0
    for task in tasks:
        if (task.folder / VERDICT).is_file() or (task.folder / SCORE).is_file():
            ledger.check(task.world.name, sha256_of(task.folder / TRUTH))
        if is_done(task):
            done += _FLOWN + _JUDGED
        else:
            to_fly.append(task)
    total = len(tasks) * (_FLOWN + _JUDGED)
    on_progress(done, total, "")
    if not to_fly:
        return
    to_fly.reverse()
    running: dict[Future[Any], tuple[Task, bool]] = {}
    pool = process_pool(jobs)
    try:
        while to_fly or to_judge or running:
            while len(running) < jobs and (to_fly or to_judge):
                flown = bool(to_judge)
                task = to_judge.pop() if flown else to_fly.pop()
                running[pool.submit(judge if flown else fly, task)] = (task, flown)
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                task, flown = running.pop(future)
                result = future.result()
                if flown:
                    done += _JUDGED
                    on_progress(done, total, f"world {task.world.name}: {result}")
                else:
                    ledger.record(task.world.name, result)
                    to_judge.append(task)
                    done += _FLOWN
                    on_progress(done, total, f"world {task.world.name} flown and sealed")
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def fly(task: Task) -> str:
    """Fly the task's world unless it is flown, and return the SHA-256 of its sealed truth."""
    task.folder.mkdir(parents=True, exist_ok=True)
    return fly_and_seal(task.world, task.folder, task.references, task.vehicle, task.programme)


def judge(task: Task) -> str:
    """Trace and score the task's world unless that is done, and return the verdict."""
    trace(task.folder, task.programme, copier_of(task.world.case), few=task.world.few)
    score = score_world(task.folder, Ledger(task.ledger), task.programme)
    if task.with_baselines:
        judge_others(task.folder, task.programme)
    return score["verdict"]


def is_done(task: Task) -> bool:
    """Return whether all results of the task exist."""
    others = not task.with_baselines or (task.folder / BASELINES).is_file()
    return (task.folder / SCORE).is_file() and others


def _scores(task: Task) -> dict[str, Any]:
    """Return the score of the task's world, with the answers of other methods if they were requested."""
    others = task.folder / BASELINES
    available = task.with_baselines and others.is_file()
    return {**read_json(task.folder / SCORE), "baselines": read_json(others) if available else None}
