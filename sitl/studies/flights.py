"""Flights of a world: plan references once for a study, fly through firmware and radio, seal the truth."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from trimtab.sitl.studies.commandline import run_apart, run_inside
from trimtab.sitl.studies.files import StudyError, read_json, sha256_of, write_json, write_whole
from trimtab.sitl.studies.plants import PLANTS
from trimtab.sitl.studies.worlds import PlannedWorld, redrawn_seed


@dataclass(frozen=True, kw_only=True)
class Programme:
    """Flights in every world: learning routes flown `repeats` times each, and held-out routes.

    A route is a file in the folder `routes`, or a name that the command line knows.
    """

    routes: Path
    learning: tuple[str, ...]
    held_out: tuple[str, ...]
    repeats: int = 2

    def flights(self) -> list[tuple[str, str, int]]:
        """Return log name, route and flight index of every flight of a world, repeat flights first."""
        flights = [(f"{name}-{k}", name) for name in self.learning for k in range(1, self.repeats + 1)]
        flights += [(name, name) for name in self.held_out]
        return [(log, name, index) for index, (log, name) in enumerate(flights, start=1)]

    def logs(self, routes: tuple[str, ...]) -> list[str]:
        """Return the file names of the logs of these routes."""
        return [f"{log}.mcap" for log, name, _ in self.flights() if name in routes]

    def still(self, *, each: bool) -> list[tuple[str, str, int]]:
        """Return the same for flights in still air: one for each learning route.

        With `each`, return one for every repeat flight, because each has a different battery charge.
        """
        if each:
            return [flight for flight in self.flights() if flight[1] in self.learning]
        return [(name, name, index) for index, name in enumerate(self.learning, start=1)]

    def route(self, name: str) -> str:
        """Return the route of this name as an argument for the command line."""
        path = self.routes / f"{name}.toml"
        return str(path) if path.is_file() else name


BLIND = Programme(
    routes=Path(str(files("trimtab.sitl.studies"))) / "routes",
    learning=("quick", "low", "climbs", "sprint"),
    held_out=("check-loop", "check-points"),
)
"""Quick turns, flight near the ground with headings, vertical motion, accelerations; 12 s each."""

TRUTH, VERDICT, SCORE = "truth.json", "verdict.json", "score.json"
"""Files of the three stages of a world. Each exists when its stage is done."""

FEW = {"one flight": "verdict-one-flight.json", "one pair": "verdict-one-pair.json"}
"""Files of the verdicts on a part of the flights; they exist before VERDICT, in worlds that have them."""

FLIGHTS, STILL, PLAIN = "flights", "still", "plain"
"""Folders of the traced flights, of those in still air, and of those in still air without the effects. Only
the scoring opens the last two.
"""

ATTEMPTS = 30
"""Greatest number of draws of a world, until the vehicle can fly it."""

_LOG_TRUTH, _WORLD = ".truth.json", "world.toml"


def plan_references(folder: Path, vehicle: str, programme: Programme) -> Path:
    """Plan the study's references that do not exist yet, and return their folder.

    Raises StudyError if one cannot be planned.
    """
    target = folder / "references"
    target.mkdir(exist_ok=True)
    for name in (*programme.learning, *programme.held_out):
        plan_route(target, name, programme.route(name), vehicle)
    return target


def plan_route(folder: Path, name: str, route: str, vehicle: str) -> None:
    """Plan the reference `name` of a route in `folder` if it does not exist yet.

    Raises StudyError if it cannot be planned.
    """
    if (folder / f"{name}.ref").is_file():
        return
    done = run_apart(["plan", route, "--vehicle", vehicle, "-o", f"{name}.ref", "--force"], folder)
    if done.code:
        raise StudyError(f"the study's route {name} cannot be planned for {vehicle}: {done.errors.strip()}")


def fly_and_seal(
    world: PlannedWorld, folder: Path, references: Path, vehicle: str, programme: Programme
) -> str:
    """Fly a world in `folder`, seal its truth and return the truth's SHA-256. Existing files stay.

    If a vehicle file with the name of a reference lies beside it, that vehicle flies it. If a flight fails,
    a `wide` world is drawn again. In other worlds it counts, as far as it has a log. Raises StudyError if a
    world cannot be flown.
    """
    if (folder / TRUTH).is_file():
        return sha256_of(folder / TRUTH)
    for attempt in range(ATTEMPTS):
        drawn = replace(world, seed=redrawn_seed(world.seed, attempt))
        if _fly_all(drawn, folder, references, vehicle, programme):
            return _seal(drawn, folder, vehicle, programme, redrawn=attempt)
    raise StudyError(
        f"world {world.name}: {vehicle} did not fly it in any of {ATTEMPTS} draws; choose another seed"
    )


def _fly_all(world: PlannedWorld, folder: Path, references: Path, vehicle: str, programme: Programme) -> bool:
    """Fly all flights of a world, and return whether it counts: not if it is `wide` and a flight failed."""
    still = programme.still(each="battery-sag" in world.kinds)
    places = {FLIGHTS: (world.toml(), programme.flights())}
    places |= {place: (each.toml(still=True), still) for place, each in _still_worlds(world).items()}
    for place, (file, flights) in places.items():
        (folder / place).mkdir(parents=True, exist_ok=True)
        for name, route, index in flights:
            log = folder / place / f"{name}.mcap"
            whole = _fly(world, file, references / route, index, vehicle, log)
            if world.wide and not whole:
                _truth_path(log).unlink()
                return False
    return True


def _still_worlds(world: PlannedWorld) -> dict[str, PlannedWorld]:
    """Return the worlds to fly in still air, by folder."""
    if world.kind_class == "outside":
        return {STILL: world, PLAIN: world.without_effects()}
    return {STILL: world} if world.is_measured else {}


def _seal(world: PlannedWorld, folder: Path, vehicle: str, programme: Programme, *, redrawn: int) -> str:
    """Write the truth of a flown world and remove the files that it is from; return its SHA-256."""
    logs = [folder / FLIGHTS / f"{name}.mcap" for name, _, _ in programme.flights()]
    sealed = read_json(_truth_path(logs[-1]))
    truth = {
        "world": world.name,
        "class": world.kind_class,
        "kinds": list(world.kinds),
        "case": world.case,
        "plant": world.plant,
        "file": world.toml(),
        "seed": world.seed,
        "redrawn": redrawn,
        "vehicle": vehicle,
        "effects": sealed["effects"],
        "deviations": sealed["deviations"],
        "turbulence": sealed["turbulence"],
        "flights": [{"log": log.name, "sha256": sha256_of(log)} for log in logs],
    }
    write_json(folder / TRUTH, truth)
    for path in folder.glob(f"*/*{_LOG_TRUTH}"):
        path.unlink()
    (folder / _WORLD).unlink()
    return sha256_of(folder / TRUTH)


def _fly(world: PlannedWorld, file: str, reference: Path, index: int, vehicle: str, log: Path) -> bool:
    """Fly in the world `file`, and write the log with its truth beside it, unless they exist.

    `reference` is a path without suffix. Returns whether the flight ended as planned. Raises StudyError if
    there is no log of it.
    """
    if _truth_path(log).is_file() and read_json(_truth_path(log))["world_seed"] == world.seed:
        return True
    path = log.parent.parent / _WORLD
    write_whole(path, file.encode())
    vehicle_file = reference.with_name(f"{reference.name}.toml")
    craft = str(vehicle_file) if vehicle_file.is_file() else vehicle
    words = ["fly", f"{reference}.ref", "--vehicle", craft, "--world", str(path)]
    words += ["--world-seed", str(world.seed), "--flight", str(index), "--seed", str(index)]
    words += [] if world.plant is None else ["--plant", PLANTS[world.plant].spec]
    done = run_inside([*words, "-o", str(log), "--force"])
    if done.code not in (0, 1) or not _truth_path(log).is_file():
        raise StudyError(f"world {world.name}, flight {log.stem}: {done.errors.strip()}")
    return done.code == 0


def _truth_path(log: Path) -> Path:
    return log.with_name(log.name + _LOG_TRUTH)


def trace(
    folder: Path,
    programme: Programme,
    copy: Callable[[Path, Path], object] = shutil.copyfile,
    *,
    few: bool = False,
) -> None:
    """Trace the world's logs and write the verdict to `folder`, unless it exists.

    The command line runs in a process of its own, whose environment, arguments and folder contain no path of
    the study; the folder holds only the copies that `copy` makes of the logs, and is removed. With `few`,
    it also traces the first flight alone, and the first route's repeat flights.
    """
    if (folder / VERDICT).is_file():
        return
    learning = programme.logs(programme.learning)
    if few:
        for file, count in zip(FEW.values(), (1, programme.repeats), strict=True):
            _trace(folder / file, learning[:count], [], copy)
    _trace(folder / VERDICT, learning, programme.logs(programme.held_out), copy)


def _trace(
    target: Path, logs: Sequence[str], held_out: Sequence[str], copy: Callable[[Path, Path], object]
) -> None:
    """Trace these logs of the world in `target`'s folder, and write the verdict to `target`."""
    if target.is_file():
        return
    with TemporaryDirectory(prefix="trimtab-trace-") as bare:
        for log in (*logs, *held_out):
            copy(target.parent / FLIGHTS / log, Path(bare) / log)
        write_json(target, ask(Path(bare), logs, held_out))


def ask(
    folder: Path, logs: Sequence[str], held_out: Sequence[str], baseline: Sequence[str] = ()
) -> dict[str, Any]:
    """Run `trimtab trace` on the logs in `folder`, and return exit_code, answer, errors and trace_s.

    `baseline` are the logs from before the change. No network is trained, because it does not affect the
    verdict.
    """
    words = ["trace", *logs, "--no-network", *(["--hold-out", *held_out] if held_out else [])]
    words += ["--baseline", *baseline] if baseline else []
    done = run_apart(words, folder, alone=True)
    return {"exit_code": done.code, "answer": done.data, "errors": done.errors, "trace_s": done.cpu_s}
