"""The link study: uploads over a lossy radio link, uploads in flight, interrupted uploads, and fuzzing.

    trimtab study link --seed 2030

Every part writes a file, so an interrupted study resumes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from trimtab.host.base.pieces import OnProgress, Piece, run_pieces
from trimtab.host.base.shards import Shard
from trimtab.host.vehicle import load_vehicle
from trimtab.sitl.studies.files import StudyError, write_whole
from trimtab.sitl.studies.fuzz.run import run_fuzz
from trimtab.sitl.studies.text_tables import lines
from trimtab.sitl.studies.upload_blob import reference_blob
from trimtab.sitl.studies.upload_cuts import INTERRUPTIONS, interrupt
from trimtab.sitl.studies.upload_flight import RADIOS, fly_upload
from trimtab.sitl.studies.upload_peers import PEERS, peer_s
from trimtab.sitl.studies.upload_picture import picture
from trimtab.sitl.studies.uploads import CHANNELS, bound_s, figures, time_upload

NAME = "link"
RUNS, FLIGHTS, TRIALS, FUZZ_INPUTS = 200, 10, 1_000, 100_000
QUICK_RUNS, QUICK_FLIGHTS, QUICK_TRIALS, QUICK_FUZZ_INPUTS = 8, 1, 4, 2_000
PICTURE = "upload.svg"
_RUNS_A_PART, _FLIGHTS_A_PART, _TRIALS_A_PART, _INPUTS_A_PART = 25, 2, 10, 10_000
_TARGETS = {
    "upload": "mean <= 0.62 s, p99 <= 1.0 s",
    "burst5": "p99 <= 2.5 s",
    "burst20": "p99 <= 3.5 s",
}
_TITLES = {
    "clean": "no loss",
    "upload": "10 % loss",
    "burst5": "30 % loss in bursts of 5",
    "burst20": "10 % loss in bursts of 20",
    "flight": "as the simulator's: 1 % in bursts of 5",
    "flight-loss": "10 % loss",
}
_INTERRUPTED = {
    "cut": "link cut for 5 s",
    "host": "host killed and restarted immediately",
    "vehicle": "vehicle reset, 0.3 s without power",
}
Row = dict[str, str]


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part of the work: `count` items from `first`. `weight` is its share of the total."""

    kind: str
    channel: str = ""
    first: int
    count: int
    weight: float

    @property
    def name(self) -> str:
        """Stem of the part's file."""
        return "-".join(word for word in (self.kind, self.channel, f"{self.first:06d}") if word)


def run(
    *,
    folder: Path,
    seed: int,
    vehicle: str,
    jobs: int,
    quick: bool = False,
    shard: Shard | None = None,
    on_progress: OnProgress = lambda done, total, detail: None,
) -> dict[str, Any]:
    """Run the study and return its outcome: `answer` (the JSON object), `lines`, `tables` and `scores`.

    With `quick`, run a small study to check that everything works. Raises UsageError if the folder holds
    another study, and StudyError if the vehicle is not the one of the uploaded references.
    """
    if load_vehicle(vehicle).id != load_vehicle("research").id:
        raise StudyError(
            f"--vehicle {vehicle}: the link study uses the vehicle research; leave --vehicle out"
        )
    folder = folder.absolute()
    if quick:
        parts = list(_parts(QUICK_RUNS, QUICK_FLIGHTS, QUICK_TRIALS, QUICK_FUZZ_INPUTS))
    else:
        parts = list(_parts(RUNS, FLIGHTS, TRIALS, FUZZ_INPUTS))
    pieces = [
        Piece(name=part.name, kind=part.kind, arguments=asdict(part), weight=part.weight) for part in parts
    ]
    config = {"study": NAME, "seed": seed, "quick": quick}
    results = run_pieces(
        pieces,
        partial(_do, seed=seed),
        folder=folder,
        config=config,
        jobs=jobs,
        shard=shard,
        on_progress=on_progress,
    )
    rows = _rows(parts, results)
    write_whole(folder / PICTURE, picture().encode())
    return {**summary({"seed": seed, "quick": quick, "folder": str(folder)}, rows), "scores": rows}


