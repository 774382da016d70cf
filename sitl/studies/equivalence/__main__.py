"""`python -m trimtab.sitl.studies.equivalence freeze|compare`: see the package's docstring."""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from pathlib import Path

from trimtab.sitl.studies.equivalence.compare import compare
from trimtab.sitl.studies.equivalence.freeze import PARTS, Setup, freeze


def main() -> int:
    """Run the command that the arguments name; return 1 if the records differ."""
    parser = argparse.ArgumentParser(
        prog="equivalence", description="Record and compare what Trimtab computes."
    )
    commands = parser.add_subparsers(dest="verb", required=True)
    record = commands.add_parser("freeze", help="record demos, traces, plans and flights")
    record.add_argument("output", type=Path)
    record.add_argument("--command", type=Path, default=Path(sys.executable).with_name("trimtab"))
    record.add_argument("--inputs", type=Path, help="inputs of an earlier record; made if not given")
    record.add_argument("--repository", type=Path, default=Path.cwd(), help="checkout to read from")
    record.add_argument("--recordings", type=Path, help="folder with nanobench and crazyswarm2_tools flights")
    record.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS)
    record.add_argument("--jobs", type=int, default=2)
    check = commands.add_parser("compare", help="compare two records")
    check.add_argument("before", type=Path)
    check.add_argument("after", type=Path)
    check.add_argument("--regrouped", action="store_true", help="allow for regrouped arithmetic")
    check.add_argument("--words", action="store_true", help="also list sentences that differ")
    arguments = parser.parse_args()
    if arguments.verb == "freeze":
        output = arguments.output.absolute()
        setup = Setup(
            command=arguments.command.absolute(),
            inputs=(arguments.inputs or output / "inputs").absolute(),
            output=output,
            repository=arguments.repository.absolute(),
            recordings=None if arguments.recordings is None else arguments.recordings.absolute(),
        )
        freeze(setup, arguments.parts, arguments.jobs)
        return 0
    counts, differences = compare(arguments.before, arguments.after, regrouped=arguments.regrouped)
    failing = [d for d in differences if d.kind != "words"]
    for difference in differences if arguments.words else failing:
        print(difference)
    print("records: " + ", ".join(f"{part} {count}" for part, count in counts.items()))
    kinds = Counter(str(d.kind) for d in differences)
    print("differences: " + (", ".join(f"{kind} {count}" for kind, count in kinds.items()) or "none"))
    return 1 if failing else 0


if __name__ == "__main__":
    sys.exit(main())
