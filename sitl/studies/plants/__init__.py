"""Plants with the equations of motion of other simulators, for worlds whose physics nobody here wrote.

Nothing outside this package imports these simulators, and only the plants themselves do.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from trimtab.sitl.kinds import KINDS


@dataclass(frozen=True, kw_only=True)
class LibraryPlant:
    """A plant of this package: its class as `--plant` takes it, and the distribution that it needs."""

    spec: str
    distribution: str


def _plant(file: str, class_name: str, distribution: str) -> LibraryPlant:
    spec = f"{Path(__file__).with_name(file)}:{class_name}"
    return LibraryPlant(spec=spec, distribution=distribution)


PLANTS = {
    "crazyflow": _plant("crazyflow_plant.py", "CrazyflowPlant", "crazyflow"),
    "rotorpy": _plant("rotorpy_plant.py", "RotorPyPlant", "rotorpy"),
}
"""The plants by name."""

EFFECTS = frozenset(name for name, kind in KINDS.items() if not kind.outside)
"""Kinds of effect that these plants can have."""
