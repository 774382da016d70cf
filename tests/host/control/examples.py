"""A vehicle, a course, a network and settings for the tests of the controllers."""

from __future__ import annotations

import functools

import numpy as np

from trimtab.host.control.files import load_controller
from trimtab.host.control.settings import MpcSettings
from trimtab.host.effects import load_effects
from trimtab.host.models.model import Model
from trimtab.host.models.network import Layout, Network
from trimtab.host.plan import plan
from trimtab.host.route import load_route
from trimtab.host.vehicle import load_vehicle
from trimtab.protocol.blobs import Reference

VEHICLE = load_vehicle("research")
EFFECTS = load_effects()
DRAG = (0.45, 0.35, 0.25)
"""Faessler, Franchi and Scaramuzza 2018, 1/s."""
_LAYOUT = Layout(hidden=(8, 8), frame="body")
NETWORK = Network(layout=_LAYOUT, xi=2.0 * _LAYOUT.initial(np.random.default_rng(3)))


@functools.cache
def reference(route: str = "pretzel") -> Reference:
    """Min-snap through a shipped route."""
    return plan(load_route(route, None, VEHICLE), VEHICLE, stretch=True).reference


def settings(name: str = "mpc") -> MpcSettings:
    """Settings of a shipped controller on the host."""
    found = load_controller(name)
    assert isinstance(found, MpcSettings)
    return found


def drag_model(network: Network | None = None) -> Model:
    """A model file with the drag."""
    values: dict[str, float] = dict(zip(("dx", "dy", "dz"), DRAG, strict=True))
    return Model(
        vehicle_id=VEHICLE.id, vehicle_name=VEHICLE.name, effects={"linear-drag": values}, network=network
    )
