"""The workspace: its folder can be written to, and its files are valid."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

from trimtab.host.apps.doctor.check import Check
from trimtab.host.apps.doctor.machine import room
from trimtab.host.base.errors import TrimtabError, UsageError
from trimtab.host.workspace import FOLDERS, Workspace, open_workspace


def workspace(folder: Path | None, *, trusted: bool = False) -> list[Check]:
    """Return the check of the workspace, and one for each thing that is wrong with its files.

    Effects are loaded, which runs their code. trusted: also if others can change their files.
    """
    name = "workspace"
    try:
        space = open_workspace(folder, trusted=trusted)
    except UsageError as error:
        return [Check(name=name, status="problem", text=str(error))]
    checks = [_found(name, space), _output(space)]
    for part, check in _readers(space).items():
        for path in sorted((space.root / part).glob("*.toml")):
            checks += _faults(part, check, path)
    return checks + _faults("effects", lambda _: space.effects(), space.root)


def _found(name: str, space: Workspace) -> Check:
    """Return how many files of each kind the workspace has."""
    root = space.root.resolve()
    if not any((root / part).is_dir() for part in FOLDERS):
        text = f"{root} has none of {', '.join(FOLDERS)}: only shipped files are used"
        remedy = "run trimtab init FOLDER to make a workspace"
        return Check(name=name, status="note", text=text, remedy=remedy)
    counts = {part: len(list((root / part).glob("*.toml"))) for part in _readers(space)}
    counts["effects"] = len(space.effect_files())
    words = ", ".join(f"{part} {count}" for part, count in counts.items())
    return Check(name=name, status="ok", text=f"{root} ({words})")


def _output(space: Workspace) -> Check:
    """Return whether files can be written in the workspace, and how much room is there."""
    try:
        with tempfile.TemporaryFile(dir=space.root):
            return room("output", space.root.resolve())
    except OSError as error:
        text = f"{space.root.resolve()} cannot be written to: {error.strerror}"
        return Check(name="output", status="note", text=text, remedy="name files elsewhere with -o")


def _readers(space: Workspace) -> dict[str, Callable[[Path], object]]:
    """Return what reads and checks a TOML file, by folder."""
    return {"vehicles": space.vehicle, "routes": space.route, "controllers": space.controller}


def _faults(name: str, read: Callable[[Path], object], path: Path) -> list[Check]:
    """Return one check for each line that `read` raises; each says what to do."""
    try:
        read(path)
    except TrimtabError as error:
        return [Check(name=name, status="problem", text=line) for line in error.lines]
    except OSError as error:
        text = f"{path}: cannot be read: {error.strerror}"
        return [Check(name=name, status="problem", text=text, remedy="make it readable")]
    return []
