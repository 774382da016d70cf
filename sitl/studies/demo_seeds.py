"""Demos on seeds drawn from a commit's hash, each verdict compared with its sealed world.

    python -m trimtab.sitl.studies.demo_seeds OUT [--count 10] [--commit HEAD] [--world WORLD]

Every demo runs through the command line in a separate process. Its truth is opened only after the answer. The
program prints a row for each seed, including failures, then counts and medians. OUT receives the folders of
the demos and table.json.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import statistics
import subprocess
from pathlib import Path
from typing import Any

from trimtab.sitl.studies.commandline import run_apart
from trimtab.sitl.studies.files import write_json

DRAGS = {"linear-drag", "quadratic-drag"}


def drawn_seeds(commit: str, count: int) -> list[int]:
    """Return `count` seeds derived from a commit's hash."""
    digests = (hashlib.sha256(f"{commit} demo {i}".encode()).digest() for i in range(count))
    return [int.from_bytes(digest[:4], "big") % 1_000_000 for digest in digests]


def run(seed: int, folder: Path, world: str | None) -> dict[str, Any]:
    """Run one demo and return its answer, or an error object if it failed."""
    words = ["demo", "--seed", str(seed), "-o", str(folder), "--force"]
    answer = run_apart(words + (["--world", world] if world else []), folder.parent)
    return answer.data or {"error": answer.errors, "exit_code": answer.code}


def opened_truth(folder: Path, answer: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Return the sealed effects of a finished demo."""
    assert "verdict" in answer
    return json.loads(next(iter(sorted(folder.glob("*.truth.json")))).read_text())["effects"]


def row(seed: int, answer: dict[str, Any], truth: dict[str, dict[str, float]]) -> dict[str, Any]:
    """Return the table's row for one demo."""
    named = {effect["name"] for effect in answer["effects"]}
    aliases = {alias["name"] for effect in answer["effects"] for alias in effect["aliases"]}
    before, after = answer["before"]["position_rmse_m"], answer["after"]["position_rmse_m"]
    first = answer["tracking_rmse_first_m"]
    new, applied = answer["tracking_rmse_new_plan_m"], answer["tracking_rmse_applied_m"]
    return {
        "seed": seed,
        "truth": truth,
        "verdict": answer["verdict"],
        "found": {e["name"]: {k: v["value"] for k, v in e["parameters"].items()} for e in answer["effects"]},
        "exact": named == set(truth),
        "in_alias_set": set(truth) <= named | aliases,
        "held_out_ratio": after / before if before and after else None,
        "new_plan_ratio": new / first if new and first else None,
        "applied_ratio": applied / first if applied and first else None,
        "drag": bool(DRAGS & set(truth)),
        "seconds": answer["seconds"],
    }


def median(rows: list[dict[str, Any]], key: str) -> float | None:
    """Return the median of a key over the rows that have it."""
    values = [r[key] for r in rows if r.get(key) is not None]
    return statistics.median(values) if values else None


def main() -> None:
    """Run the demos, print the rows and write table.json."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--commit", default="HEAD")
    parser.add_argument("--world")
    arguments = parser.parse_args()
    commit = subprocess.run(
        ["git", "rev-parse", arguments.commit], capture_output=True, text=True, check=True
    ).stdout.strip()
    out = arguments.out.absolute()
    out.mkdir(parents=True, exist_ok=True)
    rows = []
    print(f"commit {commit}")
    for seed in drawn_seeds(commit, arguments.count):
        folder = out / f"{arguments.world or 'default'}-{seed}"
        answer = run(seed, folder, arguments.world)
        if "verdict" not in answer:
            rows.append({"seed": seed, "error": answer})
            print(json.dumps(rows[-1]), flush=True)
            continue
        rows.append(row(seed, answer, opened_truth(folder, answer)))
        print(json.dumps(rows[-1]), flush=True)
    judged = [r for r in rows if "error" not in r]
    summary = {
        "demos": len(rows),
        "failed": len(rows) - len(judged),
        "exact": sum(r["exact"] for r in judged),
        "in_alias_set": sum(r["in_alias_set"] for r in judged),
        "held_out_ratio_median": median(judged, "held_out_ratio"),
        "new_plan_ratio_median_with_drag": median([r for r in judged if r["drag"]], "new_plan_ratio"),
        "applied_ratio_median_with_drag": median([r for r in judged if r["drag"]], "applied_ratio"),
        "seconds_median": median(judged, "seconds"),
    }
    write_json(out / "table.json", {"commit": commit, "rows": rows, "summary": summary})
    print(json.dumps(summary))


if __name__ == "__main__":
    main()
