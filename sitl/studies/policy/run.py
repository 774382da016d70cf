"""Run of the policy study over a range of seeds, in one or several processes."""

from __future__ import annotations

import contextlib
import multiprocessing
from collections.abc import Callable, Generator, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any

from trimtab.firmware_model.flight.invariants import BY_NAME, INVARIANTS
from trimtab.sitl.studies.policy.mutants import mutated
from trimtab.sitl.studies.policy.rig import Breach, Tally
from trimtab.sitl.studies.policy.sequence import Sequence as RandomSequence

OnProgress = Callable[[int, int, str], None]
"""Called with the sequences done, the total, and a detail text."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """A sequence: its seed, simulated time, breaches, and a tally for each invariant."""

    seed: int
    seconds: float
    breaches: tuple[Breach, ...]
    tallies: dict[str, Tally]


@dataclass(kw_only=True)
class Row:
    """An invariant over all sequences.

    exercised: number of sequences in which it applied. value, worst_seed: the value nearest to its bound, or
    furthest past it, and its sequence; None if it never applied. broken: seeds and breaches.
    """

    exercised: int = 0
    excess: float | None = None
    value: float | None = None
    worst_seed: int | None = None
    broken: list[tuple[int, Breach]] = field(default_factory=list)


@dataclass(kw_only=True)
class PolicyReport:
    """Result of a run: sequences, simulated time (s), seeds with a broken invariant, and a row for each."""

    mutant: str | None = None
    sequences: int = 0
    seconds: float = 0.0
    broken_seeds: list[int] = field(default_factory=list)
    rows: dict[str, Row] = field(default_factory=lambda: {row.name: Row() for row in INVARIANTS})

    def add(self, outcome: Outcome) -> None:
        """Add a sequence."""
        self.sequences += 1
        self.seconds += outcome.seconds
        if outcome.breaches:
            self.broken_seeds.append(outcome.seed)
        for name, tally in outcome.tallies.items():
            row = self.rows[name]
            if not tally.moments:
                continue
            row.exercised += 1
            if row.excess is None or tally.excess > row.excess:
                row.excess, row.value, row.worst_seed = tally.excess, tally.value, outcome.seed
        for breach in outcome.breaches:
            self.rows[breach.name].broken.append((outcome.seed, breach))

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        rows = {
            name: {
                "statement": BY_NAME[name].statement,
                "exercised": row.exercised,
                "worst": row.value,
                "worst_seed": row.worst_seed,
                "unit": BY_NAME[name].unit,
                "broken": [{"seed": seed, **asdict(breach)} for seed, breach in row.broken],
            }
            for name, row in self.rows.items()
        }
        return {
            "mutant": self.mutant,
            "sequences": self.sequences,
            "simulated_s": round(self.seconds, 2),
            "broken_seeds": self.broken_seeds,
            "invariants": rows,
        }


def fly_sequence(seed: int, mutant: str | None = None) -> Outcome:
    """Fly one sequence, with a weakened vehicle if `mutant` names one."""
    with mutated(mutant):
        sequence = RandomSequence(seed)
        sequence.run()
    rig = sequence.rig
    return Outcome(
        seed=seed,
        seconds=1e-6 * rig.now_us,
        breaches=tuple(rig.breaches.values()),
        tallies={name: tally for name, tally in rig.tallies.items() if tally.moments},
    )


def run_policy(
    seeds: Sequence[int],
    on_progress: OnProgress = lambda done, total, detail: None,
    *,
    mutant: str | None = None,
    workers: int = 1,
    until_broken: bool = False,
) -> PolicyReport:
    """Fly the sequences of these seeds and return the report, which is the same for any number of processes.

    until_broken: whether to stop after the first sequence that breaks an invariant.
    """
    report = PolicyReport(mutant=mutant)
    with contextlib.closing(_outcomes(seeds, mutant, workers)) as outcomes:
        for outcome in outcomes:
            report.add(outcome)
            on_progress(report.sequences, len(seeds), f"{len(report.broken_seeds)} broken")
            if until_broken and outcome.breaches:
                break
    return report


def _outcomes(seeds: Sequence[int], mutant: str | None, workers: int) -> Generator[Outcome, None, None]:
    fly = partial(fly_sequence, mutant=mutant)
    if workers == 1:
        yield from map(fly, seeds)
        return
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        yield from pool.imap(fly, seeds, chunksize=4)
