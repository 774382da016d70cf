"""Pairs of processes that plan and fly in one folder at once, and what is wrong with the files they leave.

`python -m tests.sessions.pairs 100 20` counts faults of 100 pairs in lock-step and of 20 in real time.
"""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from trimtab.host.base.errors import TrimtabError
from trimtab.host.link.simulated import TRUTH_SUFFIX
from trimtab.host.log import Flight, read_flight
from trimtab.protocol.blobs import blob_id
from trimtab.sitl.seeds import session_uid

TRIMTAB = (sys.executable, "-m", "trimtab.host.cli")
REFERENCE = "short.ref"
ROUTE = 'name = "{name}"\ntotal_time_s = 1.0\nwaypoints_m = [[0.0, 0.0, -0.6], [{north}, 0.0, -0.6]]\n'

Vehicle = tuple[str, str, str]
"""A vehicle that is served: its port, the address of its cameras, and its session uid."""
Answer = tuple[int, dict[str, Any], str]
"""Exit code, JSON answer and messages of a process."""


def plan_short(folder: Path) -> None:
    """Write two routes of short flights, and the reference of one, to the folder."""
    for name, north in (("short", 0.02), ("long", 0.1)):
        (folder / f"{name}.toml").write_text(ROUTE.format(name=name, north=north), encoding="utf-8")
    words = ("plan", "short.toml", "-o", REFERENCE)
    subprocess.run([*TRIMTAB, *words], cwd=folder, check=True, capture_output=True)


def plan_pair(folder: Path) -> list[str]:
    """Plan two routes to one reference at once. Return what is wrong with reference and record."""
    words = ("-o", "either.ref", "--force")
    answers = _together(folder, [("plan", f"{name}.toml", *words) for name in ("short", "long")])
    faults = [f"plan: exit code {code}: {errors}" for code, _, errors in answers if code not in (0, 2)]
    if all(code != 0 for code, _, _ in answers):
        return [*faults, "plan: neither reference was written"]
    record = json.loads((folder / "either.ref.json").read_text("utf-8"))
    if record["reference"] != blob_id((folder / "either.ref").read_bytes()):
        faults.append("either.ref.json: of another reference")
    return faults


def fly_lockstep_pair(folder: Path) -> list[str]:
    """Start two flights in worlds of different seeds at once. Return what is wrong with what they left."""
    worlds = (1, 2)
    answers = _together(folder, [("fly", REFERENCE, "--world-seed", str(seed)) for seed in worlds])
    faults = []
    for seed, answer in zip(worlds, answers, strict=True):
        flight = _flight(folder, answer, faults)
        if flight is not None:
            faults += _truth_faults(flight, seed)
    return faults + _others(folder, answers)


def fly_port_pair(folder: Path, vehicles: Sequence[Vehicle]) -> list[str]:
    """Start a flight of each of the vehicles in real time. Return what is wrong with what they left."""
    commands = [("fly", REFERENCE, "--port", port, "--mocap", mocap) for port, mocap, _ in vehicles]
    answers = _together(folder, commands)
    faults: list[str] = []
    for (_, _, uid), answer in zip(vehicles, answers, strict=True):
        flight = _flight(folder, answer, faults)
        if flight is not None and flight.metadata["session_uid"] != uid:
            faults.append(f"{flight.path.name}: of another vehicle")
    return faults + _others(folder, answers)


@contextmanager
def two_vehicles(folder: Path) -> Iterator[list[Vehicle]]:
    """Serve two vehicles at ports, with the short reference on board."""
    with ExitStack() as stack:
        vehicles = []
        for seed in (1, 2):
            mocap, truth = _free_address(), folder / f"vehicle-{seed}.truth.json"
            words = ("--world-seed", str(seed), "--truth", str(truth))
            process = _start(folder, ("sitl", "--port", "tcp:127.0.0.1:0", "--mocap", mocap, *words))
            stack.callback(process.communicate)
            stack.callback(process.kill)
            assert process.stdout is not None
            port = process.stdout.readline().strip()
            upload = [*TRIMTAB, "upload", REFERENCE, "--port", port]
            subprocess.run(upload, cwd=folder, check=True, capture_output=True)
            vehicles.append((port, mocap, json.loads(truth.read_text("utf-8"))["uid"]))
        yield vehicles


