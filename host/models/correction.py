"""Corrections: the feed-forward that compensates a model's effects and network on board."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trimtab.firmware_model.law.feedforward import gain_at_voltage
from trimtab.firmware_model.law.feedforward_range import Excess, out_of_range
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.host.base import artefacts
from trimtab.host.effects import Effect, compose_feedforward
from trimtab.host.effects.feedforward import Contributions, neutral_contributions
from trimtab.host.models.model import Model
from trimtab.host.models.reference import block as law_block
from trimtab.host.models.region import Region
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import BLOCK_FIELDS, NEUTRAL_BLOCK, FeedForward, TrainedRegion

SUFFIX = ".ff"
_NETWORK = "network"
_NETWORK_LAW = "its acceleration along the reference, and the derivative of it, are fed forward"
_NO_TERM = "the feed-forward has no term for it"
_NO_DRAG = "it acts through a drag, and the model has none"


@dataclass(frozen=True, kw_only=True)
class Correction:
    """What of a model goes on board.

    Attributes
    ----------
    feedforward
        The feed-forward; None if nothing can be compensated.
    corrected
        How the law compensates, by effect or "network".
    uncorrected
        Why it cannot, by effect.
    excess
        First quantity out of the range that vehicles accept; None within it.
    """

    feedforward: FeedForward | None
    corrected: Mapping[str, str]
    uncorrected: Mapping[str, str]
    excess: Excess | None

    def to_json(self) -> dict[str, Any]:
        """Return what is corrected, and what is not and why."""
        return {"corrected": dict(self.corrected), "uncorrected": dict(self.uncorrected)}


def correction(model: Model, vehicle: Vehicle, effects: Mapping[str, Effect]) -> Correction:
    """Return the correction of a model's effects, adjustments and network for its vehicle.

    Adjustments are corrected too: their values are the best estimates within the tolerances. Only named
    effects are listed as uncorrected.

    Raises ValueError for an effect that is not in the library, or a contribution that the block lacks.
    """
    parts = model.parts(effects)
    numbers = compose_feedforward(parts)
    has_drag = any(numbers["linear_drag"]) or any(numbers["quadratic_drag"])
    corrected, uncorrected = {}, {}
    for effect, theta in parts:
        why_not = _why_not(effect, theta, has_drag)
        if why_not is None:
            corrected[effect.name] = effect.closing.law or ""
        elif effect.name in model.effects:
            uncorrected[effect.name] = why_not
    if not has_drag:
        numbers |= {"wind_ned": (0.0, 0.0, 0.0)}
    block = _flat(numbers)
    network = model.network
    if network is not None:
        corrected[_NETWORK] = _NETWORK_LAW
    if block == NEUTRAL_BLOCK and network is None:
        return Correction(feedforward=None, corrected={}, uncorrected=uncorrected, excess=None)
    feedforward = FeedForward(
        vehicle_id=vehicle.id,
        model_id=model.id,
        block=block,
        layers=() if network is None else network.layout.hidden,
        weights=() if network is None else tuple(network.xi.tolist()),
        frame="world" if network is None else network.layout.frame,
        region=None if model.region is None else _on_board(model.region, vehicle, numbers),
    )
    excess = out_of_range(
        law_block(feedforward),
        feedforward.weights,
        feedforward.layers,
        body_frame=feedforward.body_frame,
    )
    return Correction(feedforward=feedforward, corrected=corrected, uncorrected=uncorrected, excess=excess)


def _why_not(effect: Effect, theta: Sequence[float], has_drag: bool) -> str | None:
    """Return why the law cannot compensate an effect with these parameters, or None if it can."""
    if effect.closing.law is None:
        return effect.closing.no_law or _NO_TERM
    own = compose_feedforward([(effect, theta)])
    if any(own.pop("wind_ned")) and not has_drag and own.items() <= neutral_contributions().items():
        return _NO_DRAG
    return None


def _flat(numbers: Contributions) -> tuple[float, ...]:
    """Return the block of a feed-forward."""
    block: list[float] = []
    for name, size in BLOCK_FIELDS:
        block += [numbers[name]] if size == 1 else list(numbers[name])
    return tuple(block)


def _on_board(region: Region, vehicle: Vehicle, numbers: Contributions) -> TrainedRegion:
    """Return a region as the vehicle checks it.

    A region has nominal thrusts; the vehicle compares the thrust over mass of the reference, which is larger
    by the gain. The region does not tell at which voltages a thrust occurred, so the least one counts at an
    empty battery and the greatest at a full one.
    """
    per_newton, exponent = numbers["gain"] / vehicle.mass_kg, numbers["voltage_exponent"]
    empty = gain_at_voltage(FLOAT, per_newton, exponent, vehicle.battery.empty_v / vehicle.battery.full_v)
    return TrainedRegion(
        region.speed_max_m_s,
        math.radians(region.tilt_max_deg),
        region.thrust_min_n * min(empty, per_newton),
        region.thrust_max_n * max(empty, per_newton),
    )


def check_name(path: Path | str, force: bool = False) -> Path:
    """Return the path, if a feed-forward may be written there. Raises UsageError."""
    return artefacts.check_recorded(path, suffix=SUFFIX, what="feed-forward", force=force)


def write_correction(
    feedforward: FeedForward,
    path: Path | str,
    *,
    contents: Correction,
    provenance: Mapping[str, Any],
    force: bool = False,
) -> Path:
    """Write the feed-forward, and `NAME.ff.json` with its contents and provenance; return its path.

    Each file appears whole or not at all, the feed-forward last. Raises UsageError where a file exists and
    `force` is not set.
    """
    path = check_name(path, force)
    record = {
        "feedforward": feedforward.id,
        "vehicle": feedforward.vehicle_id,
        "provenance": dict(provenance),
        **contents.to_json(),
    }
    return artefacts.write_recorded(path, feedforward.to_bytes(), record, force)
