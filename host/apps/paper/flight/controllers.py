"""The controllers that fly in section VI-D and for remark 1, as settings of one firmware."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

from trimtab.protocol.blobs import FeedForward

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
