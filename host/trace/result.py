"""The result of a trace as typed data; `answer.py` turns it into JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trimtab.host.log import ChangedSetting
from trimtab.host.models.model import Model
from trimtab.host.trace.data.audit import Audit
from trimtab.host.trace.data.cutting import SEGMENT_S
from trimtab.host.trace.data.logs import Drive
from trimtab.host.trace.decision.exact_aliases import ObservedAlias
from trimtab.host.trace.decision.findings import Code, Finding, Verdict
from trimtab.host.trace.hover.fit import HoverDiagnosis
from trimtab.host.trace.next_flight.separation import NextFlight
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.trace.prediction import Errors, rmse
from trimtab.host.trace.residual.description import Description
from trimtab.host.trace.residual.network import NetworkResult
from trimtab.host.trace.residual.unexplained import UnexplainedResidual
from trimtab.host.trace.selection import Diagnosis


@dataclass(frozen=True, kw_only=True)
class Value:
    """One parameter.

    Attributes
    ----------
    value, sd
        Value and standard deviation, in `unit`.
    unit
        Unit of both.
    """

    value: float
    sd: float
    unit: str


@dataclass(frozen=True, kw_only=True)
class Named:
    """A named effect.

    Attributes
    ----------
    name, title
        Name of the effect, and what it is.
    parameters
        Values by key.
    probability
        Posterior probability that it is present.
    aliases
        Probability of each alias.
    exact_aliases
        Aliases that fit every flight exactly as well, with what the flights show of the pair.
    """

    name: str
    title: str
    parameters: Mapping[str, Value]
    probability: float
    aliases: Mapping[str, float]
    exact_aliases: Mapping[str, ObservedAlias]

    @property
    def inexact_aliases(self) -> dict[str, float]:
        """Probability of the aliases that flights can distinguish from the effect."""
        return {name: p for name, p in self.aliases.items() if name not in self.exact_aliases}


@dataclass(frozen=True, kw_only=True)
class Baseline:
    """The baseline of a comparison.

    Attributes
    ----------
    logs
        Names of its logs.
    common
        Values that both sets have in common, by owner and key: an effect, or an adjustment such as the thrust
        curve.
    thrust_sigma
        Standard deviation within which the thrust scale of each log is free.
    settings
        Settings on board that differ between the sets; None if the logs of one set do not record them. They
        change no verdict, because recorded commands drive the model.
    """

    logs: tuple[str, ...]
    common: Mapping[str, Mapping[str, Value]]
    thrust_sigma: float
    settings: tuple[ChangedSetting, ...] | None


@dataclass(frozen=True, kw_only=True)
class Trace:
    """The result of a trace.

    Attributes
    ----------
    verdict, findings
        The verdict, and the findings about the flights as a whole.
    effects
        The named effects.
    possible
        Probability of further effects that the data does not exclude.
    drive
        Data that drive the predictions of held-out flights.
    before, after, adjustments_only
        Prediction errors without effects, with the model, and with only its adjustments, in m and m/s: one
        entry for each held-out flight.
    noise_floor
        Estimated prediction error of a perfect model.
    next_flight
        The proposed next flight; None if none is proposed.
    model
        The content of the model file.
    space, diagnosis
        Parameter space, and the selected effects with their probabilities.
    residual
        Unexplained residual that the findings refer to.
    audits
        Audit of each flight.
    description
        What a disturbance outside the library depends on; None for other verdicts.
    unexplained
        Errors of the network that was trained on the residual; None if none was trained.
    baseline
        The flights before the change; None without a baseline. With one, the named effects are what changed,
        and a value is that of a vehicle that was nominal before. `audits` begins with the baseline's.
    simulated_flights
        Number of flights that are known to be simulated, of those in `audits`.
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
    diagnosis: Diagnosis | HoverDiagnosis
    residual: UnexplainedResidual
    audits: tuple[Audit, ...]
    description: Description | None
    unexplained: NetworkResult | None
    baseline: Baseline | None = None
    simulated_flights: int = 0

    def to_dict(
        self,
        *,
        model_path: str | None = None,
        report_path: str | None = None,
        network_path: str | None = None,
    ) -> dict[str, Any]:
        """Return the object that `trimtab trace --json` prints, as plain data.

        model_path, report_path, network_path: files that were written; None for a file that was not.
        """
        from trimtab.host.trace.answer import to_json

        return to_json(self, model_path=model_path, report_path=report_path, network_path=network_path)

    def __repr__(self) -> str:
        named = ", ".join(effect.name for effect in self.effects)
        return f"<Trace {': '.join(filter(None, (str(self.verdict), named)))}>"

    def _repr_html_(self) -> str:
        from trimtab.host.trace.words import trace_card

        return trace_card(self)

    @property
    def horizon_s(self) -> float | None:
        """Prediction horizon on held-out flights; None for whole flights."""
        return None if self.drive == "reference" else SEGMENT_S

    @property
    def before_score(self) -> dict[str, float] | None:
        """Held-out RMSE without effects; None if no flight was held out."""
        return rmse(self.before) if self.before else None

    @property
    def after_score(self) -> dict[str, float] | None:
        """Held-out RMSE with the model; None if no flight was held out."""
        return rmse(self.after) if self.after else None

    @property
    def evidence(self) -> dict[str, float]:
        """Nats by which each candidate matters: the loss without a selected one, the gain with another one.

        A candidate is left out if the search did not consider the selected set with or without it.
        """
        weights, selected = self.diagnosis.posterior_weights, set(self.diagnosis.selected.effects)
        log_weight = float(np.log(max(weights.get(tuple(sorted(selected)), 0.0), 1e-300)))
        nats = {}
        for name in self.space.candidates:
            other = tuple(sorted(selected ^ {name}))
            if other in weights:
                gain = float(np.log(max(weights[other], 1e-300))) - log_weight
                nats[name] = -gain if name in selected else gain
        return nats

    @property
    def hidden(self) -> tuple[str, ...]:
        """Effects that these flights would not show at typical size, or only within an alias."""
        return tuple(finding.subject[0] for finding in self.findings if finding.code is Code.HIDDEN)

    @property
    def all_findings(self) -> tuple[Finding, ...]:
        """Findings about the flights as a whole, then exact aliases, then findings about each log."""
        exact = [each.finding for effect in self.effects for each in effect.exact_aliases.values()]
        return (*self.findings, *exact, *(finding for audit in self.audits for finding in audit.findings))
