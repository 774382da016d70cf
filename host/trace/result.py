"""What a trace ends with, as typed results; the machine's JSON is made of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from trimtab.host.models.model import Model
from trimtab.host.trace.audit import Audit, lines
from trimtab.host.trace.describe import Description
from trimtab.host.trace.diagnose import Diagnosis
from trimtab.host.trace.parameters import Space
from trimtab.host.trace.score import Errors
from trimtab.host.trace.separate import NextFlight
from trimtab.host.trace.twins import Leftover, Repeat
from trimtab.host.trace.unexplained import Unexplained

SHOWN = 4.2
"""Sigma by which an effect stands out where flights show it."""

Verdict = Literal["traced", "nothing-missing", "undecided", "outside-library"]


@dataclass(frozen=True, kw_only=True)
class Value:
    """One parameter with its standard deviation and unit."""

    value: float
    sd: float
    unit: str


@dataclass(frozen=True, kw_only=True)
class Named:
    """An effect that was found: parameters by key, posterior probability, and what else it could be."""

    name: str
    title: str
    parameters: Mapping[str, Value]
    probability: float
    aliases: Mapping[str, float]
    exact_aliases: Mapping[str, str]
    """By the name of an effect that fits exactly as well, a sentence on what is observable of the two."""

    @property
    def inexact_aliases(self) -> dict[str, float]:
        """Probability of the aliases that flights can tell apart from it."""
        return {name: p for name, p in self.aliases.items() if name not in self.exact_aliases}


@dataclass(frozen=True, kw_only=True)
class Trace:
    """The whole result.

    `possible` are effects beside the named ones that the data does not exclude, with their probability.
    `before` and `after` hold one entry a held-out flight, empty where none was held out.
    """

    verdict: Verdict
    reasons: tuple[str, ...]
    effects: tuple[Named, ...]
    possible: Mapping[str, float]
    drive: str
    horizon_s: float | None
    before: Sequence[Errors]
    after: Sequence[Errors]
    adjustments_only: Sequence[Errors]
    before_score: Mapping[str, float] | None
    after_score: Mapping[str, float] | None
    noise_floor: Mapping[str, float | None]
    next_flight: NextFlight | None
    model: Model
    space: Space
    diagnosis: Diagnosis
    leftover: Leftover
    audits: tuple[Audit, ...]
    description: Description | None
    """What the disturbance outside the library depends on; None where the verdict is another."""
    doubts: tuple[str, ...]
    """What the flights as a whole lack, a sentence each."""
    unexplained: Unexplained | None
    """The network's errors on what is left, where one was trained."""

    @property
    def evidence(self) -> dict[str, float]:
        """Nats that each candidate is worth: lost without a kept effect, gained with one that was not kept.

        Taken from the sets considered; a candidate that no set near the kept one holds is left out.
        """
        weights, kept = self.diagnosis.weights, set(self.diagnosis.best.effects)
        here = float(np.log(max(weights[tuple(sorted(kept))], 1e-300)))
        out = {}
        for name in self.space.candidates:
            other = tuple(sorted(kept ^ {name}))
            if other in weights:
                gain = float(np.log(max(weights[other], 1e-300))) - here
                out[name] = -gain if name in kept else gain
        return out

    @property
    def hidden(self) -> tuple[str, ...]:
        """Effects that these flights would not show at typical size, or only within an alias of theirs."""
        weak = self.diagnosis.stands_out
        kept = {effect.name for effect in self.effects}
        return tuple(sorted(name for name, sigma in weak.items() if sigma < SHOWN and name not in kept))

    def lines(self) -> list[str]:
        """The result for people, a few lines."""
        out = [f"verdict: {self.verdict}"]
        for effect in self.effects:
            values = ", ".join(
                f"{key} {v.value:.4g} +- {2 * v.sd:.2g}{'' if v.unit == '1' else ' ' + v.unit}"
                for key, v in effect.parameters.items()
            )
            others = "".join(f"; or {name} ({p:.2f})" for name, p in effect.inexact_aliases.items())
            out.append(f"  {effect.name}: {values} (probability {effect.probability:.3f}{others})")
            out += [f"    {sentence}" for sentence in effect.exact_aliases.values()]
        if self.effects:
            out.append("  (+- is two standard deviations)")
        if self.possible:
            names = ", ".join(f"{name} ({p:.2f})" for name, p in self.possible.items())
            out.append(f"  not excluded beside them: {names}" if self.effects else f"  not excluded: {names}")
        if self.verdict == "undecided" and not self.effects and self.diagnosis.none < 0.5:
            out.append(
                f"  something is missing with probability {1.0 - self.diagnosis.none:.2f}, "
                "and these flights do not say what"
            )
        out += [f"  {doubt}" for doubt in self.doubts]
        if self.hidden:
            out.append(f"  of typical size, these flights would not show: {', '.join(self.hidden)}")
        out += [f"  {reason}" for reason in self.reasons]
        if self.description is not None:
            out += [f"  {line}" for line in self.description.lines()]
        if self.before_score is not None and self.after_score is not None:
            how = "whole flights" if self.horizon_s is None else f"{self.horizon_s} s ahead"
            out.append(
                f"prediction error on {len(self.before)} held-out flights ({how}): "
                f"{1e3 * self.before_score['position_rmse_m']:.1f} mm before, "
                f"{1e3 * self.after_score['position_rmse_m']:.1f} mm after"
                f"{' (nothing was added)' if self.verdict == 'outside-library' else ''}"
            )
        else:
            out.append("no flight held out: no error before and after; add --hold-out LOG")
        if self.unexplained is not None:
            out.append(self.unexplained.line())
        if self.next_flight is not None:
            out.append(self.next_flight.line())
        return out + [f"data: {line}" for line in lines(self.audits)]

    def to_json(
        self, *, model_path: str | None, report_path: str | None, network_path: str | None = None
    ) -> dict[str, Any]:
        """The JSON object of `trimtab trace`; the paths are those of files written."""
        null = {"position_rmse_m": None, "velocity_rmse_m_s": None}
        return {
            "verdict": self.verdict,
            "effects": [
                {
                    "name": e.name,
                    "parameters": {
                        key: {"value": v.value, "sd": v.sd, "unit": v.unit} for key, v in e.parameters.items()
                    },
                    "probability": e.probability,
                    "evidence_nats": self.evidence.get(e.name),
                    "aliases": [{"name": n, "probability": p} for n, p in e.aliases.items()],
                }
                for e in self.effects
            ],
            "drive": self.drive,
            "horizon_s": self.horizon_s,
            "before": dict(self.before_score or null),
            "after": dict(self.after_score or null),
            "noise_floor": dict(self.noise_floor),
            "held_out_flights": len(self.before),
            "next_flight": None if self.next_flight is None else self.next_flight.to_json(),
            "model": model_path,
            "report": report_path,
            "reasons": list(self.reasons),
            "repeats": dict(zip(("after", "before"), map(_repeat, self.diagnosis.repeats), strict=True)),
            "possible": [{"name": name, "probability": p} for name, p in self.possible.items()],
            "hidden": list(self.hidden),
            "doubts": list(self.doubts),
            "description": None if self.description is None else self.description.to_json(),
            "unexplained": None if self.unexplained is None else self.unexplained.to_json(network_path),
            "audit": [audit.to_json() for audit in self.audits],
        }


def _repeat(found: Repeat | None) -> dict[str, float] | None:
    return None if found is None else {"share": found.share, "z": found.z, "position_m": found.position_m}
