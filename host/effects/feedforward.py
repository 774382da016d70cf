"""Composition of the feed-forward block on board from effects and their parameter values."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from trimtab.host.effects.effect import Effect

Contributions = dict[str, Any]


def neutral_contributions() -> Contributions:
    """Return the block that changes nothing: gain 1, all other entries 0."""
    return {
        "gain": 1.0,
        "bias_ned": (0.0, 0.0, 0.0),
        "linear_drag": (0.0, 0.0, 0.0),
        "quadratic_drag": (0.0, 0.0, 0.0),
        "attitude_offset": (0.0, 0.0),
        "prediction_time_s": 0.0,
        "wind_ned": (0.0, 0.0, 0.0),
        "voltage_exponent": 0.0,
    }


def compose_feedforward(effects: Iterable[tuple[Effect, Sequence[float]]]) -> Contributions:
    """Return the entries of the feed-forward block for all effects together.

    Gains are multiplied, all other contributions are added. An effect without `to_feedforward` contributes
    nothing.

    Parameters
    ----------
    effects
        Effects with their parameter values.

    Raises
    ------
    ValueError
        If an effect contributes an entry that the block does not have.
    """
    total = neutral_contributions()
    for effect, theta in effects:
        if effect.to_feedforward is None:
            continue
        for key, value in effect.to_feedforward(tuple(float(number) for number in theta)).items():
            if key not in total:
                raise ValueError(f"effect {effect.name}: the feed-forward block has no {key!r}")
            if key == "gain":
                total["gain"] *= value
            elif isinstance(total[key], tuple):
                total[key] = _sum(total[key], value)
            else:
                total[key] += value
    return total


def _sum(a: Sequence[float], b: Sequence[float]) -> tuple[float, ...]:
    return tuple(x + y for x, y in zip(a, b, strict=True))
