"""The worlds of a blind study: classes in the proportions of the full study, kinds in rotation.

They depend on the study's seed and the simulator's list of kinds. Sizes and tolerances are then drawn from
the seed of each world.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np

from trimtab.sitl.kinds import DRAG, KINDS
from trimtab.sitl.studies.files import StudyError
from trimtab.sitl.studies.plants import PLANTS
from trimtab.sitl.world import ImuSettings, Turbulence

Class = Literal["none", "single", "pair", "triple", "outside", "thin", "several"]
FULL: dict[Class, int] = {
    "single": 250,
    "pair": 150,
    "triple": 100,
    "none": 250,
    "outside": 120,
    "thin": 48,
}
"""Worlds of each class in a blind study of full size; smaller and larger ones keep the proportions. Worlds of
several effects are of other studies.
"""

IN_PLANTS: tuple[Class, ...] = ("single", "pair", "none")
"""Classes of worlds in the plants of other simulators."""

SIZE = (0.2, 4.0)
"""Least and greatest multiple of the typical size in a blind study; tracing expects 1."""

CLIP = 2.0
"""Greatest deviation of a build in a blind study, in tolerances; tracing expects a normal distribution."""

LINES = {"slung-payload.length_m": (0.3, 0.7)}
"""Length of lines in a blind study. References descend to half a metre, so payloads may drag on the floor."""

DRYDEN = 0.5
"""Share of the worlds of a blind study that have gusts with Dryden's spectrum."""

CALM = (0.5, 2.0)
"""Least and greatest multiple of the nominal turbulence."""

THIN = (
    "one flight",
    "no twins",
    "no gyro",
    "sampled telemetry",
    "no reference",
    "two vehicles",
    "three seconds",
    "constant hover",
)
"""Kinds of thin data, in rotation."""

SAME_RATIO = frozenset({"mass", "thrust-gain", "inertia"})
"""Kinds of which flights show only ratios; no two of them are in one world."""


@dataclass(frozen=True, kw_only=True)
class PlannedWorld:
    """One world of a study. `case` is the kind of thin data, if any, `plant` a name in `plants.PLANTS`.

    `few`: it is also traced from one flight, and from one pair of repeat flights. `wide`: sizes, deviations,
    batteries and lines are not drawn as tracing expects them; a world that the vehicle cannot fly is drawn
    again. `dryden`: gusts have Dryden's spectrum.
    """

    name: str
    kind_class: Class
    kinds: tuple[str, ...]
    seed: int
    turbulence: float
    case: str | None = None
    plant: str | None = None
    few: bool = False
    wide: bool = False
    dryden: bool = False

    @property
    def is_measured(self) -> bool:
        """Whether parameters are compared: all effects of the world are in the library."""
        return self.kind_class in ("single", "pair", "triple")

    def without_effects(self) -> PlannedWorld:
        """Return the same world without its effects: the same build."""
        return replace(self, kinds=())

    def toml(self, *, still: bool = False) -> str:
        """Return the world file; with `still`, the same world in still air with perfect sensors."""
        usual, strength = Turbulence(), 0.0 if still else self.turbulence
        lines = ['description = "A world of a blind study"', "tolerances = true"]
        if self.wide:
            lines += ["", "[build]", 'distribution = "student-t"', f"clip = {CLIP}"]
            lines += ["", "[battery]", "discharges = true"]
        lines += [
            "",
            "[turbulence]",
            f"force_m_s2 = {usual.force_m_s2 * strength:.6f}",
            f"torque_rad_s2 = {usual.torque_rad_s2 * strength:.6f}",
            *(['spectrum = "dryden"'] if self.dryden else []),
        ]
        if still:
            lines += ["", "[mocap]", "position_noise_m = 0.0", "attitude_noise_deg = 0.0", "dropout = 0.0"]
            lines += ["", "[imu]", *(f"{name} = 0.0" for name in ImuSettings.model_fields)]
        if self.kinds:
            names = ", ".join(f'"{kind}"' for kind in self.kinds)
            count = len(self.kinds)
            lines += ["", "[draw]", f"count = [{count}, {count}]", f"kinds = [{names}]"]
            lines += [f"size = {list(SIZE)}"] if self.wide else []
            places = {name: bounds for name, bounds in LINES.items() if name.split(".")[0] in self.kinds}
            if self.wide and places:
                lines += ["", "[draw.uniform]", *(f'"{name}" = {list(b)}' for name, b in places.items())]
        return "\n".join(lines) + "\n"


