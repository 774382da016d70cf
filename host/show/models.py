"""Models as facts of a page: effects with intervals, verdict, probabilities and held-out errors."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from trimtab.host.effects import Effect
from trimtab.host.models.model import NUISANCES, Model

SDS = 2.0
"""Standard deviations on each side of a value that an interval covers, as in the lines of `trace`."""


def model_facts(model: Model, path: Path, effects: Mapping[str, Effect]) -> dict[str, Any]:
    """Return the facts of a model for `--json` and the page."""
    assessment = model.assessment
    probabilities = {} if assessment is None else assessment.probabilities
    rows = [
        _parameter(model, name, key, value, named, effects)
        for named, values in ((True, model.effects), (False, model.adjustments))
        for name, keys in sorted(values.items())
        if name not in NUISANCES
        for key, value in keys.items()
    ]
    network = None if model.network is None else list(model.network.layout.hidden)
    return {
        "model": str(path),
        "id": model.id,
        "vehicle": model.vehicle_name,
        "verdict": None if assessment is None else assessment.verdict,
        "logs": len(model.data),
        "held_out_flights": None if assessment is None else assessment.held_out_flights,
        "error_before_m": None if assessment is None else assessment.before_m,
        "error_after_m": None if assessment is None else assessment.after_m,
        "probabilities": dict(probabilities),
        "parameters": rows,
        "network_hidden": network,
        "notes": _notes(model),
    }


def _parameter(
    model: Model, name: str, key: str, value: float, named: bool, effects: Mapping[str, Effect]
) -> dict[str, Any]:
    """Return one parameter with its interval; the unit is None for an effect that is not known here."""
    effect = effects.get(name)
    units = {} if effect is None else {p.key: p.unit for p in effect.parameters}
    neutral = {} if effect is None else {p.key: p.neutral for p in effect.parameters}
    sd = model.sd(name, key)
    return {
        "effect": name,
        "key": key,
        "named": named,
        "value": value,
        "unit": units.get(key),
        "neutral": neutral.get(key),
        "low": None if sd is None else value - SDS * sd,
        "high": None if sd is None else value + SDS * sd,
    }


def _notes(model: Model) -> list[str]:
    """Return what a reader must know of a model, as sentences."""
    notes = []
    if model.assessment is None:
        notes.append("The file states no verdict. Nothing shows whether the data supports the model.")
    elif model.assessment.before_m is None:
        notes.append("The file states no held-out prediction error.")
    if model.network is not None:
        notes.append("A network predicts a further part of the residual. Its weights are not shown.")
    return notes
