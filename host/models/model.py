"""A model: effects and residual beyond the nominal vehicle, their uncertainty, and the data behind them."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, get_args

from trimtab.host.base.artefacts import content_id
from trimtab.host.base.card import card, table
from trimtab.host.effects import Effect
from trimtab.host.models.airframe import Part
from trimtab.host.models.network import Network
from trimtab.host.models.region import Region

Values = Mapping[str, Mapping[str, float]]
"""Effect name -> parameter key -> value."""
VerdictCode = Literal["traced", "nothing-missing", "undecided", "outside-library", "learned"]
"""Verdict of a trace, or "learned"."""
Use = Literal["both", "effects", "adjustments", "none"]

NUISANCES = frozenset({"thrust-curve"})
"""Adjustments that are no effects: only the reading of a log needs them."""


@dataclass(frozen=True, kw_only=True)
class Covariance:
    """Covariance of the named parameters, "effect.key", in this order."""

    names: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        size = len(self.names)
        if len(set(self.names)) != size:
            raise ValueError(f"covariance names repeat: {self.names}")
        if len(self.matrix) != size or any(len(row) != size for row in self.matrix):
            raise ValueError(f"covariance of {size} names needs {size} x {size} entries")
        for i in range(size):
            if not (math.isfinite(self.matrix[i][i]) and self.matrix[i][i] >= 0.0):
                raise ValueError(
                    f"variance of {self.names[i]} is {self.matrix[i][i]}, must be finite and >= 0"
                )
            for k in range(i):
                a, b = self.matrix[i][k], self.matrix[k][i]
                if not abs(a - b) <= 1e-9 * math.sqrt(self.matrix[i][i] * self.matrix[k][k]) + 1e-300:
                    raise ValueError(f"covariance is not symmetric at {self.names[i]}, {self.names[k]}")

    def sd(self, name: str) -> float | None:
        """Return the standard deviation of a parameter, None where it is not among the names."""
        if name not in self.names:
            return None
        i = self.names.index(name)
        return math.sqrt(self.matrix[i][i])


@dataclass(frozen=True, kw_only=True)
class Assessment:
    """How far the data supports a model.

    Attributes
    ----------
    verdict
        Verdict of the trace; for a learned model "learned" if it predicts better than without it, else
        "undecided".
    probabilities
        Inclusion probability of each effect that a trace names or does not exclude.
    held_out_flights
        Number of held-out flights.
    before_m, after_m
        Position RMSE of their predictions without and with the model, m. None if no flight was held out, or
        if a prediction diverges.
    """

    verdict: VerdictCode
    probabilities: Mapping[str, float] = field(default_factory=dict)
    held_out_flights: int = 0
    before_m: float | None = None
    after_m: float | None = None

    def __post_init__(self) -> None:
        if self.verdict not in get_args(VerdictCode):
            raise ValueError(f"verdict {self.verdict!r} is not one of {', '.join(get_args(VerdictCode))}")
        for name, probability in self.probabilities.items():
            if not 0.0 <= probability <= 1.0:
                raise ValueError(f"probability of {name} is {probability}, must be within 0..1")
        errors = [error for error in (self.before_m, self.after_m) if error is not None]
        if errors and not self.held_out_flights:
            raise ValueError("held-out errors need held-out flights")
        if not all(0.0 <= error < math.inf for error in errors):
            raise ValueError(f"held-out errors must be finite and >= 0, got {errors}")


@dataclass(frozen=True, kw_only=True, eq=False)
class Model:
    """The content of a model file.

    Attributes
    ----------
    vehicle_id, vehicle_name
        Vehicle of the model.
    effects
        Values of the named effects, by effect and key, in the units of their parameters.
    adjustments
        The same of effects that moved within their tolerances. No effect is in both.
    covariance
        Covariance of the values; None if the file states none.
    sources
        Id of each effect's file.
    network, region
        Network of the residual acceleration, and the speeds, tilts and thrusts that its data covers.
    data
        Ids of the logs.
    assessment
        Verdict, probabilities and held-out errors; None in a file that states none.
    provenance
        Version, command and ids of the parents. It is no part of the id.
    """

    vehicle_id: str
    vehicle_name: str
    effects: Values = field(default_factory=dict)
    adjustments: Values = field(default_factory=dict)
    covariance: Covariance | None = None
    sources: Mapping[str, str] = field(default_factory=dict)
    network: Network | None = None
    region: Region | None = None
    data: tuple[str, ...] = ()
    assessment: Assessment | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        both = sorted(set(self.effects) & set(self.adjustments))
        if both:
            raise ValueError(f"{', '.join(both)}: an effect is either named or an adjustment, not both")
        known = set()
        for name, values in (*self.effects.items(), *self.adjustments.items()):
            for key, value in values.items():
                known.add(f"{name}.{key}")
                if not math.isfinite(value):
                    raise ValueError(f"{name}.{key} is {value}, must be finite")
        if self.covariance is not None and not set(self.covariance.names) <= known:
            extra = sorted(set(self.covariance.names) - known)
            raise ValueError(f"covariance names no parameter of this model: {', '.join(extra)}")

    def assessed(
        self,
        verdict: VerdictCode,
        *,
        probabilities: Mapping[str, float],
        flights: int,
        before_m: float | None,
        after_m: float | None,
    ) -> Model:
        """Return this model with its assessment; errors that are not finite are left out."""
        before_m, after_m = (
            error if error is not None and math.isfinite(error) else None for error in (before_m, after_m)
        )
        assessment = Assessment(
            verdict=verdict,
            probabilities=dict(sorted(probabilities.items())),
            held_out_flights=flights,
            before_m=before_m,
            after_m=after_m,
        )
        return replace(self, assessment=assessment)

    def without_adjustments(self, names: Collection[str]) -> Model:
        """Return this model without these adjustments and their covariance."""
        adjustments = {name: values for name, values in self.adjustments.items() if name not in names}
        covariance = self.covariance
        if covariance is not None:
            kept = [
                i
                for i, name in enumerate(covariance.names)
                if name.partition(".")[0] in {*self.effects, *adjustments}
            ]
            covariance = Covariance(
                names=tuple(covariance.names[i] for i in kept),
                matrix=tuple(tuple(covariance.matrix[i][k] for k in kept) for i in kept),
            )
        return replace(self, adjustments=adjustments, covariance=covariance)

    @cached_property
    def id(self) -> str:
        """First 12 hex digits of the SHA-256 of the content without provenance."""
        text = json.dumps(self.content(), sort_keys=True, separators=(",", ":"), allow_nan=False)
        return content_id(text.encode())

    def content(self) -> dict[str, Any]:
        """Return everything but the provenance as plain data, the network by its layout and hash."""
        content: dict[str, Any] = {
            "vehicle_id": self.vehicle_id,
            "vehicle_name": self.vehicle_name,
            "effects": _floats(self.effects),
            "adjustments": _floats(self.adjustments),
            "sources": dict(self.sources),
            "data": list(self.data),
        }
        if self.covariance is not None:
            content["covariance"] = {"names": self.covariance.names, "matrix": self.covariance.matrix}
        if self.region is not None:
            content["region"] = dict(vars(self.region))
        if self.assessment is not None:
            content["assessment"] = vars(self.assessment) | {
                "probabilities": dict(self.assessment.probabilities)
            }
        if self.network is not None:
            content["network"] = {
                "hidden": self.network.layout.hidden,
                "frame": self.network.layout.frame,
                "sha256": network_digest(self.network),
            }
        return content

    def to_dict(self) -> dict[str, Any]:
        """Return the content, the id and the provenance as plain data."""
        return {"id": self.id, **self.content(), "provenance": dict(self.provenance)}

    def _repr_html_(self) -> str:
        assessment, network = self.assessment, self.network
        held_out = None
        if assessment is not None and assessment.before_m is not None and assessment.after_m is not None:
            held_out = f"{1e3 * assessment.before_m:.1f} mm before, {1e3 * assessment.after_m:.1f} mm after"
        return card(
            f"Model {self.id}",
            [
                ("vehicle", self.vehicle_name),
                ("verdict", None if assessment is None else assessment.verdict),
                ("prediction error of held-out flights", held_out),
                ("network, hidden layers", None if network is None else str(network.layout.hidden)),
                ("logs", len(self.data)),
                ("adjusted within tolerance", ", ".join(self.adjustments) or None),
            ],
            table(
                ("effect", "parameter", "value", "sd"),
                [
                    (name, key, value, self.sd(name, key))
                    for name, values in self.effects.items()
                    for key, value in values.items()
                ],
            ),
        )

    def sd(self, name: str, key: str) -> float | None:
        """Return the standard deviation of a parameter; None where the file has none."""
        return None if self.covariance is None else self.covariance.sd(f"{name}.{key}")

    def parts(self, effects: Mapping[str, Effect], use: Use = "both") -> list[Part]:
        """Return effects with values for `host.models`, sorted by name; missing keys are neutral.

        Nuisances are left out. Raises ValueError for an unknown effect or key.
        """
        chosen: dict[str, Mapping[str, float]] = {}
        if use in ("both", "effects"):
            chosen.update(self.effects)
        if use in ("both", "adjustments"):
            chosen.update(self.adjustments)
        parts: list[Part] = []
        for name in sorted(set(chosen) - NUISANCES):
            effect = effects.get(name)
            if effect is None:
                raise ValueError(
                    f"the model names {name}, which is no known effect; known: {', '.join(effects)}"
                )
            extra = sorted(set(chosen[name]) - set(effect.keys))
            if extra:
                raise ValueError(
                    f"{name} has no parameter {', '.join(extra)}; it has {', '.join(effect.keys)}"
                )
            theta = tuple(
                chosen[name].get(key, neutral)
                for key, neutral in zip(effect.keys, effect.neutral, strict=True)
            )
            parts.append((effect, theta))
        return parts


def network_digest(network: Network) -> str:
    """Return the SHA-256 of the weights as little-endian doubles."""
    return hashlib.sha256(network.xi.astype("<f8").tobytes()).hexdigest()


def _floats(parameters: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """Return parameters by effect as floats: an integer would be written, and hashed, as another value."""
    return {name: {key: float(value) for key, value in values.items()} for name, values in parameters.items()}
