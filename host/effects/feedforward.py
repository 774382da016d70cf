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
    }


def compose_feedforward(
    effects: Iterable[tuple[Effect, Sequence[float]]], voltage_ratio: float = 1.0
) -> Contributions:
    """Return the entries of the feed-forward block for all effects together.

    Gains are multiplied, all other contributions are added. An effect without `to_feedforward` contributes
    nothing. The block does not know the air speed, so wind enters as the drag that it causes on a level
    vehicle at rest: bias_ned = (d + c |w|) w, with d and c the means of the horizontal linear and quadratic
    coefficients. The block does not know the battery, so a `voltage_exponent` enters as the gain at
    `voltage_ratio`.

    Parameters
    ----------
    effects
        Effects with their parameter values.
    voltage_ratio
        Expected battery voltage over full voltage.

    Raises
    ------
    ValueError
        If an effect contributes an entry that the block does not have, or if voltage_ratio is not positive.
    """
    if not voltage_ratio > 0.0:
        raise ValueError(f"voltage ratio must be positive, got {voltage_ratio}")
    total = neutral_contributions()
    wind = (0.0, 0.0, 0.0)
    for effect, theta in effects:
        if effect.to_feedforward is None:
            continue
        for key, value in effect.to_feedforward(tuple(float(number) for number in theta)).items():
            if key == "wind_ned":
                wind = _sum(wind, value)
            elif key == "gain":
                total["gain"] *= value
            elif key == "voltage_exponent":
                total["gain"] *= voltage_ratio**value
            elif key == "prediction_time_s":
                total["prediction_time_s"] += value
            elif key in total:
                total[key] = _sum(total[key], value)
            else:
                raise ValueError(f"effect {effect.name}: the feed-forward block has no {key!r}")
    speed = sum(w * w for w in wind) ** 0.5
    linear, quadratic = total["linear_drag"], total["quadratic_drag"]
    rate = 0.5 * (linear[0] + linear[1]) + 0.5 * (quadratic[0] + quadratic[1]) * speed
    total["bias_ned"] = _sum(total["bias_ned"], tuple(rate * w for w in wind))
    return total


def _sum(a: Sequence[float], b: Sequence[float]) -> tuple[float, ...]:
    return tuple(x + y for x, y in zip(a, b, strict=True))
