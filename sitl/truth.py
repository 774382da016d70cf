"""The truth of a simulated session: what the world held. Who writes it decides where; only checks open it."""

from __future__ import annotations

from typing import Any

from trimtab.sitl.draw import World
from trimtab.sitl.seeds import session_uid


def truth_record(world: World, flight: int, *, plant: str | None = None) -> dict[str, Any]:
    """Return the truth as plain data: the session's uid, world and seed, effects and deviations.

    `plant` names a foreign plant, whose physics only its author knows; the world's effects then do not act.
    """
    return {
        "uid": f"{session_uid(world.seed, flight):016x}",
        "world": world.name,
        "world_seed": world.seed,
        "flight": flight,
        "plant": plant,
        "effects": {kind: dict(values) for kind, values in world.effects.items()},
        "deviations": {f"{kind}.{key}": value for (kind, key), value in world.deviations.items()},
        "turbulence": world.turbulence.model_dump(),
    }
