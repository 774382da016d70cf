"""Finds studies through the entry-point group `trimtab.studies`; nothing here imports them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
from inspect import signature
from pathlib import Path
from typing import Any, Protocol

from trimtab.host.base.errors import UsageError

GROUP = "trimtab.studies"


class Study(Protocol):
    """A study: its options are the keyword arguments of its function beside those named here."""

    def __call__(
        self,
        *,
        folder: Path,
        seed: int,
        vehicle: str,
        jobs: int,
        report: Callable[[float, float, str], None],
        **options: Any,
    ) -> Mapping[str, Any]:
        """Return the outcome as plain data: `answer` (the machine's object, with `study`), `lines` (for
        people), `scores` (everything), and what its page shows.

        folder: state and results, gone on with where they are there. report: called with what is done, what
        there is to do, and a word.
        """
        ...


def options_of(study: Study, asked: Mapping[str, Any], flags: Mapping[str, str], name: str) -> dict[str, Any]:
    """Those of the options asked for (None and False: not asked) that go to the study.

    flags: what each is called on the command line. Raises UsageError for one that this study has not.
    """
    given = {key: value for key, value in asked.items() if value is not None and value is not False}
    known = signature(study).parameters
    for key in given:
        if key not in known:
            raise UsageError(f"{flags[key]} is no option of study {name}, leave it out")
    return given


def find_study(name: str) -> Study:
    """Return the study registered under `name`. Raises UsageError where there is none."""
    found = {point.name: point for point in entry_points(group=GROUP)}
    if name not in found:
        known = ", ".join(sorted(found)) or "none is installed, run `make venv`"
        raise UsageError(f"no study called {name} (known: {known})")
    return found[name].load()
