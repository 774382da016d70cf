"""The study of attacks: what a stranger without the key can do to a vehicle, its owner and its port.

    trimtab study attack --seed 1
    trimtab study attack --quick

Forged and repeated frames go to the verifier of a vehicle with a key, and to verifiers that were weakened on
purpose. Strangers join flights in lock-step, with and without a key, under their own address and under the
owner's. Floods, crowds of clients and climbing paths go to the port.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from trimtab.host.base.pieces import OnProgress, Piece, run_pieces
from trimtab.host.base.shards import Shard
from trimtab.host.vehicle import load_vehicle
from trimtab.sitl.studies.attack import frames
from trimtab.sitl.studies.attack.flights import ALLOWED, STATIONS, flood, interfere
from trimtab.sitl.studies.attack.interference import KINDS
from trimtab.sitl.studies.attack.mutants import MUTANTS
from trimtab.sitl.studies.attack.ports import CROWDS, climb, crowd
from trimtab.sitl.studies.files import StudyError
from trimtab.sitl.studies.text_tables import lines

NAME = "attack"
FRAMES, MUTANT_FRAMES, SEEDS, FLOODS, PATHS = 100_000, 5_000, 3, 10, 20_000
"""Frames of each kind, the same for each weakened verifier, flights of each kind, floods, and paths."""
QUICK = {"frames": 2_000, "mutant_frames": 1_000, "seeds": 1, "floods": 2, "paths": 1_000}
_FRAMES_A_PIECE = 20_000

Row = dict[str, Any]


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
    another study, and StudyError for another vehicle than research.
    """
    if load_vehicle(vehicle).id != load_vehicle("research").id:
        raise StudyError(f"--vehicle {vehicle}: the study flies the vehicle research; leave --vehicle out")
    folder = folder.absolute()
    pieces = list(_pieces(quick))
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
    rows: dict[str, list[Row]] = {}
    for piece in pieces:
        rows.setdefault(piece.kind, []).append(results[piece.name]["result"])
    return {**summary({"seed": seed, "quick": quick, "folder": str(folder)}, rows), "scores": rows}


def _pieces(quick: bool) -> Iterator[Piece]:
    full = {
        "frames": FRAMES,
        "mutant_frames": MUTANT_FRAMES,
        "seeds": SEEDS,
        "floods": FLOODS,
        "paths": PATHS,
    }
    size = QUICK if quick else full

    def piece(kind: str, weight: float, **arguments: Any) -> Piece:
        name = "-".join([kind, *(str(value).replace(" ", "-") for value in arguments.values())])
        return Piece(name=name, kind=kind, arguments=arguments, weight=weight)

    for kind in frames.KINDS:
        for first in range(0, size["frames"], _FRAMES_A_PIECE):
            count = min(_FRAMES_A_PIECE, size["frames"] - first)
            yield piece("frames", 4e-5 * count, attack=kind, first=first, count=count)
    for mutant in MUTANTS:
        yield piece("mutant", 6e-4 * size["mutant_frames"], mutant=mutant, count=size["mutant_frames"])
    for number in range(size["seeds"]):
        for signed in (False, True):
            for address in STATIONS:
                for kind in KINDS:
                    yield piece("flight", 2.0, attack=kind, address=address, signed=signed, number=number)
    for number in range(size["floods"]):
        yield piece("flood", 2.0, number=number)
    yield piece("paths", 1e-3 * size["paths"], count=size["paths"])
    for name in list(CROWDS)[: 1 if quick else None]:
        yield piece("crowd", 18.0, name=name)


def _do(piece: Piece, folder: str, *, seed: int) -> Row:
    """Return the row of a piece."""
    given = piece.arguments
    if piece.kind == "frames":
        found = frames.attack(
            given["attack"], given["count"], 1000 * seed + given["first"] // _FRAMES_A_PIECE
        )
        return {"kind": given["attack"], **asdict(found)}
    if piece.kind == "mutant":
        caught = {}
        for kind in frames.KINDS:
            found = frames.attack(kind, given["count"], seed, MUTANTS[given["mutant"]])
            if found.accepted or found.lockouts:
                caught[kind] = asdict(found)
        return {"mutant": given["mutant"], "caught_by": caught}
    if piece.kind == "flight":
        number = 100 * seed + given["number"]
        return interfere(given["attack"], given["address"], signed=given["signed"], seed=number)
    if piece.kind == "flood":
        return flood(100 * seed + given["number"])
    if piece.kind == "paths":
        return climb(given["count"], seed)
    return crowd(given["name"], Path(folder) / "crowds")


