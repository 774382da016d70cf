"""A world's flights: references planned once a study, flown through firmware and radio, the truth sealed."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from trimtab.sitl.studies.commandline import run_apart, run_inside
from trimtab.sitl.studies.files import StudyError, read_json, sha256_of, write_json, write_whole
from trimtab.sitl.studies.worlds import PlannedWorld


@dataclass(frozen=True, kw_only=True)
class Programme:
    """What is flown in every world: routes flown `twins` times each, and others held out.

    A route is a file of the folder `routes`, or else one that the command line knows by its name.
    """

    routes: Path
    learning: tuple[str, ...]
    held_out: tuple[str, ...]
    twins: int = 2

    def flights(self) -> list[tuple[str, str, int]]:
        """Log name, route and flight index of every flight of a world, twins first."""
        flights = [(f"{name}-{twin}", name) for name in self.learning for twin in range(1, self.twins + 1)]
        flights += [(name, name) for name in self.held_out]
        return [(log, name, index) for index, (log, name) in enumerate(flights, start=1)]

    def logs(self, routes: tuple[str, ...]) -> list[str]:
        """File names of the logs of these routes."""
        return [f"{log}.mcap" for log, name, _ in self.flights() if name in routes]

    def still(self, *, each: bool) -> list[tuple[str, str, int]]:
        """Return the same of the flights in still air: one a learning route, or one for `each` of its twins,
        where every flight has a battery of its own.
        """
        if each:
            return [flight for flight in self.flights() if flight[1] in self.learning]
        return [(name, name, index) for index, name in enumerate(self.learning, start=1)]

    def route(self, name: str) -> str:
        """Return the route of this name as the command line takes it."""
        own = self.routes / f"{name}.toml"
        return str(own) if own.is_file() else name


BLIND = Programme(
    routes=Path(str(files("trimtab.sitl.studies"))) / "routes",
    learning=("quick", "low", "climbs", "sprint"),
    held_out=("check-loop", "check-points"),
)
"""Quick turns, the ground and headings, vertical motion, accelerations all round; 12 s each."""

TRUTH, VERDICT, SCORE = "truth.json", "verdict.json", "score.json"
"""The three stages of a world; each file is there when its stage is done."""

STILL = "still"
"""Folder of the flights in still air, which the scorer alone opens."""

_LOG_TRUTH, _WORLD = ".truth.json", "world.toml"


def plan_references(folder: Path, vehicle: str, programme: Programme) -> Path:
    """Return the folder with the study's references, planned by the command line where they are not there
    yet.

    Raises StudyError where one cannot be planned.
    """
    target = folder / "references"
    target.mkdir(exist_ok=True)
    for name in (*programme.learning, *programme.held_out):
        plan_route(target, name, programme.route(name), vehicle)
    return target


def plan_route(folder: Path, name: str, route: str, vehicle: str) -> None:
    """Plan the reference `name` of a route in `folder` if it is not there yet.

    Raises StudyError where it cannot be planned.
    """
    if (folder / f"{name}.ref").is_file():
        return
    done = run_apart(["plan", route, "--vehicle", vehicle, "-o", f"{name}.ref", "--force"], folder)
    if done.code:
        raise StudyError(f"the study's route {name} cannot be planned for {vehicle}: {done.errors.strip()}")


def fly_and_seal(
    world: PlannedWorld, folder: Path, references: Path, vehicle: str, programme: Programme
) -> str:
    """Return the SHA-256 of the world's truth, flown and sealed in `folder`; what is there already stays.

    A reference with a vehicle file of its name beside it is flown by that vehicle. A flight that fails is
    part of the world too, as far as it has left a log.
    """
    if (folder / TRUTH).is_file():
        return sha256_of(folder / TRUTH)
    logs = folder / "flights"
    logs.mkdir(parents=True, exist_ok=True)
    flown = []
    sealed: dict[str, Any] = {}
    for name, route, index in programme.flights():
        log = logs / f"{name}.mcap"
        _fly(world, world.toml(), references / route, index, vehicle, log)
        sealed = read_json(_beside(log))
        flown.append({"log": log.name, "sha256": sha256_of(log)})
    if world.is_measured:
        (folder / STILL).mkdir(exist_ok=True)
        for name, route, index in programme.still(each="battery-sag" in world.kinds):
            log = folder / STILL / f"{name}.mcap"
            _fly(world, world.toml(still=True), references / route, index, vehicle, log)
    truth = {
        "world": world.name,
        "class": world.kind_class,
        "kinds": list(world.kinds),
        "case": world.case,
        "file": world.toml(),
        "seed": world.seed,
        "vehicle": vehicle,
        "effects": sealed["effects"],
        "deviations": sealed["deviations"],
        "turbulence": sealed["turbulence"],
        "flights": flown,
    }
    write_json(folder / TRUTH, truth)
    for beside in folder.glob(f"*/*{_LOG_TRUTH}"):
        beside.unlink()
    (folder / _WORLD).unlink()
    return sha256_of(folder / TRUTH)


def _fly(world: PlannedWorld, file: str, reference: Path, index: int, vehicle: str, log: Path) -> None:
    """Fly and log a world's `file`, unless it was logged, with its truth beside it.

    `reference` is without its suffix. Raises StudyError where it cannot be flown.
    """
    if _beside(log).is_file():
        return
    path = log.parent.parent / _WORLD
    write_whole(path, file.encode())
    own = reference.with_name(f"{reference.name}.toml")
    craft = str(own) if own.is_file() else vehicle
    words = ["fly", f"{reference}.ref", "--vehicle", craft, "--world", str(path)]
    words += ["--world-seed", str(world.seed), "--flight", str(index), "--seed", str(index)]
    done = run_inside([*words, "-o", str(log), "--force"])
    if done.code not in (0, 1) or not _beside(log).is_file():
        raise StudyError(f"world {world.name}, flight {log.stem}: {done.errors.strip()}")


def _beside(log: Path) -> Path:
    return log.with_name(log.name + _LOG_TRUTH)


def trace(folder: Path, programme: Programme, copy: Callable[[Path, Path], object] = shutil.copyfile) -> None:
    """Write the verdict on the world's logs to a file in `folder`, once.

    The command line sees a folder that holds what `copy` makes of each log and nothing else.
    """
    if (folder / VERDICT).is_file():
        return
    bare = folder / "trace"
    shutil.rmtree(bare, ignore_errors=True)
    bare.mkdir()
    for log in (folder / "flights").glob("*.mcap"):
        copy(log, bare / log.name)
    answer = ask(bare, programme.logs(programme.learning), programme.logs(programme.held_out))
    write_json(folder / VERDICT, answer)
    shutil.rmtree(bare)


def ask(folder: Path, logs: Sequence[str], held_out: Sequence[str]) -> dict[str, Any]:
    """Return what `trimtab trace` says of the logs in `folder`: exit_code, answer, errors, trace_s.

    No network is asked for: it predicts what no verdict is about.
    """
    words = ["trace", *logs, "--no-network", *(["--hold-out", *held_out] if held_out else [])]
    done = run_apart(words, folder)
    return {"exit_code": done.code, "answer": done.data, "errors": done.errors, "trace_s": done.cpu_s}
