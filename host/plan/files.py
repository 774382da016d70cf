"""References on disk: `NAME.ref`, and `NAME.ref.json` with the plan's figures and provenance."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from trimtab.host.base import artefacts, bounds
from trimtab.host.plan.result import Plan
from trimtab.host.route import Route

SUFFIX = ".ref"


def check_name(path: Path | str, force: bool = False) -> Path:
    """Return the path, if a plan may be written there. Raises UsageError; call it before planning."""
    return artefacts.check_recorded(path, suffix=SUFFIX, what="reference", force=force)


def write_plan(
    plan: Plan, path: Path | str, *, provenance: Mapping[str, Any] | None = None, force: bool = False
) -> Path:
    """Write a plan's two files and return the path of the reference.

    The same plan and provenance give the same bytes, because processor time is left out. Each file appears
    whole or not at all, the reference last.

    Parameters
    ----------
    plan
        Plan to write.
    path
        Reference to write, .ref. Its record, with route and figures, is NAME.ref.json beside it.
    provenance
        As of `base.artefacts.provenance`. Default: that of the plan.
    force
        Overwrite the files.

    Returns
    -------
    Path
        The path of the reference.

    Raises
    ------
    UsageError
        If the name does not end in .ref, or if a file exists and `force` is not set.
    """
    path = check_name(path, force)
    record = {
        "reference": plan.reference.id,
        "vehicle": plan.reference.vehicle_id,
        "provenance": dict(plan.provenance if provenance is None else provenance),
        "route": plan.route.model_dump(mode="json", exclude_none=True),
        "plan": {name: value for name, value in plan.figures().items() if name != "solve_s"},
    }
    return artefacts.write_recorded(path, plan.reference.to_bytes(), record, force)


def read_course(path: Path | str, reference_id: str) -> tuple[Route, tuple[float, ...]] | None:
    """Return the route of the plan in `path` and the times of its waypoints, s, from `NAME.ref.json`.

    None if that file is missing, damaged or of another reference, or holds no route.
    """
    try:
        record = _record(path, reference_id)
        route = Route.model_validate_json(json.dumps(record["route"]))
        times_s = tuple(map(float, record["plan"]["waypoint_times_s"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return (route, times_s) if len(times_s) == len(route.waypoints_m) else None


def read_predicted_error_m(path: Path | str, reference_id: str) -> float | None:
    """Return the greatest tracking error, m, that its model predicted for the plan in `path`.

    From `NAME.ref.json`. None if that file is missing, damaged or of another reference, or if the plan was
    made without a model.
    """
    try:
        record = _record(path, reference_id)
        if "model" not in record["provenance"]["parents"]:
            return None
        error_m = float(record["plan"]["predicted_error_max_m"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return error_m if math.isfinite(error_m) else None


def _record(path: Path | str, reference_id: str) -> Any:
    """Return the content of `NAME.ref.json`. Raises OSError, ValueError, KeyError or TypeError."""
    record = bounds.read_json(artefacts.record_path(Path(path)))
    if record["reference"] != reference_id:
        raise ValueError(f"{path}: the record is of another reference")
    return record
