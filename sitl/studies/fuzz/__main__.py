"""`python -m trimtab.sitl.studies.fuzz --inputs N --seed S`: crashes are saved as hex, exit code 1."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from trimtab.host.base.progress import Progress
from trimtab.sitl.studies.fuzz.run import KINDS, Crash, replay, run_fuzz


def main(words: list[str] | None = None) -> int:
    """Run the fuzzer and return the exit code: 0 without crashes, 1 with crashes."""
    parser = argparse.ArgumentParser(prog="python -m trimtab.sitl.studies.fuzz", description=__doc__)
    parser.add_argument("--inputs", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--kinds", default=",".join(KINDS), help="some of %(default)s")
    parser.add_argument(
        "--replay", metavar="KIND:INDEX", help="replay this input, after the earlier ones of its batch"
    )
    parser.add_argument("--save", type=Path, default=Path(), help="folder for crashing inputs")
    arguments = parser.parse_args(words)
    kinds = tuple(arguments.kinds.split(","))
    if unknown := [kind for kind in kinds if kind not in KINDS]:
        parser.error(f"unknown kinds {', '.join(unknown)}; known: {', '.join(KINDS)}")
    if arguments.replay:
        kind, _, index = arguments.replay.partition(":")
        if kind not in KINDS or not index.isdigit():
            parser.error(f"--replay {arguments.replay}: give KIND:INDEX with a kind of {', '.join(KINDS)}")
        crash = replay(kind, arguments.seed, int(index))
        print(crash.trace if crash else f"{arguments.replay}: no crash")
        return 1 if crash else 0
    begin = time.monotonic()
    with Progress("fuzz", arguments.inputs) as bar:
        report = run_fuzz(
            arguments.inputs,
            arguments.seed,
            lambda done, total, detail: bar.update(done, detail=detail),
            workers=arguments.workers,
            kinds=kinds,
        )
    for crash in report.crashes:
        print(
            f"{crash.kind}:{crash.index}: {crash.error}; input in {_save(crash, arguments.save)}",
            file=sys.stderr,
        )
    counts = ", ".join(f"{kind} {count}" for kind, count in report.by_kind.items())
    print(
        f"{report.inputs} inputs ({counts}), {report.valid} valid messages and files among them, "
        f"seed {report.seed}, {len(report.crashes)} crashes, {time.monotonic() - begin:.0f} s"
    )
    return 1 if report.crashes else 0


def _save(crash: Crash, folder: Path) -> Path:
    path = folder / f"fuzz-{crash.kind}-{crash.seed}-{crash.index}.hex"
    path.write_text(f"{crash.data}\n", encoding="ascii")
    return path


if __name__ == "__main__":
    sys.exit(main())