def _free_address() -> str:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return f"udp://127.0.0.1:{probe.getsockname()[1]}"


def _start(folder: Path, words: Sequence[str]) -> subprocess.Popen[str]:
    pipe = subprocess.PIPE
    return subprocess.Popen([*TRIMTAB, *words, "--json"], cwd=folder, stdout=pipe, stderr=pipe, text=True)


def _together(folder: Path, commands: Sequence[Sequence[str]]) -> list[Answer]:
    """Start all commands, then return their answers."""
    answers = []
    for process in [_start(folder, words) for words in commands]:
        answer, errors = process.communicate(timeout=240)
        lines = answer.strip().splitlines()
        answers.append((process.returncode, json.loads(lines[-1]) if lines else {}, errors.strip()))
    return answers


def _flight(folder: Path, answer: Answer, faults: list[str]) -> Flight | None:
    """Return the flight whose log a process reported, or None. Add to the faults what is wrong with it."""
    code, result, errors = answer
    if code != 0 or "log_id" not in result:
        faults.append(f"exit code {code}: {errors}")
        return None
    try:
        flight = read_flight(folder / result["log"])
    except TrimtabError as error:
        faults.append(str(error))
        return None
    if flight.id != result["log_id"]:
        faults.append(f"{flight.path.name}: not the log that was reported")
    if json.loads((folder / f"{REFERENCE}.json").read_text("utf-8"))["reference"] != flight.reference_id:
        faults.append(f"{REFERENCE}.json: of another reference")
    return flight


def _truth_faults(flight: Flight, world_seed: int) -> list[str]:
    """Return what is wrong with the truth beside the log of a flight in a world of this seed."""
    truth = flight.path.with_name(f"{flight.path.name}{TRUTH_SUFFIX}")
    if not truth.is_file():
        return [f"{flight.path.name}: no truth file"]
    record = json.loads(truth.read_text("utf-8"))
    uid = f"{session_uid(world_seed, int(flight.metadata['flight'])):016x}"
    expected = (world_seed, flight.id, uid, flight.metadata["session_uid"])
    if (record["world_seed"], record["log"], record["uid"], record["uid"]) != expected:
        return [f"{truth.name}: of another flight"]
    return []


def _others(folder: Path, answers: Sequence[Answer]) -> list[str]:
    """Return faults for a log that two processes reported, and for parts left in the folder."""
    logs = [answer.get("log") for _, answer, _ in answers]
    faults = [] if len(set(logs)) == len(logs) else [f"both reported {logs[0]}"]
    return faults + [f"{path.name}: left" for path in sorted(folder.glob("*.part"))]


def main() -> None:
    """Run as many pairs as the arguments say, each kind in a folder of its own, and count their faults."""
    lockstep, realtime = map(int, sys.argv[1:])
    for name, count in (("lock-step", lockstep), ("real time", realtime)):
        faults: list[str] = []
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            plan_short(folder)
            for _ in range(count):
                if name == "lock-step":
                    faults += plan_pair(folder) + fly_lockstep_pair(folder)
                else:
                    with two_vehicles(folder) as vehicles:
                        faults += fly_port_pair(folder, vehicles)
                    for truth in folder.glob("vehicle-*.truth.json"):
                        truth.unlink()
            logs, truths = (len(list(folder.glob(f"short-*.mcap{end}"))) for end in ("", TRUTH_SUFFIX))
        print(
            f"{name}: {count} pairs, {logs} logs, {truths} truth files, {len(faults)} faults",
            *faults,
            sep="\n  ",
        )


if __name__ == "__main__":
    main()
