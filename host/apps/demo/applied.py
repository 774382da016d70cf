"""Feed-forward block that compensates the traced effects on board."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from trimtab.firmware_model.law.feedforward import NEUTRAL
from trimtab.host.effects import Effect, compose_feedforward
from trimtab.host.log import Flight
from trimtab.host.models.model import Model
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import BLOCK_FIELDS, FeedForward


def feedforward_of(
    model: Model, vehicle: Vehicle, effects: Mapping[str, Effect], voltage_ratio: float
) -> FeedForward | None:
    """Return the feed-forward for the model's effects at a battery voltage over full; None if it is empty."""
    numbers = compose_feedforward(model.parts(effects, use="effects"), voltage_ratio)
    block: list[float] = []
    for name, size in BLOCK_FIELDS:
        block += [numbers[name]] if size == 1 else list(numbers[name])
    if tuple(block) == NEUTRAL:
        return None
    return FeedForward(vehicle_id=vehicle.id, model_id=model.id, block=tuple(block))


def to_apply(
    model: Model,
    vehicle: Vehicle,
    effects: Mapping[str, Effect],
    voltage_ratio: float,
    predict: Callable[[FeedForward | None], float],
) -> tuple[FeedForward | None, str]:
    """Return the feed-forward to fly with and an empty reason, or None and the reason for none.

    `predict` returns the tracking error (m) of the flight with or without a feed-forward.
    """
    feedforward = feedforward_of(model, vehicle, effects, voltage_ratio)
    if feedforward is None:
        return None, f"{', '.join(model.effects)}: not compensable on board"
    without_m, applied_m = predict(None), predict(feedforward)
    if applied_m < without_m:
        return feedforward, ""
    return None, (
        f"the traced model predicts {1e3 * applied_m:.1f} mm RMSE with the effects applied and "
        f"{1e3 * without_m:.1f} mm without"
    )


def voltage_ratio(flights: Sequence[Flight]) -> float:
    """Return the mean battery voltage of flights while tracking, over full voltage; 1 if none is logged.

    The next flight is expected to have this voltage.
    """
    means = []
    for flight in flights:
        if flight.battery is not None and flight.tracking is not None:
            start_us, end_us = flight.tracking
            during = (flight.battery.t_us >= start_us) & (flight.battery.t_us <= end_us)
            if during.any():
                volts = flight.battery.battery_v[during].mean()
                means.append(volts / flight.vehicle.battery.full_v)
    return float(np.mean(means)) if means else 1.0
