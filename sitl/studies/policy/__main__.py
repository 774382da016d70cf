"""`python -m trimtab.sitl.studies.policy --seeds 0:300`: exit code 1 if an invariant is broken.

`--mutant NAME` weakens the vehicle and stops at the first broken invariant.
The exit code is then 1 if none is.
"""

from __future__ import annotations

import argparse
import json
import sys
import time

from trimtab.firmware_model.flight.invariants import BY_NAME
from trimtab.host.base.progress import Progress
from trimtab.sitl.studies.policy.mutants import MUTANTS
from trimtab.sitl.studies.policy.run import PolicyReport, run_policy

BROKEN_MAX = 5
"""Greatest number of breaches of an invariant that the report names."""


def main(words: list[str] | None = None) -> int:
    """Run the study, print its report and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m trimtab.sitl.studies.policy", description=__doc__)
    parser.add_argument("--seeds", default="0:300", help="FIRST:END, or one seed (default: %(default)s)")
    parser.add_argument("--workers", type=int, default=2, help="processes (default: %(default)s)")
    parser.add_argument("--mutant", choices=MUTANTS, help="weaken the vehicle on purpose")
    parser.add_argument("--json", action="store_true", help="print one JSON object as the last line")
    arguments = parser.parse_args(words)
    first, _, end = arguments.seeds.partition(":")
    if not first.isdigit() or not (end.isdigit() if end else ":" not in arguments.seeds):
        parser.error(f"--seeds {arguments.seeds}: give FIRST:END or one seed, whole numbers from 0")
    seeds = range(int(first), int(end) if end else int(first) + 1)
    if not seeds:
        parser.error(f"--seeds {arguments.seeds}: no seed between FIRST and END")
    begin = time.monotonic()
    with Progress("policy", len(seeds)) as bar:
        report = run_policy(
            seeds,
            lambda done, total, detail: bar.update(done, detail=detail),
            mutant=arguments.mutant,
            workers=arguments.workers if len(seeds) > 1 else 1,
            until_broken=arguments.mutant is not None,
        )
    print("\n".join(_lines(report)))
    print(f"{time.monotonic() - begin:.0f} s")
    if arguments.json:
        print(json.dumps(report.to_dict()))
    return int(bool(report.broken_seeds) is (arguments.mutant is None))


def _lines(report: PolicyReport) -> list[str]:
    """Return the report: a line for each invariant, its breaches, and a summary."""
    lines = [f"{'invariant':18} {'sequences':>9} {'worst':>9}      seed  bound"]
    for name, row in report.rows.items():
        value = "-" if row.value is None else f"{row.value:.3g}"
        unit, seed = BY_NAME[name].unit, "-" if row.worst_seed is None else row.worst_seed
        formula = BY_NAME[name].formula.replace("`", "")
        lines.append(f"{name:18} {row.exercised:9} {value:>9} {unit:3} {seed:>6}  {formula}")
        lines += [
            f"    broken: seed {seed} at {breach.t_s:.2f} s, {breach.value:.3g} > {breach.bound:.3g} {unit}"
            for seed, breach in row.broken[:BROKEN_MAX]
        ]
    weakened = "" if report.mutant is None else f", vehicle weakened: {report.mutant}"
    lines.append(
        f"{report.sequences} sequences of {report.seconds / report.sequences:.1f} s{weakened}, "
        f"{len(report.broken_seeds)} with a broken invariant"
    )
    return lines


if __name__ == "__main__":
    sys.exit(main())
