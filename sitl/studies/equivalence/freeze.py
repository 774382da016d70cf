"""Record the answers of an installed Trimtab: demos, traces, plans and flights."""

from __future__ import annotations

import json
import subprocess
import tempfile
import tomllib
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

from trimtab.host.log.provenance import PROVENANCE
from trimtab.host.log.scan import scan
from trimtab.protocol import blobs
from trimtab.sitl.studies.equivalence.inputs import REAL_GROUPS, TraceCase, make_worlds, world_cases
from trimtab.sitl.studies.files import write_json, write_whole

DEMO_SEEDS = (1, 2, 3, 4, 5)
ROUTES = (
    "circuit",
    "climbs-descents",
    "fast-lemniscate",
    "figure-eight",
    "low-high",
    "pretzel",
    "random",
    "speed-sweep",
    "sprint",
    "stop-and-go",
)
PLAN_KINDS = ("min-snap", "min-control", "min-control*", "min-control-r", "min-residual", "min-residual*")
SEALED_LOGS = (("a1", "a2", "b1", "b2"), ("c1",))
PARTS = ("demo", "sealed", "real", "plans", "flights", "worlds")

_ORIGIN_KEYS = frozenset({"version", "git", "program_id", "command"})
"""Metadata about the program that wrote a file."""


@dataclass(frozen=True, kw_only=True)
class Setup:
    """Command to run, and paths of inputs and output."""

    command: Path
    inputs: Path
    output: Path
    repository: Path
    recordings: Path | None

    def run(self, words: Sequence[str], folder: Path) -> dict[str, Any]:
        """Return exit code and JSON answer of `trimtab WORDS --json`, run in `folder`."""
        done = subprocess.run(
            [str(self.command), *words, "--json"],
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
        )
        lines = done.stdout.splitlines()
        answer = json.loads(lines[-1]) if lines and lines[-1].startswith("{") else {}
        return {"exit_code": done.returncode, "answer": answer}

    def record(self, part: str, name: str, make: Callable[[], dict[str, Any]]) -> None:
        """Write the record of one item, unless an earlier run has written it."""
        path = self.output / part / f"{name}.json"
        if path.is_file():
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, make())


def log_digest(path: Path) -> dict[str, str]:
    """Return a digest of each topic, attachment and metadata table of a flight log, without its commit."""
    records = scan(path)
    digests = {}
    for topic, entries in records.by_topic().items():
        content = sha256()
        for entry in entries:
            content.update(b"%d %d " % (entry.log_time_us, entry.publish_time_us) + entry.data)
        digests[topic] = content.hexdigest()
    for name, (_, data) in records.attachments.items():
        digests[f"attachment {name}"] = sha256(data).hexdigest()
    for name, table in records.metadata.items():
        entries = {k: v for k, v in table.items() if name != PROVENANCE or k not in _ORIGIN_KEYS}
        digests[f"metadata {name}"] = json.dumps(entries, sort_keys=True)
    return digests


def blob_record(path: Path) -> dict[str, Any]:
    """Return id, nodes and yaw nodes of a reference."""
    reference = blobs.Reference.from_bytes(path.read_bytes())
    return {
        "id": reference.id,
        "nodes": [[node.t_us, *node.state] for node in reference.nodes],
        "yaws": [list(yaw) for yaw in reference.yaws],
    }


def model_record(path: Path) -> dict[str, Any]:
    """Return a model file without its provenance."""
    content = tomllib.loads(path.read_text(encoding="utf-8"))
    content.pop("provenance", None)
    return content


def freeze_demo(setup: Setup, seed: int) -> None:
    """Record a demo: its answer, references, models and logs."""

    def make() -> dict[str, Any]:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            answer = setup.run(["demo", "--seed", str(seed), "-o", "out"], folder)
            out = folder / "out"
            return {
                **answer,
                "references": {p.name: blob_record(p) for p in sorted(out.rglob("*.ref"))},
                "models": {p.name: model_record(p) for p in sorted(out.rglob("*.model.toml"))},
                "logs": {p.name: log_digest(p) for p in sorted(out.rglob("*.mcap"))},
            }

    setup.record("demo", str(seed), make)


def freeze_trace(setup: Setup, part: str, case: TraceCase) -> None:
    """Record the answer of tracing for the logs of `case`, and the model that it writes."""

    def make() -> dict[str, Any]:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            for log in (*case.logs, *case.held_out):
                (folder / log).symlink_to(case.folder / log)
            network = () if part == "sealed" else ("--no-network",)
            held_out = ("--hold-out", *case.held_out) if case.held_out else ()
            answer = setup.run(["trace", *case.logs, *network, *held_out, "-o", "out"], folder)
            models = {p.name: model_record(p) for p in sorted(folder.rglob("*.model.toml"))}
            return {**answer, "models": models}

    setup.record(part, case.name, make)