def _parts(runs: int, flights: int, trials: int, inputs: int) -> Iterator[Part]:
    for first in range(0, runs, _RUNS_A_PART):
        for channel in CHANNELS:
            count = min(_RUNS_A_PART, runs - first)
            yield Part(kind="uploads", channel=channel, first=first, count=count, weight=0.1 * count)
    for first in range(0, flights, _FLIGHTS_A_PART):
        for channel in RADIOS:
            count = min(_FLIGHTS_A_PART, flights - first)
            yield Part(kind="flights", channel=channel, first=first, count=count, weight=4.0 * count)
    for first in range(0, trials, _TRIALS_A_PART):
        count = min(_TRIALS_A_PART, trials - first)
        yield Part(kind="cuts", first=first, count=count, weight=0.6 * count)
    for first in range(0, inputs, _INPUTS_A_PART):
        count = min(_INPUTS_A_PART, inputs - first)
        yield Part(kind="fuzz", first=first, count=count, weight=1e-3 * count)


def _rows(parts: Sequence[Part], results: Mapping[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """Return the rows of all parts, by channel or kind, in order."""
    rows: dict[str, list[dict[str, Any]]] = {}
    for part in parts:
        rows.setdefault(part.channel or part.kind, []).extend(results[part.name]["result"])
    return rows


def _do(piece: Piece, folder: str, *, seed: int) -> list[dict[str, Any]]:
    """Return the rows of a piece."""
    return do(Part(**piece.arguments), seed)


def do(part: Part, seed: int) -> list[dict[str, Any]]:
    """Return the rows of a part."""
    numbers = range(part.first, part.first + part.count)
    if part.kind == "uploads":
        return [time_upload(part.channel, seed, number) for number in numbers]
    if part.kind == "flights":
        return [fly_upload(part.channel, seed, number) for number in numbers]
    if part.kind == "cuts":
        return [interrupt(seed, number) for number in numbers]
    fuzzed = run_fuzz(part.count, seed * 1_000 + part.first // _INPUTS_A_PART)
    return [{"inputs": fuzzed.inputs, "crashes": [crash.error for crash in fuzzed.crashes]}]


def summary(answer: Mapping[str, Any], found: Mapping[str, Sequence[Mapping[str, Any]]]) -> dict[str, Any]:
    """Return `answer`, `lines` and `tables` from the rows of a study."""
    uploads = {channel: figures(found[channel]) for channel in CHANNELS}
    size, seed = len(reference_blob("research", 1)), answer["seed"]
    bounds = {channel: bound_s(size, radio) for channel, radio in CHANNELS.items()}
    answered = sorted(row["answered_s"] for row in found["clean"])
    round_trip_s = answered[len(answered) // 2]
    peers = {
        name: _mean([peer_s(peer, size, CHANNELS["upload"], round_trip_s, seed + k) for k in range(100)])
        for name, peer in PEERS.items()
    }
    flown = {channel: figures(found[channel]) for channel in RADIOS}
    flights = [row for channel in RADIOS for row in found[channel]]
    trials = [row[kind] for row in found["cuts"] for kind in INTERRUPTIONS]
    crashes = [crash for row in found["fuzz"] for crash in row["crashes"]]
    answers = {
        "study": NAME,
        **answer,
        "runs": uploads["upload"]["runs"],
        "blob_bytes": size,
        "round_trip_s": round_trip_s,
        "clean_mean_s": uploads["clean"]["mean_s"],
        "upload_mean_s": uploads["upload"]["mean_s"],
        "upload_p99_s": uploads["upload"]["p99_s"],
        "upload_max_s": uploads["upload"]["max_s"],
        "burst5_p99_s": uploads["burst5"]["p99_s"],
        "burst20_p99_s": uploads["burst20"]["p99_s"],
        "uploads_failed": sum(found["failed"] or 0 for found in uploads.values()),
        "bound_s": bounds["upload"],
        "flights": len(flights),
        "flights_failed": sum(found["failed"] or 0 for found in flown.values()),
        "flight_upload_s": flown["flight"]["mean_s"],
        "flight_loss_upload_s": flown["flight-loss"]["mean_s"],
        "flight_slot_share": max(row["slot_share"] for row in flights),
        "flight_mocap_delay_max_us": max(max(row["mocap_delays_us"]) for row in flights),
        "peers_mean_s": peers,
        "cut_trials": len(trials),
        "cut_failures": sum(trial["failed"] for trial in trials),
        "cut_resent": sum(trial["resent"] for trial in trials),
        "fuzz_inputs": sum(row["inputs"] for row in found["fuzz"]),
        "fuzz_crashes": len(crashes),
    }
    tables = {
        "Uploads of 20.8 kB": _uploads_table(uploads, bounds),
        "Uploads of 20.8 kB in flight": [
            _flights_row(channel, flown[channel], found[channel]) for channel in RADIOS
        ],
        "Other protocols over the same link, 10 % loss": [
            {"protocol": name, "mean": _text(seconds, "s")} for name, seconds in peers.items()
        ],
        "Interrupted uploads, 10 % loss": _cuts_table(found["cuts"]),
        "Fuzz": [{"inputs": str(answers["fuzz_inputs"]), "crashes": str(answers["fuzz_crashes"])}],
    }
    return {"answer": answers, "lines": list(lines(tables)), "tables": tables}


def _uploads_table(uploads: Mapping[str, Any], bounds: Mapping[str, float]) -> list[Row]:
    return [
        {
            "channel": _TITLES[channel],
            "runs": str(found["runs"]),
            "mean": _text(found["mean_s"], "s"),
            "median": _text(found["p50_s"], "s"),
            "p99": _text(found["p99_s"], "s"),
            "maximum": _text(found["max_s"], "s"),
            "bound": _text(bounds[channel], "s"),
            "target": _TARGETS.get(channel, ""),
        }
        for channel, found in uploads.items()
    ]


def _flights_row(channel: str, found: Mapping[str, Any], rows: Sequence[Mapping[str, Any]]) -> Row:
    delays_us = [delay_us for row in rows for delay_us in row["mocap_delays_us"]]
    return {
        "channel": _TITLES[channel],
        "flights": str(found["runs"]),
        "failed": str(found["failed"]),
        "upload, mean": _text(found["mean_s"], "s"),
        "maximum": _text(found["max_s"], "s"),
        "share of the slots, maximum": _text(100 * max(row["slot_share"] for row in rows), "%"),
        "poses": str(len(delays_us)),
        "delay of a pose, mean": _text(1e-3 * _mean(delays_us), "ms"),
        "maximum delay": _text(1e-3 * max(delays_us), "ms"),
        "target": "<= 30 % of the slots, <= 2 ms",
    }


def _cuts_table(rows: Sequence[Mapping[str, Any]]) -> list[Row]:
    table = []
    for kind in INTERRUPTIONS:
        trials = [row[kind] for row in rows]
        seconds = [trial["seconds"] for trial in trials]
        table.append({
            "interrupted": _INTERRUPTED[kind],
            "trials": str(len(trials)),
            "failed": str(sum(trial["failed"] for trial in trials)),
            "chunks resent": str(sum(trial["resent"] for trial in trials)),
            "chunks held before, mean": _text(_mean([trial["held"] for trial in trials]), ""),
            "time afterwards, mean": _text(_mean(seconds), "s"),
            "maximum": _text(max(seconds), "s"),
        })  # fmt: skip
    return table


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


def _text(value: float | None, unit: str) -> str:
    return "-" if value is None else f"{value:.3g} {unit}".rstrip()
