"""`trimtab lineage`: what a file came from and what came from it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from trimtab.host.verbs.options import Json

Folder = Annotated[Path | None, Parameter(name="--workspace")]


def command(file: Path, *, folder: Folder = None, json: Json = False) -> None:
    """Tell what a file came from and what came from it, from the files alone.

    Parameters
    ----------
    file
        Vehicle, route, reference, feed-forward, flight log, model or JSON report.
    folder
        Folder that is searched, with the folders in it. Default: that of FILE.
    """
    from trimtab.host.base.output import emit, say, warn
    from trimtab.host.lineage.search import lineage
    from trimtab.host.lineage.words import lines, to_json

    result = lineage(file, folder)
    for line in result.damaged:
        warn(line)
    say(*lines(result))
    emit(to_json(result), json)
