"""Plants with the equations of motion of other simulators, for worlds whose physics nobody here wrote.

Nothing outside this package imports these simulators, and here only the modules that PLANTS names.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path

from trimtab.sitl.studies.files import StudyError


@dataclass(frozen=True, kw_only=True)
class LibraryPlant:
    """A plant of this package.

    `spec` is what `--plant` takes, `package` what it imports, `effects` the kinds of effect that it can have.
    """

    spec: str
    package: str
    effects: frozenset[str]


EFFECTS = frozenset(
    {
        "linear-drag",
        "quadratic-drag",
        "wind",
        "thrust-gain",
        "battery-sag",
        "motor-lag",
        "com-offset",
        "mocap-latency",
        "mass",
        "inertia",
        "translational-lift",
        "thrust-inflow",
        "rotor-loss",
        "actuation-delay",
        "frame-tilt",
        "ground-effect",
        "gyroscopic",
        "torque-bias",
        "slung-payload",
        "uneven-lag",
        "dead-zone",
    }
)
"""Kinds of effect that all plants of this package can have. Add a kind here when they act it out."""


def _plant(package: str, class_name: str, *others: str) -> LibraryPlant:
    path = Path(__file__).with_name(f"{package}_plant.py")
    return LibraryPlant(spec=f"{path}:{class_name}", package=package, effects=EFFECTS.union(others))


PLANTS = {
    "crazyflow": _plant("crazyflow", "CrazyflowPlant"),
    "rotorpy": _plant("rotorpy", "RotorPyPlant", "blade-flapping"),
}
"""The plants by name."""


def check_plant(name: str | None) -> None:
    """Raise StudyError if there is no plant of this name, or its simulator is not installed. None is ours."""
    if name is None:
        return
    if name not in PLANTS:
        raise StudyError(f"--plant {name}: no such plant (known: {', '.join(PLANTS)}); leave it out for ours")
    if importlib.util.find_spec(PLANTS[name].package) is None:
        raise StudyError(f"--plant {name}: {PLANTS[name].package} is not installed; install trimtab[plants]")