def split(count: int, classes: Sequence[Class] = tuple(FULL)) -> dict[Class, int]:
    """Return the number of worlds of each of the classes: the full study's proportions, at least one each.

    Rounds by largest remainder. Raises StudyError if there are fewer worlds than classes.
    """
    if count < len(classes):
        raise StudyError(
            f"--worlds {count} is fewer than the {len(classes)} classes; give {len(classes)} or more"
        )
    whole = sum(FULL[name] for name in classes)
    shares: dict[Class, float] = {name: count * FULL[name] / whole for name in classes}
    parts: dict[Class, int] = {name: max(1, math.floor(share)) for name, share in shares.items()}
    for name in sorted(shares, key=lambda name: parts[name] - shares[name])[: count - sum(parts.values())]:
        parts[name] += 1
    while sum(parts.values()) > count:  # small classes were raised to one
        parts[max(parts, key=lambda name: parts[name] - shares[name] if parts[name] > 1 else -1.0)] -= 1
    return parts


def plan_worlds(
    seed: int,
    count: int,
    library: Collection[str],
    few_share: float = 1.0,
    plant: str | None = None,
) -> list[PlannedWorld]:
    """Return the `count` worlds of a seed, shuffled; `library` holds the names of the host's effects.

    Kinds marked as outside make worlds outside the library. Kinds in the library are drawn alone, also for
    thin data, and in pairs and triples; wind is never alone, because it acts through a drag. In a plant of
    `plants.PLANTS` there are the classes IN_PLANTS and the kinds that it has. `few_share` of the worlds
    inside the library, evenly spaced, are also traced from few flights. Raises StudyError if there are fewer
    worlds than classes, or if the share is not in 0..1.
    """
    if not 0.0 <= few_share <= 1.0:
        raise StudyError(f"--few-flights {few_share:g} is no share; give 0 to 1")
    parts = dict.fromkeys(FULL, 0) | split(count, tuple(FULL) if plant is None else IN_PLANTS)
    rng = np.random.default_rng([seed, 0])
    inside = [kind.name for kind in KINDS.values() if not kind.outside and kind.name in library]
    if plant is not None:
        inside = [name for name in inside if name in PLANTS[plant].effects]
    alone = [name for name in inside if name != "wind"]
    outside = [kind.name for kind in KINDS.values() if kind.outside]
    sets: dict[Class, list[tuple[str, ...]]] = {
        "none": [()] * parts["none"],
        "single": [(name,) for name in _rotation(alone, parts["single"], rng)],
        "pair": _sets(inside, 2, parts["pair"], rng),
        "triple": _sets(inside, 3, parts["triple"], rng),
        "outside": [(name,) for name in _rotation(outside, parts["outside"], rng)],
        "thin": [(name,) for name in _rotation(alone, parts["thin"], rng)],
    }
    cycle = math.lcm(len(THIN), len(alone))  # after which kinds and cases would meet again
    order = _rotation(THIN, len(THIN), rng)
    cases = iter(order[(i + i // cycle) % len(order)] for i in range(parts["thin"]))
    drawn = [
        (kind_class, kinds, next(cases) if kind_class == "thin" else None)
        for kind_class, found in sets.items()
        for kinds in found
    ]
    low, high = (math.log(bound) for bound in CALM)
    worlds = [
        PlannedWorld(
            name=f"{index:04d}",
            kind_class=drawn[place][0],
            kinds=drawn[place][1],
            case=drawn[place][2],
            plant=plant,
            seed=world_seed(seed, index),
            turbulence=math.exp(rng.uniform(low, high)),
            wide=True,
            dryden=bool(rng.random() < DRYDEN),
        )
        for index, place in enumerate(rng.permutation(len(drawn)).tolist())
    ]
    inside = [world.name for world in worlds if world.is_measured or world.kind_class == "none"]
    few = {
        name for i, name in enumerate(inside) if math.floor((i + 1) * few_share) > math.floor(i * few_share)
    }
    return [replace(world, few=world.name in few) for world in worlds]


def redrawn_seed(seed: int, attempt: int) -> int:
    """Return the seed of a world at an attempt to draw it; the first attempt, 0, has the world's own seed."""
    return seed if attempt == 0 else world_seed(seed, attempt, "drawn again")


def world_seed(seed: int, index: int, study: str = "blind study") -> int:
    """Return the seed of a world: 48 bits that reveal neither the study's seed nor the index."""
    return int.from_bytes(hashlib.sha256(f"{study} {seed} world {index}".encode()).digest()[:6], "big")


def _rotation(names: Sequence[str], count: int, rng: np.random.Generator) -> list[str]:
    """Return `count` of the names in drawn order, in turn, so that their numbers differ by at most one."""
    order = [names[int(i)] for i in rng.permutation(len(names))]
    return [order[i % len(order)] for i in range(count)]


def _sets(names: Sequence[str], size: int, count: int, rng: np.random.Generator) -> list[tuple[str, ...]]:
    """Return `count` drawn sets of distinguishable kinds, wind only with a drag; repeats come last."""
    good = [
        chosen
        for chosen in combinations(names, size)
        if len(SAME_RATIO.intersection(chosen)) < 2 and ("wind" not in chosen or set(chosen) & set(DRAG))
    ]
    picked: list[tuple[str, ...]] = []
    while len(picked) < count:
        picked += [good[i] for i in rng.permutation(len(good))]
    return picked[:count]
