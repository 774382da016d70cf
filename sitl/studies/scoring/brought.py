"""Effects that a world's effects bring with them: a body bolted on also moves the centre of mass."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.vehicle import Vehicle
from trimtab.host.vehicle.strict_toml import read_strict
from trimtab.sitl.draw import draw_world
from trimtab.sitl.plant_constants import SHOWN_BY, plant_parameters
from trimtab.sitl.world import WorldFile


def brought_effects(truth: Mapping[str, Any], vehicle: Vehicle, space: ParameterSpace) -> frozenset[str]:
    """Return the effects that the drawn ones bring in our plant by more than a tolerance.

    They are physically there, though they were not drawn: it is neither right nor wrong to name them. Effects
    state what they bring in `Effect.comes_with`.
    """
    drawn = [name for name in truth["effects"] if name in space.effects]
    candidates = {other for name in drawn for other in space.effects[name].comes_with} - set(drawn)
    if truth["plant"] is not None or not candidates:
        return frozenset()
    file = read_strict(truth["file"], truth["world"], WorldFile)
    world = draw_world(truth["world"], file, truth["seed"], vehicle)
    with_them, without = (plant_parameters(vehicle, w) for w in (world, replace(world, effects={})))

    def change(name: str) -> float:
        quantity, columns = SHOWN_BY[name], space.groups[name]
        shift = np.subtract(with_them[quantity], without[quantity])[: len(columns)]
        return max(abs(d) / space.columns[i].tolerance for d, i in zip(shift, columns, strict=True))

    return frozenset(name for name in candidates if change(name) > 1.0)