def summary(answer: Mapping[str, Any], rows: Mapping[str, Sequence[Row]]) -> dict[str, Any]:
    """Return `answer`, `lines` and `tables` from the rows of a study."""
    by_kind = {kind: [row for row in rows["frames"] if row["kind"] == kind] for kind in frames.KINDS}
    counts = {
        kind: {key: sum(row[key] for row in found) for key in ("trials", "accepted", "lockouts")}
        for kind, found in by_kind.items()
    }
    flights, floods, crowds = rows["flight"], rows["flood"], rows["crowd"]
    ratios = [row["flooded_rmse_m"] / row["quiet_rmse_m"] for row in floods if row["flooded_whole"]]
    answers = {
        "study": NAME,
        **answer,
        "trials": sum(found["trials"] for found in counts.values()),
        "accepted": sum(found["accepted"] for found in counts.values()),
        "lockouts": sum(found["lockouts"] for found in counts.values()),
        "takeovers": sum(_is_takeover(row) for row in flights),
        "mutants_caught": sum(bool(row["caught_by"]) for row in rows["mutant"]),
        "mutants": len(rows["mutant"]),
        "flights": len(flights),
        "misreported": sum(row["misreported"] for row in flights),
        "crashes": sum(row["crashed"] and _is_takeover(row) for row in flights),
        "terminations": sum(row["crashed"] and _is_allowed(row) for row in flights),
        "false_sender_changed": sum(row["changed"] and _is_false_sender(row) for row in flights),
        "false_sender_crashes": sum(row["crashed"] and _is_false_sender(row) for row in flights),
        "flood_ratio_max": max(ratios) if len(ratios) == len(floods) else None,
        "flood_landings": sum(not row["flooded_whole"] for row in floods),
        "crowds_flown": sum(row["flown"] for row in crowds),
        "crowds": len(crowds),
        "paths": sum(row["paths"] for row in rows["paths"]),
        "paths_opened": sum(len(row["opened"]) for row in rows["paths"]),
    }
    tables = {
        "Frames to a vehicle with a key": [
            {"wrong or repeated": kind, **{key: str(value) for key, value in found.items()}}
            for kind, found in counts.items()
        ],
        "Weakened verifiers": [
            {"verifier": row["mutant"], "caught by": ", ".join(row["caught_by"]) or "nothing"}
            for row in rows["mutant"]
        ],
        "Flights beside a stranger": list(_flight_table(flights)),
        "Floods of 10,000 packets a second": [
            {
                "flight": str(row["seed"]),
                "tracking error, quiet": _mm(row["quiet_rmse_m"]),
                "flooded": _mm(row["flooded_rmse_m"]),
                "ended": row["flooded_failsafe"] or ("flown" if row["flooded_whole"] else "landed"),
            }
            for row in floods
        ],
        "Crowds at a TCP port": [
            {
                "crowd": row["crowd"],
                "flown": "yes" if row["flown"] else row["failsafe"] or row["error"] or "no",
                "tracking error": _mm(row["tracking_rmse_m"]),
            }
            for row in crowds
        ],
        "Paths that climb": [{"paths": str(answers["paths"]), "opened": str(answers["paths_opened"])}],
    }
    return {"answer": answers, "lines": list(lines(tables)), "tables": tables}


def _is_allowed(row: Row) -> bool:
    """Return whether the default of OWN_OTHERS allows this interference."""
    return row["kind"] in ALLOWED and not row["signed"]


def _is_takeover(row: Row) -> bool:
    """Return whether a stranger under its own address, or any stranger with signing, changed a flight.

    What the default of OWN_OTHERS allows does not count. A parameter that was set before arming changes
    nothing, because the host then does not fly.
    """
    return row["changed"] and not _is_false_sender(row) and not _is_allowed(row)


def _is_false_sender(row: Row) -> bool:
    """Return whether a stranger used the owner's address unsigned, beyond what OWN_OTHERS allows."""
    return row["address"] == "owner" and not row["signed"] and not _is_allowed(row)


def _flight_table(flights: Sequence[Row]) -> Iterator[Row]:
    for kind in KINDS:
        row = {"interference": kind}
        for signed in (False, True):
            for address in STATIONS:
                same = [
                    flight
                    for flight in flights
                    if (flight["kind"], flight["address"], flight["signed"]) == (kind, address, signed)
                ]
                title = f"{'key' if signed else 'no key'}, {address}'s address"
                row[title] = "; ".join(dict.fromkeys(map(_outcome, same)))
        yield row


def _outcome(row: Row) -> str:
    """Return the outcome of a flight in a few words."""
    if row["misreported"]:
        return "CHANGED AND REPORTED AS FLOWN"
    if row["flown"]:
        return "no effect"
    told = row["takeover"] or ("not flown" if row["error"] else "landed by failsafe")
    return f"{told}, crashed" if row["crashed"] else told


def _mm(value_m: float | None) -> str:
    return "-" if value_m is None else f"{1e3 * value_m:.2f} mm"
