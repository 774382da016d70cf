"""The controllers that fly in section VI-D and for remark 1, as settings of one firmware."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

from trimtab.host.effects import Effect, compose_feedforward
from trimtab.host.models.model import Model
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import BLOCK_FIELDS, NEUTRAL_BLOCK, FeedForward, TrainedRegion

BASELINE, OBSERVER, NEURAL, NEURAL_OBSERVER = "baseline", "do", "neural", "neural-do"
TABLE_III = (BASELINE, OBSERVER, NEURAL_OBSERVER)
BANDWIDTH = 5.0
"""1/s, of the disturbance observer. The paper prints none."""


@dataclass(frozen=True, kw_only=True)
class Controller:
    """The flatness-based law with on-board parameters and a feed-forward, or none.

    model_id: id of the model that the feed-forward is made from.
    """

    name: str
    parameters: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    feedforward: FeedForward | None = None
    model_id: str | None = None


def controllers(feedforward: FeedForward | None) -> Sequence[Controller]:
    """Return all controllers; those with a feed-forward only if there is one."""
    observer = {"OBS_GAIN": BANDWIDTH}
    found = [Controller(name=BASELINE), Controller(name=OBSERVER, parameters=observer)]
    if feedforward is not None:
        model_id = feedforward.model_id
        found += [
            Controller(name=NEURAL, feedforward=feedforward, model_id=model_id),
            Controller(name=NEURAL_OBSERVER, parameters=observer, feedforward=feedforward, model_id=model_id),
        ]
    return found


def feedforward_of(model: Model, vehicle: Vehicle, effects: Mapping[str, Effect]) -> FeedForward | None:
    """Return the feed-forward of a learned model, with its network and its region; None if it is empty."""
    numbers = compose_feedforward(model.parts(effects, use="effects"))
    block: list[float] = []
    for name, size in BLOCK_FIELDS:
        start = len(block)
        value = numbers.get(name, NEUTRAL_BLOCK[start : start + size])
        block += [value] if isinstance(value, float) else list(value)
    network, region = model.network, model.region
    if network is None and tuple(block) == NEUTRAL_BLOCK:
        return None
    return FeedForward(
        vehicle_id=vehicle.id,
        model_id=model.id,
        block=tuple(block),
        layers=() if network is None else network.layout.hidden,
        weights=() if network is None else tuple(network.xi),
        frame="world" if network is None else network.layout.frame,
        region=None
        if region is None
        else TrainedRegion(
            speed_max_m_s=region.speed_max_m_s,
            tilt_max_rad=math.radians(region.tilt_max_deg),
            thrust_min_m_s2=region.thrust_min_n / vehicle.mass_kg,
            thrust_max_m_s2=region.thrust_max_n / vehicle.mass_kg,
        ),
    )
