"""Options that verbs share, as annotated types for their parameters."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

if TYPE_CHECKING:
    from trimtab.host.link.keys import StationKey

Json = Annotated[
    bool, Parameter(name="--json", negative="", help="Print one JSON object as the last line of stdout.")
]

Force = Annotated[bool, Parameter(name="--force", negative="", help="Overwrite the output file.")]

Output = Annotated[Path | None, Parameter(name=["-o", "--output"])]
"""The docstring of each verb describes the output and its default."""

KeyFile = Annotated[
    Path | None,
    Parameter(name="--key", help="Key file, if the vehicle has a key: `trimtab key new` makes one."),
]

VehicleName = Annotated[str, Parameter(name="--vehicle", help="Vehicle file, by name or path.")]

WorkspaceFolder = Annotated[
    Path | None,
    Parameter(
        name="--workspace", help="Folder with vehicles/, routes/ and effects/. Default: the current folder."
    ),
]

Trust = Annotated[
    bool,
    Parameter(
        name="--trust",
        negative="",
        help="Run the code of a workspace or plant even if other users can change it.",
    ),
]

AcceptUndecided = Annotated[
    bool,
    Parameter(name="--accept-undecided", negative="", help="Also use a model whose verdict is undecided."),
]


def key_option(path: Path | None) -> StationKey | None:
    """Return the key in the file of --key, recorded as used now; None without it. Raises UsageError."""
    if path is None:
        return None
    from trimtab.host.link.drivers import wall_timestamp
    from trimtab.host.link.keys import use_key

    return use_key(path, wall_timestamp())
