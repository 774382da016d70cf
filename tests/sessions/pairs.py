"""Pairs of flights that two processes fly from one folder at once, and what is wrong with their logs."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from trimtab.host.base.errors import TrimtabError
from trimtab.host.log import read_flight

TRIMTAB = (sys.executable, "-m", "trimtab.host.cli")
REFERENCE = "short.ref"
ROUTE = 'name = "short"\ntotal_time_s = 1.0\nwaypoints_m = [[0.0, 0.0, -0.6], [0.02, 0.0, -0.6]]\n'

Started = tuple[subprocess.Popen[str], str]
"""A process that flies, and the session uid that only its vehicle has."""


def plan_short(folder: Path) -> None:
    """Write the reference of a short flight to the folder."""
    (folder / "short.toml").write_text(ROUTE, encoding="utf-8")
    subprocess.run([*TRIMTAB, "plan", "short.toml", "-o", REFERENCE], cwd=folder, check=True)
    (folder / "short.toml").unlink()


def fly_lockstep_pair(folder: Path, uid: Callable[[int, int], str]) -> list[str]:
    """Start two flights in worlds of different seeds at once. Return what is wrong with what they left.

    uid: session uid of the vehicle with this seed of the world and this index of the flight.
    """
    worlds = (1, 2)
    started = [_start(folder, "fly", REFERENCE, "--world-seed", str(seed)) for seed in worlds]
    answers = [_answer(process) for process in started]
    faults = [
        fault for code, answer, errors in answers for fault in _log_faults(folder, code, answer, errors)
    ]
    for seed, (_, answer, _) in zip(worlds, answers, strict=True):
        log = folder / answer.get("log", "none")
        truth = log.with_name(f"{log.name}.truth.json")
        if not truth.is_file():
            faults.append(f"{log.name}: no truth file")
            continue
        record = json.loads(truth.read_text("utf-8"))
        if record["world_seed"] != seed or record["log"] != answer["log_id"]:
            faults.append(f"{truth.name}: of another flight")
        elif record["uid"] != uid(seed, record["flight"]):
            faults.append(f"{truth.name}: of another vehicle")
    return faults + _others(folder, [answer.get("log") for _, answer, _ in answers])


def fly_port_pair(folder: Path, vehicles: Sequence[tuple[str, str, str]]) -> list[str]:
    """Start a flight of each of the vehicles in real time. Return what is wrong with what they left.

    vehicles: port, address of the cameras, and session uid of each.
    """
    started = [
        _start(folder, "fly", REFERENCE, "--port", port, "--mocap", mocap) for port, mocap, _ in vehicles
    ]
    answers = [_answer(process) for process in started]
    faults = [
        fault for code, answer, errors in answers for fault in _log_faults(folder, code, answer, errors)
    ]
    for (_, _, uid), (_, answer, _) in zip(vehicles, answers, strict=True):
        log = folder / answer.get("log", "none")
        if log.is_file() and _metadata(log).get("session_uid") != uid:
            faults.append(f"{log.name}: of another vehicle")
    return faults + _others(folder, [answer.get("log") for _, answer, _ in answers])


@contextmanager
def two_vehicles(folder: Path) -> Iterator[list[tuple[str, str, str]]]:
    """Serve two vehicles with the short reference on board; yield port, cameras' address and uid of each."""
    with ExitStack() as stack:
        vehicles = []
        for seed in (1, 2):
            mocap, truth = _free_address(), folder / f"vehicle-{seed}.truth.json"
            words = ("--world-seed", str(seed), "--truth", str(truth))
            process = _start(folder, "sitl", "--port", "tcp:127.0.0.1:0", "--mocap", mocap, *words)
            stack.callback(process.communicate)
            stack.callback(process.kill)
            assert process.stdout is not None
            port = process.stdout.readline().strip()
            subprocess.run([*TRIMTAB, "upload", REFERENCE, "--port", port], cwd=folder, check=True)
            vehicles.append((port, mocap, json.loads(truth.read_text("utf-8"))["uid"]))
        yield vehicles


def _free_address() -> str:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return f"udp://127.0.0.1:{probe.getsockname()[1]}"


def _start(folder: Path, *words: str) -> subprocess.Popen[str]:
    pipe = subprocess.PIPE
    return subprocess.Popen([*TRIMTAB, *words, "--json"], cwd=folder, stdout=pipe, stderr=pipe, text=True)


def _answer(process: subprocess.Popen[str]) -> tuple[int, dict[str, Any], str]:
    """Return exit code, JSON answer and messages of a process."""
    answer, errors = process.communicate(timeout=120)
    lines = answer.strip().splitlines()
    return process.returncode, json.loads(lines[-1]) if lines else {}, errors.strip()


def _log_faults(folder: Path, code: int, answer: dict[str, Any], errors: str) -> list[str]:
    """Return what is wrong with the log that a process reported."""
    if code != 0 or "log_id" not in answer:
        return [f"exit code {code}: {errors}"]
    try:
        flight = read_flight(folder / answer["log"])
    except TrimtabError as error:
        return [str(error)]
    return [] if flight.id == answer["log_id"] else [f"{answer['log']}: not the log that was reported"]


def _metadata(log: Path) -> dict[str, str]:
    try:
        return dict(read_flight(log).metadata)
    except TrimtabError:
        return {}


def _others(folder: Path, logs: Sequence[str | None]) -> list[str]:
    """Return faults for logs that two processes reported, and for parts left in the folder."""
    faults = [] if len(set(logs)) == len(logs) else [f"both reported {logs[0]}"]
    return faults + [f"{path.name}: left" for path in sorted(folder.glob("*.part"))]
