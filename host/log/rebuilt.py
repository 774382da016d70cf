"""The part of the attitude that an imported log rebuilds, as its metadata hold it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

REBUILT = "rebuilt"
"""Entry of an import: part, source and standard deviation in rad, separated by spaces."""

Part = Literal["pitch"]
Source = Literal["accelerations", "positions"]


@dataclass(frozen=True, kw_only=True)
class Rebuilt:
    """A part of the attitude that a foreign log leaves out and its import rebuilt.

    Attributes
    ----------
    part
        The angle.
    source
        What it was rebuilt from: accelerations that the vehicle logged, or its positions.
    sd_rad
        Standard deviation of the rebuilt angle.
    """

    part: Part
    source: Source
    sd_rad: float

    def metadata(self) -> dict[str, str]:
        """Return the entry of the log's `trimtab` record."""
        return {REBUILT: f"{self.part} {self.source} {self.sd_rad:.6f}"}

    def __str__(self) -> str:
        return f"{self.part} from {self.source}, to {math.degrees(self.sd_rad):.2g} deg"


def rebuilt_of(metadata: Mapping[str, str]) -> Rebuilt | None:
    """Return the entry of a log's `trimtab` record; None without one. Raises ValueError if it is damaged."""
    if REBUILT not in metadata:
        return None
    part, source, sd_rad = metadata[REBUILT].split()
    parts: dict[str, Part] = {name: name for name in get_args(Part)}
    sources: dict[str, Source] = {name: name for name in get_args(Source)}
    return Rebuilt(part=parts[part], source=sources[source], sd_rad=float(sd_rad))
