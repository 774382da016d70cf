"""Decision of the demo whether to apply the traced effects on board."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from trimtab.host.effects import Effect
from trimtab.host.models.correction import correction
from trimtab.host.models.model import Model
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import FeedForward


def to_apply(
    model: Model,
    vehicle: Vehicle,
    effects: Mapping[str, Effect],
    predict: Callable[[FeedForward | None], float],
) -> tuple[FeedForward | None, str]:
    """Return the feed-forward to fly with and an empty reason, or None and the reason for none.

    `predict` returns the tracking error (m) of the flight with or without a feed-forward.
    """
    made = correction(model, vehicle, effects)
    if made.feedforward is None:
        return None, f"{', '.join(model.effects)}: not compensable on board"
    if made.excess is not None:
        return None, f"{made.excess.quantity} {made.excess.value:.4g} is beyond {made.excess.bound:g}"
    without_m, applied_m = predict(None), predict(made.feedforward)
    if applied_m < without_m:
        return made.feedforward, ""
    return None, (
        f"the traced model predicts {1e3 * applied_m:.1f} mm RMSE with the effects applied and "
        f"{1e3 * without_m:.1f} mm without"
    )
