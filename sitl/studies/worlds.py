"""Which worlds a blind study flies: classes in the proportions of the full study, kinds in rotation.

Everything comes from the study's seed and the simulator's own list of kinds; sizes and tolerances are then
drawn by the world itself from its seed.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np

from trimtab.sitl.kinds import DRAG, KINDS
from trimtab.sitl.studies.files import StudyError
from trimtab.sitl.world import ImuSettings, Turbulence

Class = Literal["none", "single", "pair", "outside", "thin"]
FULL: dict[Class, int] = {"single": 150, "pair": 60, "none": 200, "outside": 80, "thin": 48}
"""Worlds of each class in a study of full size; smaller and larger ones keep the proportions."""

SIZE = (0.5, 2.0)
"""Least and greatest multiple of the typical size."""

CALM = (0.5, 2.0)
"""Least and greatest multiple of the usual turbulence."""

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
"""What data of a thin world lack, in rotation."""

SAME_RATIO = frozenset({"mass", "thrust-gain", "inertia"})
"""Kinds of which only ratios show in flight: no two of them make a pair."""


@dataclass(frozen=True, kw_only=True)
class PlannedWorld:
    """One world of a study: its name in the study, what it is drawn from, and its seed.

    `case` says how the data of a thin world are thin.
    """

    name: str
    kind_class: Class
    kinds: tuple[str, ...]
    seed: int
    turbulence: float
    case: str | None = None

    @property
    def is_measured(self) -> bool:
        """Whether a verdict's numbers are compared: the world holds what the library has a form of."""
        return self.kind_class in ("single", "pair")

    def toml(self, *, still: bool = False) -> str:
        """Return the world file; `still`: the same world in still air, seen by perfect sensors."""
        usual, strength = Turbulence(), 0.0 if still else self.turbulence
        lines = [
            'description = "A world of a blind study"',
            "tolerances = true",
            "",
            "[turbulence]",
            f"force_m_s2 = {usual.force_m_s2 * strength:.6f}",
            f"torque_rad_s2 = {usual.torque_rad_s2 * strength:.6f}",
        ]
        if still:
            lines += ["", "[mocap]", "position_noise_m = 0.0", "attitude_noise_deg = 0.0", "dropout = 0.0"]
            lines += ["", "[imu]", *(f"{name} = 0.0" for name in ImuSettings.model_fields)]
        if self.kinds:
            names = ", ".join(f'"{kind}"' for kind in self.kinds)
            count = len(self.kinds)
            lines += [
                "",
                "[draw]",
                f"count = [{count}, {count}]",
                f"kinds = [{names}]",
                f"size = {list(SIZE)}",
            ]
        return "\n".join(lines) + "\n"


def split(count: int) -> dict[Class, int]:
    """Worlds of each class out of `count`: the full study's proportions by largest remainder, one at least.

    Raises StudyError below one each.
    """
    if count < len(FULL):
        raise StudyError(f"--worlds {count} is fewer than the {len(FULL)} classes, give {len(FULL)} or more")
    whole = sum(FULL.values())
    shares: dict[Class, float] = {name: count * full / whole for name, full in FULL.items()}
    parts: dict[Class, int] = {name: max(1, math.floor(share)) for name, share in shares.items()}
    for name in sorted(shares, key=lambda name: parts[name] - shares[name])[: count - sum(parts.values())]:
        parts[name] += 1
    while sum(parts.values()) > count:  # the least classes were raised to one
        parts[max(parts, key=lambda name: parts[name] - shares[name] if parts[name] > 1 else -1.0)] -= 1
    return parts


def plan_worlds(seed: int, count: int, library: Collection[str]) -> list[PlannedWorld]:
    """Return the `count` worlds of a seed, shuffled; `library` names the effects that the host has a form of.

    A kind outside the library by its own word is an outside one; one in the library is drawn alone (wind
    never: it acts through a drag), for thin data too, and in pairs. Raises StudyError for fewer worlds than
    classes.
    """
    parts = split(count)
    rng = np.random.default_rng([seed, 0])
    inside = [kind.name for kind in KINDS.values() if not kind.outside and kind.name in library]
    alone = [name for name in inside if name != "wind"]
    outside = [kind.name for kind in KINDS.values() if kind.outside]
    sets: dict[Class, list[tuple[str, ...]]] = {
        "none": [()] * parts["none"],
        "single": [(name,) for name in _rotation(alone, parts["single"], rng)],
        "pair": _pairs(inside, parts["pair"], rng),
        "outside": [(name,) for name in _rotation(outside, parts["outside"], rng)],
        "thin": [(name,) for name in _rotation(alone, parts["thin"], rng)],
    }
    cases = iter(_rotation(THIN, parts["thin"], rng))
    drawn = [
        (kind_class, kinds, next(cases) if kind_class == "thin" else None)
        for kind_class, found in sets.items()
        for kinds in found
    ]
    low, high = (math.log(bound) for bound in CALM)
    return [
        PlannedWorld(
            name=f"{index:04d}",
            kind_class=drawn[place][0],
            kinds=drawn[place][1],
            case=drawn[place][2],
            seed=world_seed(seed, index),
            turbulence=math.exp(rng.uniform(low, high)),
        )
        for index, place in enumerate(rng.permutation(len(drawn)).tolist())
    ]


def world_seed(seed: int, index: int) -> int:
    """Return the seed of a study's world: 48 bits that show neither the study's seed nor the index."""
    return int.from_bytes(hashlib.sha256(f"blind study {seed} world {index}".encode()).digest()[:6], "big")


def _rotation(names: Sequence[str], count: int, rng: np.random.Generator) -> list[str]:
    """`count` of the names, each as often as any other but for one, in drawn order."""
    order = [names[int(i)] for i in rng.permutation(len(names))]
    return [order[i % len(order)] for i in range(count)]


def _pairs(names: Sequence[str], count: int, rng: np.random.Generator) -> list[tuple[str, ...]]:
    """`count` drawn pairs that differ in flight, none again before all were there; wind with a drag."""
    good = [pair for pair in combinations(names, 2) if not set(pair) <= SAME_RATIO]
    good = [pair for pair in good if "wind" not in pair or set(pair) & set(DRAG)]
    picked: list[tuple[str, ...]] = []
    while len(picked) < count:
        picked += [good[i] for i in rng.permutation(len(good))]
    return picked[:count]
