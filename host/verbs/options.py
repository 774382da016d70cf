"""Options that verbs share, as annotated types for their parameters."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

Json = Annotated[
    bool, Parameter(name="--json", negative="", help="Print one JSON object as the last line of stdout.")
]

Force = Annotated[bool, Parameter(name="--force", negative="", help="Overwrite the output file.")]

Output = Annotated[Path | None, Parameter(name=["-o", "--output"])]
"""The docstring of each verb describes the output and its default."""

VehicleName = Annotated[str, Parameter(name="--vehicle", help="Vehicle file, by name or path.")]

WorkspaceFolder = Annotated[
    Path | None,
    Parameter(
        name="--workspace", help="Folder with vehicles/, routes/ and effects/. Default: the current folder."
    ),
]

DEFAULT_VEHICLE = "research"
