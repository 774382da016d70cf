"""`trimtab compare`: what differs between two logs, models, plans or folders of them."""

from __future__ import annotations

from pathlib import Path

from trimtab.host.verbs.options import Json, Trust, WorkspaceFolder


def command(
    a: Path, b: Path, *, workspace: WorkspaceFolder = None, trust: Trust = False, json: Json = False
) -> None:
    """Compare two logs, models or plans, or two folders of them. Differences are B minus A.

    Parameters
    ----------
    a
        Flight log, model, reference, or folder with these files.
    b
        The same, of the same kind.
    """
    from trimtab.host.base.output import emit, say, warn
    from trimtab.host.compare.comparison import compare
    from trimtab.host.compare.comparison_words import lines, notes
    from trimtab.host.workspace import open_workspace

    result = compare(a, b, open_workspace(workspace, trusted=trust))
    for note in notes(result):
        warn(note)
    say(*lines(result))
    emit(result.to_dict(), json)
