"""The truth of a simulated session: the content of its world. Only checks may open it."""

from __future__ import annotations

from typing import Any

from trimtab.sitl.draw import World
from trimtab.sitl.seeds import session_uid


def truth_record(
    world: World, flight: int, *, plant: str | None = None, at_port: bool = False
) -> dict[str, Any]:
    """Return the truth as plain data: the session's uid, world and seed, effects and deviations.

    `plant` is the name of a foreign plant. Its physics is its own; if the world was chosen, it acts it out.
    `at_port`: whether the vehicle was served at a port.
    """
    return {
        "uid": f"{session_uid(world.seed, flight, at_port=at_port):016x}",
        "world": world.name,
        "world_seed": world.seed,
        "flight": flight,
        "plant": plant,
        "effects": {kind: dict(values) for kind, values in world.effects.items()},
        "deviations": {f"{kind}.{key}": value for (kind, key), value in world.deviations.items()},
        "turbulence": world.turbulence.model_dump(),
    }