def freeze_real(setup: Setup, index: int) -> None:
    """Record the trace of one group of imported flights."""
    format, logs, held_out = REAL_GROUPS[index]
    assert setup.recordings is not None
    source, suffix = {
        "nanobench": (setup.recordings / "nanobench", ".csv"),
        "crazyflie-usd": (setup.recordings / "crazyswarm2_tools" / "logs", ""),
    }[format]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for log in (*logs, *held_out):
            words = ["import", format, str(source / f"{log}{suffix}"), "--vehicle", "nano"]
            setup.run([*words, "-o", f"{log}.mcap"], folder)
        case = TraceCase(
            name=f"{index}-{logs[0]}",
            folder=folder,
            logs=tuple(f"{log}.mcap" for log in logs),
            held_out=tuple(f"{log}.mcap" for log in held_out),
        )
        freeze_trace(setup, "real", case)


def freeze_plan(setup: Setup, route: str, kind: str) -> None:
    """Record the reference of one route by one kind of plan."""

    def make() -> dict[str, Any]:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            words = ["plan", route, "--kind", kind, "-o", "out.ref"]
            if kind not in ("min-snap", "min-control"):
                words += ["--model", str(setup.inputs / "plan.model.toml")]
            answer = setup.run(words, folder)
            path = folder / "out.ref"
            return {**answer, "reference": blob_record(path) if path.is_file() else None}

    setup.record("plans", f"{route}-{kind.replace('*', '-star')}", make)


def freeze_flight(setup: Setup, world: str) -> None:
    """Record one flight in one shipped world, byte by byte."""

    def make() -> dict[str, Any]:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            words = ["fly", str(setup.inputs / "flight.ref"), "--world", world, "--seed", "7"]
            answer = setup.run([*words, "--world-seed", "3", "-o", "out.mcap"], folder)
            return {**answer, "log": log_digest(folder / "out.mcap")}

    setup.record("flights", world, make)


def freeze(setup: Setup, parts: Sequence[str], jobs: int) -> None:
    """Record every item of `parts`; items that are recorded already are kept."""
    setup.inputs.mkdir(parents=True, exist_ok=True)
    _prepare(setup)
    with ProcessPoolExecutor(jobs) as pool:
        if "worlds" in parts:
            make_worlds(setup.inputs / "worlds", pool)
        for done in [pool.submit(item) for item in _items(setup, parts)]:
            done.result()


def _prepare(setup: Setup) -> None:
    """Make the model and the reference that plans and flights share, once."""
    model, reference = setup.inputs / "plan.model.toml", setup.inputs / "flight.ref"
    if not model.is_file():
        logs = [str(setup.repository / "tests" / "data" / f"{log}.mcap") for log in SEALED_LOGS[0]]
        with tempfile.TemporaryDirectory() as name:
            setup.run(["trace", *logs, "--no-network", "-o", "out"], Path(name))
            write_whole(model, (Path(name) / "out" / "trace.model.toml").read_bytes())
    if not reference.is_file():
        setup.run(["plan", "figure-eight", "-o", str(reference)], setup.inputs)


def _items(setup: Setup, parts: Sequence[str]) -> list[Callable[[], None]]:
    items: list[Callable[[], None]] = []
    if "sealed" in parts:
        logs, held_out = ([f"{log}.mcap" for log in group] for group in SEALED_LOGS)
        case = TraceCase(
            name="sealed",
            folder=setup.repository / "tests" / "data",
            logs=tuple(logs),
            held_out=tuple(held_out),
        )
        items.append(partial(freeze_trace, setup, "sealed", case))
    if "demo" in parts:
        items += [partial(freeze_demo, setup, seed) for seed in DEMO_SEEDS]
    if "real" in parts and setup.recordings is not None:
        items += [partial(freeze_real, setup, index) for index in range(len(REAL_GROUPS))]
    if "plans" in parts:
        items += [partial(freeze_plan, setup, route, kind) for route in ROUTES for kind in PLAN_KINDS]
    if "flights" in parts:
        worlds = sorted(path.stem for path in (setup.repository / "sitl" / "worlds").glob("*.toml"))
        items += [partial(freeze_flight, setup, world) for world in worlds]
    if "worlds" in parts:
        items += [
            partial(freeze_trace, setup, "worlds", case) for case in world_cases(setup.inputs / "worlds")
        ]
    return items
