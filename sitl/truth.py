"""The truth of a simulated session: what the world held. Written only where asked, opened only by checks."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sitl.draw import World
from sitl.seeds import session_uid


def truth_record(world: World, flight: int, *, plant: str | None = None) -> dict[str, Any]:
    """The truth as plain data: the session's uid, world and seed, effects and deviations.

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


def write_truth(path: str | Path, truth: Mapping[str, Any], *, log_id: str | None = None) -> None:
    """Nothing comes back; the record is written aside and renamed. `log_id` ties it to a log."""
    target = Path(path)
    record = {**truth, "log": log_id}
    draft = target.with_name(f".{target.name}.part")
    draft.write_text(json.dumps(record, indent=2, sort_keys=True) + "\n", encoding="utf-8")
    os.replace(draft, target)
