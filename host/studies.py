"""Registry of studies, through the entry-point group `trimtab.studies`. The host does not import them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
from inspect import signature
from pathlib import Path
from typing import Any, Protocol

from trimtab.host.base.errors import UsageError

GROUP = "trimtab.studies"


class Study(Protocol):
    """A study. Keyword arguments of its function other than those listed here are its options."""

    def __call__(
        self,
        *,
        folder: Path,
        seed: int,
        vehicle: str,
        jobs: int,
        on_progress: Callable[[float, float, str], None],
        **options: Any,
    ) -> Mapping[str, Any]:
        """Run the study and return its outcome as plain data.

        The outcome holds `answer` (the JSON object, with `study`), `lines` (text for the terminal), `scores`
        (all results) and the entries that the report shows. `folder` holds state and results; a study that
        finds them there resumes. `on_progress` is called with the work done, the total, and a detail text.
        """
        ...


def options_of(
    study: Study, options: Mapping[str, Any], flags: Mapping[str, str], name: str
) -> dict[str, Any]:
    """Return the options that are set (not None or False), checked against the study's parameters.

    `flags` maps options to their names on the command line. Raises UsageError for one that the study lacks.
    """
    given = {key: value for key, value in options.items() if value is not None and value is not False}
    known = signature(study).parameters
    for key in given:
        if key not in known:
            raise UsageError(f"{flags[key]} is not an option of study {name}; leave it out")
    return given


def find_study(name: str) -> Study:
    """Return the study registered under `name`. Raises UsageError if there is none."""
    points = {point.name: point for point in entry_points(group=GROUP)}
    if name not in points:
        known = ", ".join(sorted(points)) or "none is installed; run `make venv`"
        raise UsageError(f"no study called {name} (known: {known})")
    return points[name].load()
