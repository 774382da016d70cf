"""`trimtab init`: make a workspace."""

from __future__ import annotations

from pathlib import Path

from trimtab.host.verbs.options import Json


def command(folder: Path = Path(), *, json: Json = False) -> None:
    """Make the folders of a workspace, with an example. What exists stays as it is.

    Parameters
    ----------
    folder
        The workspace. Default: the current folder.
    """
    from trimtab.host.base.output import emit, say
    from trimtab.host.workspace import make_workspace

    made = make_workspace(folder)
    say(*(f"made {path}" for path in made) if made else (f"{folder}: is a workspace already",))
    emit({"workspace": str(folder), "made": [str(path) for path in made]}, json)
