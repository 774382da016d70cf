"""The result of a trace as typed data; `answer.py` turns it into JSON."""

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
    """A named effect: parameters by key, posterior probability, and its aliases with their probability."""

    name: str
    title: str
    parameters: Mapping[str, Value]
    probability: float
    aliases: Mapping[str, float]
    exact_aliases: Mapping[str, ObservedAlias]
    """Effects that fit exactly as well, by name, with what flights show of the two."""

    @property
    def inexact_aliases(self) -> dict[str, float]:
        """Return the probability of the aliases that flights can tell apart from it."""
        return {name: p for name, p in self.aliases.items() if name not in self.exact_aliases}


@dataclass(frozen=True, kw_only=True)
class Trace:
    """The whole result.

    possible: other effects that the data does not exclude, with their probability. before, after: one entry
    for each held-out flight; empty if none was held out.
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
    """What a disturbance outside the library depends on; None for other verdicts."""
    unexplained: Unexplained | None
    """Errors of the network that was trained on the residual; None if none was trained."""

    @property
    def horizon_s(self) -> float | None:
        """Return the prediction horizon on held-out flights; None for whole flights."""
        return None if self.drive == "reference" else SEGMENT_S

    @property
    def before_score(self) -> dict[str, float] | None:
        """Return the held-out RMSE without effects; None if no flight was held out."""
        return rmse(self.before) if self.before else None

    @property
    def after_score(self) -> dict[str, float] | None:
        """Return the held-out RMSE with the model; None if no flight was held out."""
        return rmse(self.after) if self.after else None

    @property
    def evidence(self) -> dict[str, float]:
        """Return the nats that each candidate is worth: lost without a selected one, gained with another one.

        It uses the sets considered. A candidate without a considered set next to the selected one is left
        out.
        """
        weights, selected = self.diagnosis.posterior_weights, set(self.diagnosis.selected.effects)
        log_weight = float(np.log(max(weights[tuple(sorted(selected))], 1e-300)))
        nats = {}
        for name in self.space.candidates:
            other = tuple(sorted(selected ^ {name}))
            if other in weights:
                gain = float(np.log(max(weights[other], 1e-300))) - log_weight
                nats[name] = -gain if name in selected else gain
        return nats

    @property
    def hidden(self) -> tuple[str, ...]:
        """Return the effects that these flights would not show at typical size, or only in an alias."""
        return tuple(finding.subject[0] for finding in self.findings if finding.code is Code.HIDDEN)

    @property
    def all_findings(self) -> tuple[Finding, ...]:
        """Return the findings about the flights as a whole, the exact aliases, then those about each log."""
        exact = [each.finding for effect in self.effects for each in effect.exact_aliases.values()]
        return (*self.findings, *exact, *(finding for audit in self.audits for finding in audit.findings))
