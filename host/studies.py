"""Finds studies through the entry-point group `trimtab.studies`; nothing here imports them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Protocol

from host.errors import UsageError

GROUP = "trimtab.studies"


class Study(Protocol):
    """A study: worlds drawn from a seed, flown, traced, scored."""

    def __call__(
        self,
        *,
        folder: Path,
        seed: int,
        worlds: int,
        vehicle: str,
        jobs: int,
        with_baselines: bool = False,
        real: Path | None = None,
        report: Callable[[float, float, str], None],
    ) -> Mapping[str, Any]:
        """The outcome as plain data: `answer`, `lines`, `table`, `thin`, `real`, `baselines`, `confusion`,
        `deviations`, `wrong`, `scores`.

        folder: state and results, gone on with where they are there. real: file of groups of flights that are
        traced beside the worlds. report: called with what is done, what
        there is to do, and a word.
        """
        ...


def find_study(name: str) -> Study:
    """The study registered under `name`. Raises UsageError where there is none."""
    found = {point.name: point for point in entry_points(group=GROUP)}
    if name not in found:
        known = ", ".join(sorted(found)) or "none is installed, run `make venv`"
        raise UsageError(f"no study called {name} (known: {known})")
    return found[name].load()
