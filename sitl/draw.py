"""Draw of a world from a seed: effects with values, deviations of the build, sensors, links, processor."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from trimtab.host.vehicle import Vehicle
from trimtab.sitl.kinds import DRAG, KINDS, Kind, Quantity
from trimtab.sitl.seeds import Purpose, world_generator
from trimtab.sitl.world import (
    Battery,
    Build,
    Draw,
    ImuSettings,
    MocapSettings,
    RadioSettings,
    SerialSettings,
    TimingSettings,
    Turbulence,
    WorldFile,
)

_DEGREES = 3
"""Degrees of freedom of heavy-tailed deviations (Student t)."""


@dataclass(frozen=True, kw_only=True)
class World:
    """One world. `effects` maps a kind to its values, `deviations` (kind, key) to that of the build."""

    name: str
    seed: int
    effects: Mapping[str, Mapping[str, float]]
    deviations: Mapping[tuple[str, str], float]
    battery: Battery
    turbulence: Turbulence
    mocap: MocapSettings
    imu: ImuSettings
    radio: RadioSettings
    serial: SerialSettings
    timing: TimingSettings

    def value(self, kind: str, key: str) -> float:
        """Return a value of the plant: the effect's, else neutral plus the build's deviation."""
        if kind in self.effects:
            return self.effects[kind][key]
        quantity = next(q for q in KINDS[kind].quantities if q.key == key)
        value = quantity.neutral + self.deviations.get((kind, key), 0.0)
        return min(max(value, quantity.lower), quantity.upper)


def draw_world(name: str, file: WorldFile, seed: int, vehicle: Vehicle) -> World:
    """Return the world of a file and a seed for this vehicle. It depends on nothing else."""
    effects = dict(file.stated)
    if file.draw is not None:
        for kind in _draw_kinds(file.draw, frozenset(effects), seed):
            effects[kind] = _draw_sizes(KINDS[kind], file.draw, seed)
    return World(
        name=name,
        seed=seed,
        effects={kind: effects[kind] for kind in KINDS if kind in effects},
        deviations=_draw_deviations(vehicle, file.build, seed) if file.tolerances else {},
        battery=file.battery,
        turbulence=file.turbulence,
        mocap=file.mocap,
        imu=file.imu,
        radio=file.radio,
        serial=file.serial,
        timing=file.timing,
    )


def _draw_kinds(draw: Draw, stated: frozenset[str], seed: int) -> list[str]:
    """Return the kinds of effect: a uniform choice among the sets that have a drag if they have wind."""
    rng = world_generator(seed, Purpose.KINDS)
    drags = set(DRAG)
    needs_drag = not stated & drags
    while True:
        count = int(rng.integers(draw.count[0], draw.count[1] + 1))
        chosen = {draw.kinds[i] for i in rng.permutation(len(draw.kinds))[:count]}
        if "wind" not in chosen or not needs_drag or chosen & drags:
            return [kind for kind in KINDS if kind in chosen]


def _draw_sizes(kind: Kind, draw: Draw, seed: int) -> dict[str, float]:
    """Return the values of one kind: log-uniform multiples of the typical size, spread as `Spread` describes.

    Positions, directions and lengths are uniform in their own intervals.
    """
    rng = world_generator(seed, Purpose.SIZES, list(KINDS).index(kind.name))
    low, high = (math.log(bound) for bound in draw.size)
    count = len(kind.quantities)
    if kind.spread == "turned":
        angle = rng.uniform(0.0, 2.0 * math.pi)
        size = math.exp(rng.uniform(low, high))
        factors = [size * math.cos(angle), size * math.sin(angle)]
        factors += [0.5 * math.exp(rng.uniform(low, high)) * rng.choice((-1.0, 1.0)) for _ in range(2, count)]
    elif kind.spread == "one":
        factors = [0.0] * count
        factors[rng.integers(count)] = math.exp(rng.uniform(low, high))
    else:
        factors = [math.exp(f) for f in rng.uniform(low, high, count)]
        if kind.spread == "either":
            factors = [f * rng.choice((-1.0, 1.0)) for f in factors]
    return {
        q.key: _bounded(q, f)
        if q.drawn is None
        else float(rng.uniform(*draw.uniform.get(f"{kind.name}.{q.key}", q.drawn)))
        for q, f in zip(kind.quantities, factors, strict=True)
    }


def _bounded(quantity: Quantity, factor: float) -> float:
    return float(np.clip(quantity.neutral + factor * quantity.typical, quantity.lower, quantity.upper))


def _draw_deviations(vehicle: Vehicle, build: Build, seed: int) -> dict[tuple[str, str], float]:
    """Return the deviations of the build: a draw for each value, in units of the vehicle's tolerance."""
    rng = world_generator(seed, Purpose.TOLERANCES)
    most = math.inf if build.clip is None else build.clip
    deviations = {}
    for kind in KINDS.values():
        for quantity in kind.quantities:
            drawn = rng.standard_normal() if build.distribution == "normal" else rng.standard_t(_DEGREES)
            share = min(max(float(drawn), -most), most)
            sigma = vehicle.tolerance(kind.name, quantity.key, quantity.tolerance) if kind.deviates else 0.0
            if sigma > 0.0:
                deviations[kind.name, quantity.key] = sigma * (abs(share) if kind.one_sided else share)
    return deviations
