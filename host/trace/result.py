"""What a trace ends with, as typed results; the machine's JSON is made of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trimtab.host.models.model import Model
from trimtab.host.trace.data.audit import Audit
from trimtab.host.trace.data.cutting import SEGMENT_S
from trimtab.host.trace.data.logs import Drive
from trimtab.host.trace.decision.exact_aliases import ObservedAlias
from trimtab.host.trace.decision.findings import Code, Finding, Verdict
from trimtab.host.trace.next_flight.separation import NextFlight
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.trace.prediction import Errors, rmse
from trimtab.host.trace.residual.description import Description
from trimtab.host.trace.residual.network import Unexplained
from trimtab.host.trace.residual.unexplained import UnexplainedResidual
from trimtab.host.trace.selection import Diagnosis


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
    exact_aliases: Mapping[str, ObservedAlias]
    """By the name of an effect that fits exactly as well, what flights show of the two."""

    @property
    def inexact_aliases(self) -> dict[str, float]:
        """Return the probability of the aliases that flights can tell apart from it."""
        return {name: p for name, p in self.aliases.items() if name not in self.exact_aliases}


@dataclass(frozen=True, kw_only=True)
class Trace:
    """The whole result.

    `possible` are effects beside the named ones that the data does not exclude, with their probability.
    `before` and `after` hold one entry a held-out flight, empty where none was held out.
    """

    verdict: Verdict
    findings: tuple[Finding, ...]
    effects: tuple[Named, ...]
    possible: Mapping[str, float]
    drive: Drive
    before: Sequence[Errors]
    after: Sequence[Errors]
    adjustments_only: Sequence[Errors]
    noise_floor: Mapping[str, float | None]
    next_flight: NextFlight | None
    model: Model
    space: ParameterSpace
    diagnosis: Diagnosis
    residual: UnexplainedResidual
    audits: tuple[Audit, ...]
    description: Description | None
    """What the disturbance outside the library depends on; None where the verdict is another."""
    unexplained: Unexplained | None
    """The network's errors on what is left, where one was trained."""

    @property
    def horizon_s(self) -> float | None:
        """Return how far ahead held-out flights are predicted; None for whole flights."""
        return None if self.drive == "reference" else SEGMENT_S

    @property
    def before_score(self) -> dict[str, float] | None:
        """Return the held-out RMSE without effects; None where nothing was held out."""
        return rmse(self.before) if self.before else None

    @property
    def after_score(self) -> dict[str, float] | None:
        """Return the held-out RMSE with the model; None where nothing was held out."""
        return rmse(self.after) if self.after else None

    @property
    def evidence(self) -> dict[str, float]:
        """Nats that each candidate is worth: lost without a kept effect, gained with one that was not kept.

        Taken from the sets considered; a candidate that no set near the kept one holds is left out.
        """
        weights, kept = self.diagnosis.posterior_weights, set(self.diagnosis.selected.effects)
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
        """Return the effects that these flights would not show at typical size, or only within an alias."""
        return tuple(finding.subject[0] for finding in self.findings if finding.code is Code.HIDDEN)

    @property
    def all_findings(self) -> tuple[Finding, ...]:
        """Return the findings about the flights as a whole, the exact aliases, then those about each log."""
        exact = [each.finding for effect in self.effects for each in effect.exact_aliases.values()]
        return (*self.findings, *exact, *(finding for audit in self.audits for finding in audit.findings))
