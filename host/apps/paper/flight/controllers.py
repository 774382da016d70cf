"""The controllers that fly in section VI-D and for remark 1: on board, and model predictive on the host."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from trimtab.host.control.files import load_controller
from trimtab.host.effects import Effect
from trimtab.host.link.controllers import flown_by
from trimtab.host.link.host_control import HostControl
from trimtab.host.models.model import Model
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import FeedForward

BASELINE, OBSERVER, NEURAL, NEURAL_OBSERVER = "baseline", "do", "neural", "neural-do"
MPC, MPC_L1, MPC_NEURAL = "mpc", "mpc-l1", "mpc-neural"
"""Names of shipped controllers on the host."""
TABLE_III = (BASELINE, OBSERVER, NEURAL_OBSERVER)
_ON_BOARD = {BASELINE: "dfbc", OBSERVER: "dfbc-do", NEURAL: "dfbc-neural", NEURAL_OBSERVER: "dfbc-neural-do"}
"""Shipped controller files by name."""


@dataclass(frozen=True, kw_only=True)
class Controller:
    """A controller on the host, or without `control` the flatness-based law with these on-board parameters.

    feedforward: of the law on board. model_id: id of the model that it is made from.
    """

    name: str
    parameters: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    feedforward: FeedForward | None = None
    model_id: str | None = None
    control: HostControl | None = None


def on_board(vehicle: Vehicle, feedforward: FeedForward | None = None) -> list[Controller]:
    """Return the shipped controllers on board; those with a feed-forward only if there is one."""
    found = []
    for name, file in _ON_BOARD.items():
        fed = name in (NEURAL, NEURAL_OBSERVER)
        if fed and feedforward is None:
            continue
        by = flown_by(file, load_controller(file), vehicle, feedforward=fed)
        blob = feedforward if fed else None
        found.append(
            Controller(
                name=name,
                parameters=by.parameters,
                feedforward=blob,
                model_id=None if blob is None else blob.model_id,
            )
        )
    return found


def on_host(vehicle: Vehicle, model: Model, effects: Mapping[str, Effect]) -> list[Controller]:
    """Return the shipped model predictive controllers; `model` is the residual in the prediction of one."""
    return [
        Controller(
            name=name,
            control=flown_by(
                name,
                load_controller(name),
                vehicle,
                feedforward=False,
                model=model if name == MPC_NEURAL else None,
                effects=effects,
            ).control,
        )
        for name in (MPC, MPC_L1, MPC_NEURAL)
    ]
